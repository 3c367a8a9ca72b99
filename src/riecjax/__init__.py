"""Physical parameters of reduced mechanical models, by the randomized integral error criterion.

Names are imported when first used, so that what needs no JAX does not wait for it; what there is
stands in `__init__.pyi`.
"""

_attached = None


def _lazy():
    """What gives a public name, what lists them, and their list."""
    global _attached
    if _attached is None:
        import lazy_loader

        _attached = lazy_loader.attach_stub(__name__, __file__)
    return _attached


def __dir__():
    return _lazy()[1]()


def __getattr__(name: str):
    """A public name; of one that a submodule has, the error says where it is."""
    import importlib.util

    public, _, listed = _lazy()
    if name == "__all__":
        return listed
    try:
        return public(name)
    except AttributeError as error:
        # `from riecjax import errors` asks here for a module before it imports it.
        if importlib.util.find_spec(f"{__name__}.{name}"):
            raise
        for module in listed:
            if module.islower() and name in _names_of(module):
                raise AttributeError(
                    f"riecjax has no '{name}' at its top level: write rx.{module}.{name}."
                ) from None
        raise error


def _names_of(module: str) -> list[str]:
    import importlib

    try:
        return getattr(importlib.import_module(f"{__name__}.{module}"), "__all__", [])
    except ImportError:
        return []
