"""PyArrow's functions on columns, which it makes on import and type checkers do not see."""

from typing import Any


def compute() -> Any:
    """The module `pyarrow.compute`."""
    import pyarrow.compute

    return pyarrow.compute
