"""Equations of motion, linear in their parameters, as sums of terms."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
