"""Objects that show themselves, by what `reporting` makes of them.

The stages that define them come before reporting and know nothing of it: it is imported when an
object is printed, drawn or exported.
"""

import importlib
import os
from collections.abc import ItemsView, Iterator, KeysView, Mapping
from typing import Any

from riecjax.extensions import require_packages


def reported(module: str, verb: str, *of: Any, **settings: Any) -> Any:
    """What a function of `riecjax.reporting` says of an object."""
    return getattr(importlib.import_module(f"riecjax.reporting.{module}"), verb)(*of, **settings)


class Shown:
    """Prints as numbers with units, and in a notebook as tables."""

    def __repr__(self) -> str:
        return reported("views", "in_words", self, brief=True)

    def __str__(self) -> str:
        return reported("views", "in_words", self)

    def _repr_html_(self) -> str:
        return reported("views", "as_html", self)


class Drawn(Shown):
    """Can be drawn too."""

    def plot(self, ax: Any = None) -> Any:
        """Draw it by matplotlib.

        **Arguments:** `ax`: the axes to draw into, as many as the figure has panels; by default a
        new figure of pyplot's.

        **Returns:** the axes of one panel, the figure of several.

        **Raises:** `DataError` if matplotlib is not installed, or for another number of axes.
        """
        require_packages("figure")
        return reported("plots", "draw", self, ax)


class Tabled(Drawn):
    """Values by name, as of a mapping, that leave as dictionaries, frames and tables."""

    def __iter__(self) -> Iterator[str]:
        raise NotImplementedError

    def __getitem__(self, name: str) -> Any:
        raise NotImplementedError

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return any(name == each for each in self)

    def keys(self) -> KeysView[str]:
        """Names of all parameters, those that were estimated first."""
        return self._by_name().keys()

    def items(self) -> ItemsView[str, Any]:
        """Pairs of name and value."""
        return self._by_name().items()

    def _by_name(self) -> Mapping[str, Any]:
        return {name: self[name] for name in self}

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Of each parameter `value`, `std_error`, `interval` of 95 %, `unit` and `known`.

        Plain numbers, of a batch nested lists; `None` for what is not finite, and for the error and
        interval of what is known.
        """
        return reported("exports", "to_dict", self)

    def to_frame(self) -> Any:
        """A pandas data frame with a row for each parameter, of a batch for each member's.

        Columns `value`, `std_error`, `low95`, `high95`, `unit` and `known`.

        **Raises:** `DataError` if pandas is not installed.
        """
        return reported("exports", "to_frame", self)

    def to_markdown(self) -> str:
        """A table in Markdown: value, standard error, unit, rounded by the standard error."""
        return reported("tables", "in_markdown", reported("exports", "paper_table", self))

    def to_latex(self) -> str:
        """The same as a `tabular` of LaTeX, which needs no package."""
        return reported("tables", "in_latex", reported("exports", "paper_table", self))


class Saved(Tabled):
    """Can be kept in a file, and as a data set of xarray."""

    def to_xarray(self) -> Any:
        """An xarray data set over `parameter`: value, std_error, low95, high95, unit, known.

        Axes of a batch come first, as `member`, of a nested one `member_0`, `member_1`, ...

        **Raises:** `DataError` if xarray is not installed.
        """
        return reported("exports", "to_xarray", self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to a file of exactly this name, whole or not at all; see [`load`][].

        It holds everything, the Summary too: values, intervals of any level, and findings.

        **Raises:** `DataError` if the file cannot be written; `ModelError` for a batch, for what
        is being traced, or a criterion with a law that is a function.
        """
        reported("result_files", "save", self, path)
