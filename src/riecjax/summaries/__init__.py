"""Sums that hold all that a recording says to a model: the Summary, and the pass that makes it."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
