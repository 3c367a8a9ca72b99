"""Whatever may be amiss with an equation beside its values, as columns of it."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
