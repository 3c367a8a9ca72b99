"""Fleets: recordings by the thousand, summed side by side by Dask, and estimated group by group."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
