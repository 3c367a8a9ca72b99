"""What stands around the core: readers and commands, found by name when one is asked for.

A distribution declares them as entry points:

- `riecjax.readers`: the ending of a file's name without its dot, in small letters, or the name of a
  file that makes a folder a recording; a function of the path that returns
  [`Channels`][riecjax.records.reading.Channels]. It may have keywords `delimiter`, `decimal` and
  `columns`, what users say of a table as text.
- `riecjax.commands`: name of a command; a `click.Command`.
- `riecjax.elements`: what `--add KIND:SIGNAL` calls it; a class derived from
  [`Element`][riecjax.Element].

What the core has itself is never looked for here, so that nothing can take its place. Of two
extensions with one name this distribution's own wins; where neither is its own, both are refused.
"""

import functools
import importlib.util
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

from riecjax.errors import DataError, RiecjaxError, reason_of

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind = Literal["readers", "commands", "elements"]

NEEDS = {
    "frame": ("a data frame needs", ("pandas",), "frames"),
    "figure": ("a figure needs", ("matplotlib",), "report"),
    "report": ("figures and reports need", ("matplotlib", "plotly", "jinja2"), "report"),
    "fleet": (
        "fleets need",
        ("distributed", "fsspec", "ruptures", "statsmodels"),
        "fleet",
    ),
    "HDF5": ("reading HDF5 files, as MATLAB's of v7.3, needs", ("h5py",), "hdf5"),
    "Excel": ("reading Excel files needs", ("python_calamine",), "excel"),
    "MDF": ("reading MDF files needs", ("asammdf",), "mdf"),
    "TDMS": ("reading TDMS files needs", ("nptdms",), "tdms"),
    "ROS": ("reading ROS bags needs", ("rosbags",), "ros"),
}
"""What optional packages are for: the words that say so, the packages, and the extra that installs
them."""


class ExtensionError(RiecjaxError):
    """What another distribution adds cannot be loaded, or two add the same."""

    code = "extension"


def require_packages(use: str) -> None:
    """Make sure, without importing them, that the packages for one of `NEEDS` are installed.

    **Raises:** `DataError` with the remedy if one is not.
    """
    words, packages, extra = NEEDS[use]
    if lacking := [name for name in packages if importlib.util.find_spec(name) is None]:
        raise DataError(
            f"{words} {', '.join(lacking)}; install {'them' if len(lacking) > 1 else 'it'} by "
            f'pip install "riecjax[{extra}]".'
        )


def extension_names(kind: Kind) -> list[str]:
    """Names of all extensions of a kind, this distribution's first; none is imported.

    **Raises:** `ExtensionError` if what is installed cannot be listed.
    """
    return list(_offered(kind, tuple(sys.path)))


def extension(kind: Kind, name: str) -> Callable[..., Any] | None:
    """What is called so among the extensions of a kind, imported now; `None` if nothing is.

    **Raises:** `ExtensionError` if it cannot be imported, or several distributions offer it.
    """
    if not (points := _offered(kind, tuple(sys.path)).get(name, [])):
        return None
    packages = [point.dist and point.dist.name for point in points]
    if len(points) > 1:
        raise ExtensionError(
            f"'{name}' of riecjax.{kind} is offered by {' and by '.join(map(str, packages))}: "
            f"uninstall all but one."
        )
    try:
        found = points[0].load()
        if not callable(found):
            raise TypeError(f"{found!r} cannot be called")
        return found
    except (Exception, SystemExit) as error:
        raise ExtensionError(
            f"'{name}' of riecjax.{kind} cannot be loaded from {points[0].value}: "
            f"{reason_of(error).rstrip('.')}. Update or uninstall {packages[0]}."
        ) from None


@functools.cache
def _offered(kind: Kind, path: tuple[str, ...]) -> "dict[str, list[EntryPoint]]":
    """Entry points of a kind by name; of those that lie on `path`, which they are kept by."""
    from importlib.metadata import entry_points

    try:
        points = entry_points(group=f"riecjax.{kind}")
    except Exception as error:  # of a damaged list of any distribution
        raise ExtensionError(
            f"what is installed beside riecjax cannot be listed: {reason_of(error)}."
        ) from None
    ours = [point for point in points if point.dist and point.dist.name == "riecjax"]
    offered = {point.name: [point] for point in ours}
    for point in sorted(set(points) - set(ours)):
        if all(other not in ours for other in offered.get(point.name, ())):
            offered.setdefault(point.name, []).append(point)
    return offered
