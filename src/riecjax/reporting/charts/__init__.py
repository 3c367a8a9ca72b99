"""Figures described once, and drawn twice: for print and for a page that zooms."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
