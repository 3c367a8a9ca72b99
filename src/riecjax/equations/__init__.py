"""Equations of motion, linear in their parameters, as sums of terms."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
