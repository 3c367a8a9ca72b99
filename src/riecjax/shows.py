"""Objects that show themselves, by what `reporting` makes of them.

The stages that define them come before reporting and know nothing of it. Here stand verbs by the
kind of object, [`view_of`][riecjax.shows.view_of] and the others: `reporting` registers a case for
each kind as soon as one is asked for, and an object of another kind brings its own `view()` or
`chart()`.
"""

import functools
from collections.abc import Callable, ItemsView, Iterator, KeysView
from typing import Any

from riecjax.extensions import require_packages

_registering: list[Callable[[], None]] = []


def registered_by(register: Callable[[], None]) -> None:
    """Have this called before anything is shown for the first time: it imports what registers."""
    _registering.append(register)


def _verb(method: str = "") -> Any:
    """A verb by the kind of its first object, cases of which are registered: an object of a kind
    that nobody registered has a `method` for it."""

    def unregistered(thing: Any, *rest: Any) -> Any:
        # Before everything is registered, every object comes here.
        while _registering:
            _registering.pop()()
        case = verb.dispatch(type(thing))
        return getattr(thing, method)() if case is unregistered else case(thing, *rest)

    verb = functools.singledispatch(unregistered)
    return verb


view_of = _verb("view")
"""What is said of an object, a [`View`][riecjax.reporting.View]: else what its `view()` is."""
chart_of = _verb("chart")
"""The chart that shows an object: else what its `chart()` is."""
table_of = _verb("table")
"""The [`Table`][riecjax.reporting.Table] of an object that a paper has room for."""
draw = _verb()
"""Draw a chart by matplotlib; see [`Drawn.plot`][riecjax.shows.Drawn.plot]."""
save = _verb()
"""Write an object to a file; see [`Estimate.save`][riecjax.Estimate.save]."""
show = _verb()
"""Write the report of an object to a temporary folder, and open it in the browser."""


class Shown:
    """Prints as numbers with units, and in a notebook as tables."""

    def __repr__(self) -> str:
        return view_of(self).text(brief=True)

    def __str__(self) -> str:
        return view_of(self).text()

    def _repr_html_(self) -> str:
        return view_of(self).html()


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
        return draw(chart_of(self), ax)


class Tabled(Drawn):
    """Values by name, as of a mapping, that leave as dictionaries, frames and tables.

    What is one has `units`, and of what it estimated `standard_error(name)` and
    `interval_by_name()`.
    """

    def __iter__(self) -> Iterator[str]:
        raise NotImplementedError

    def __getitem__(self, name: str) -> Any:
        raise NotImplementedError

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def keys(self) -> KeysView[str]:
        """Names of all parameters, those that were estimated first."""
        return dict.fromkeys(self).keys()

    def items(self) -> ItemsView[str, Any]:
        """Pairs of name and value."""
        return {name: self[name] for name in self}.items()

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Of each parameter `value`, `std_error`, `interval` of 95 %, `unit` and `known`.

        Plain numbers, of a batch nested lists; `None` for what is not finite, and for the error and
        interval of what is known.
        """
        from riecjax.arrays import hosted
        from riecjax.leaves import finite

        host: Any = hosted(self)
        units, ends = dict(host.units), host.interval_by_name()
        return {
            name: {
                "value": finite(host[name]),
                "std_error": finite(host.standard_error(name)) if name in ends else None,
                "interval": tuple(finite(ends[name])) if name in ends else None,
                "unit": units[name],
                "known": name not in ends,
            }
            for name in self
        }

    def to_frame(self) -> Any:
        """A pandas data frame with a row for each parameter, of a batch for each member's.

        Columns `value`, `std_error`, `low95`, `high95`, `unit` and `known`.

        **Raises:** `DataError` if pandas is not installed.
        """
        require_packages("frame")
        import numpy as np
        import pandas

        names, entries = list(self), [*self.to_dict().values()]
        shape, missing = np.shape(entries[0]["value"]), (None, None)
        index = pandas.Index(names, name="parameter")
        if shape:
            batch = [f"member_{i}" for i in range(len(shape))] if len(shape) > 1 else ["member"]
            levels = [*map(range, shape), names]
            index = pandas.MultiIndex.from_product(levels, names=[*batch, "parameter"])
        rows = [(e["value"], e["std_error"], *(e["interval"] or missing)) for e in entries]
        data: dict[str, Any] = {
            # NaN where there is no number.
            name: np.stack([np.broadcast_to(np.array(x, float), shape) for x in column], -1).ravel()
            for name, column in zip(("value", "std_error", "low95", "high95"), zip(*rows))
        }
        for name in ("unit", "known"):
            data[name] = [entry[name] for entry in entries] * (len(index) // len(names))
        return pandas.DataFrame(data, index)

    def to_markdown(self) -> str:
        """A table in Markdown: value, standard error, unit, rounded by the standard error."""
        return table_of(self).markdown()

    def to_latex(self) -> str:
        """The same as a `tabular` of LaTeX, which needs no package."""
        return table_of(self).latex()
