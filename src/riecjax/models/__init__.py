"""Built-in models: equations to identify and systems to simulate."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
