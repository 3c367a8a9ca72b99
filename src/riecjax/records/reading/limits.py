"""How much a file may hold before it is refused, checked on what it declares, before reading."""

import contextlib
import warnings
from collections.abc import Iterator

from riecjax.errors import DataError, RiecjaxError

LARGEST_FILE = 4 * 2**30
"""Bytes a file may hold, unpacked, before it is refused."""
MOST_COLUMNS = 10_000
"""Columns a file may hold before it is refused."""
HIGHEST_PACKING = 1100
"""Bytes that one byte of a deflated file can hold (1032), with its headers."""

LONGEST_REASON = 200
"""Characters of a library's error that are passed on; some quote the whole file."""


def check_unpacked(size: int, packed: int | None = None) -> None:
    """Refuse a file that declares to unpack to `size` bytes from `packed` ones.

    **Raises:** `DataError` past `LARGEST_FILE`, or past what any packing could give.
    """
    if size > LARGEST_FILE:
        raise DataError(f"unpacks to {size} bytes, more than is read.")
    if packed is not None and size > HIGHEST_PACKING * (packed + 2**16):
        raise DataError(f"declares {size} bytes in a file of {packed} bytes; it is damaged.")


def check_column_count(count: int) -> None:
    """Refuse a file with more than `MOST_COLUMNS` columns with a `DataError`."""
    if count > MOST_COLUMNS:
        raise DataError(f"has {count} columns, more than {MOST_COLUMNS} are not read.")


@contextlib.contextmanager
def foreign_reader(kind: str) -> Iterator[None]:
    """Run a library on a file that may be damaged: its errors become one `DataError`.

    Libraries let out whatever a damaged file provokes in them. Running out of memory is no
    fault of the file.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (RiecjaxError, MemoryError):
        raise
    except Exception as error:
        raise DataError(f"not a readable {kind} file: {first_sentence(error)}") from None


def first_sentence(error: BaseException) -> str:
    """The start of an exception's first line, or its type where it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:LONGEST_REASON]
