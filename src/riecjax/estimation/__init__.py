"""From normal equations to parameters with their uncertainty."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
