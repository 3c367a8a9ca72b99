"""What no term of an equation says, a class for each kind; see [`Element`][riecjax.Element]."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
