"""Figures described once, and drawn twice: for print and for a page that zooms."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
