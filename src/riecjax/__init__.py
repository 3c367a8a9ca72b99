"""Physical parameters of reduced mechanical models, by the randomized integral error criterion.

Names are imported when first used, so that what needs no JAX does not wait for it; what there is
stands in `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
