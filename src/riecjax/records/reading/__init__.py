"""From a file to named columns of numbers, and from those to a record.

`__init__.pyi` lists what the author of a reader needs, which is found as `riecjax.extensions` says.
"""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
