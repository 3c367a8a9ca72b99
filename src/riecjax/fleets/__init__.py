"""Fleets: recordings by the thousand, summed side by side by Dask, and estimated group by group."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
