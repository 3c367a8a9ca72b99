"""From a file to named columns of numbers, and from those to a record.

`__init__.pyi` lists what the author of a reader needs, which is found as `riecjax.extensions` says.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
