"""Error criteria: which weighted integrals of an equation of motion are made small."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
