"""Error criteria: which weighted integrals of an equation of motion are made small."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
