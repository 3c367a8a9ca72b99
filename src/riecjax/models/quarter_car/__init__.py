"""The paper's quarter car: its identification model, and the source model behind it."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
