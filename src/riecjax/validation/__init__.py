"""How well a simulated model predicts, what its equations leave, and how windows move values."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
