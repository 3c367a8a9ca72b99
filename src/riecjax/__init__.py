"""Physical parameters of reduced mechanical models, by the randomized integral error criterion.

Names are imported when first used, so that what needs no JAX does not wait for it; what there is
stands in `__init__.pyi`.
"""

import importlib
from typing import Any

import lazy_loader

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A public name; of one that a submodule has, the error says where it is."""
    try:
        return _public(name)
    except AttributeError as error:
        for module in __all__:
            if module.islower() and name in _names_of(module):
                raise AttributeError(
                    f"riecjax has no '{name}' at its top level: write rx.{module}.{name}."
                ) from None
        raise error


def _names_of(module: str) -> list[str]:
    try:
        return getattr(importlib.import_module(f"{__name__}.{module}"), "__all__", [])
    except ImportError:
        return []
