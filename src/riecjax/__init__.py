"""Physical parameters of reduced mechanical models, by the randomized integral error criterion.

What there is stands in `__init__.pyi`.
"""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
