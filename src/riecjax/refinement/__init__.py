"""Non-linear refinement: what the linear stage cannot reach, from its estimate as a start."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
