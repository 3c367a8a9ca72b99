"""What speaks for an element: what it explains of blocks of time that it was not found from.

The record is cut into folds. Of each, the element is found from all others, and what it leaves of
the fold is compared with what the equation leaves without it, less noise. An element that is not
there explains nothing of a fold but by chance, wherever the search has put it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.arrays import Array
from riecjax.charts import Chart, Panel
from riecjax.equations.element import Band, Element, Values
from riecjax.findings import Finding, in_percent
from riecjax.leaves import Leaf, finite, told
from riecjax.shows import Drawn

CERTAIN = 3.0
"""Standard errors by which an element must explain more than nothing: of ten folds, one in 130."""
LITTLE = 0.5
"""Share of what is left without an element that a true one explains at the least."""
UNSURE = 0.2
"""Share of the noise's own energy that may be left because its size was judged wrongly."""


class Held(NamedTuple):
    """An element that was found, and what it was found from.

    **Fields:** `element`, the last of its class in a stage; `name` of that; `stage`, its sums
    ([`ShapedStage`][riecjax.estimation.projection.ShapedStage]), and `at`, the shapes found there;
    `band` in which it was looked for; `values` of all parameters, and the `covariance` of its own;
    `lengths` of windows in seconds; shares of the target's energy that are left of folds with it
    (`unexplained`) and `without`, each with the standard error of their difference, the `gain`; and
    that of `noise` in them.
    """

    element: Element
    name: str
    stage: Any
    at: Float[Array, " shapes"]
    band: Band
    values: Values
    covariance: Float[np.ndarray, "p p"]
    lengths: tuple[float, float]
    unexplained: Leaf
    without: Leaf
    noise: Leaf
    gain: Leaf
    gain_error: Leaf

    def last(self) -> tuple[Any, Float[np.ndarray, " others"]]:
        """The stage with this element after all others that are sought, and the others' shapes."""
        parts = self.stage.by_element(self.at)
        others = {element: part for element, part in parts.items() if element != self.element}
        stage = self.stage._replace(sought=(*others, self.element))
        return stage, np.concatenate([np.zeros(0), *others.values()])

    def shared(self) -> tuple[Any, ...]:
        """What every [`Evidence`][] begins with."""
        shares = self.unexplained, self.without, self.noise, self.gain, self.gain_error
        return self.element.hidden, self.name, *shares, self.lengths


@dataclass(frozen=True, eq=False, repr=False)
class Evidence(Drawn):
    """What speaks for an element.

    **Fields:** its hidden `parameters`, of the `stage` its name; `unexplained` share of the target
    on time left out, with it and `without`, means over folds; `noise`, share of the target that
    noise was in the residual, and that was taken off; `gain`, the difference, and its standard
    error; `lengths` of the windows in seconds.
    """

    parameters: tuple[str, ...]
    stage: str
    unexplained: Leaf
    without: Leaf
    noise: Leaf
    gain: Leaf
    gain_error: Leaf
    lengths: tuple[float, float]
    test: ClassVar[str] = ""
    """Name of the test of an answer that it belongs to."""
    figure: ClassVar[str] = ""
    """What its chart is called."""
    least: ClassVar[float] = 0.0
    """Share of the target that it must explain, whatever chance and noise are."""
    caption: ClassVar[str] = ""

    @property
    def explained(self) -> float:
        """Share that it explains of what is left without it, on time left out."""
        without = float(self.without)
        return float(self.gain) / without if without > 0 else 0.0

    @property
    def is_sure(self) -> bool:
        """Whether it explains more than chance or noise that was judged wrongly."""
        least = max(CERTAIN * float(self.gain_error), self.least, UNSURE * float(self.noise))
        return float(self.gain) > least

    @property
    def carried(self) -> bool:
        """Whether the recordings carry it: it explains more than chance would, and much."""
        return self.is_sure and self.explained > LITTLE

    def held_out(self, what: str) -> str:
        """A sentence on how much of time left out something explains."""
        # Less than nothing is left where more noise was taken off than there was.
        shares = "noise accounts for all that is left"
        if float(self.without) > 0:
            shares = (
                f"{in_percent(self.without)} of the signal is left without it and "
                f"{in_percent(max(float(self.unexplained), 0.0))} with it, difference "
                f"{100 * float(self.gain):.2g} +- {in_percent(self.gain_error)}"
            )
        explained = in_percent(min(max(self.explained, 0.0), 1.0))
        return (
            f"on time that it was not found from, {what} explains {explained} of what is left "
            f"without it ({shares})."
        )

    def shares(self) -> dict[str, Any]:
        """Shares of time left out, as plain data for JSON."""
        return {
            "with": finite(self.unexplained),
            **told(self, "without", "gain"),
            "gain_std_error": finite(self.gain_error),
        }

    def findings(self) -> list[Finding]:
        """Warnings if nothing speaks for the element, or little."""
        raise NotImplementedError

    def entry(self) -> dict[str, Any]:
        """All of it, as plain data for JSON."""
        raise NotImplementedError

    def panel(self) -> Panel:
        """What others in its place would leave."""
        raise NotImplementedError

    def chart(self) -> Chart:
        """The panel, with what it shows."""
        return chart_of_all([self])


def chart_of_all(evidence: Sequence[Evidence]) -> Chart:
    """A panel for each of one kind, one above the other."""
    return Chart([[one.panel()] for one in evidence], evidence[0].caption, legend=True)


class ElementTests(NamedTuple):
    """What speaks for elements of one kind, one in each stage, as a test of an answer."""

    name: str
    evidence: Sequence[Evidence]

    def findings(self) -> list[Finding]:
        """Findings of all."""
        return [finding for one in self.evidence for finding in one.findings()]

    def entry(self) -> list[dict[str, Any]]:
        """Of each, plain data for JSON."""
        return [one.entry() for one in self.evidence]
