"""How well a simulated model predicts, what its equations leave, and which windows suit it."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
