"""Recordings: uniformly sampled named signals, read, checked and prepared once."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
