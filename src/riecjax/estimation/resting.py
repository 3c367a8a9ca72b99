"""What is said of velocities that rest where the equation of motion jumps."""

import contextlib
from collections.abc import Callable, Sequence

import numpy as np

from riecjax.equations.dry_friction import in_motion, rests_of
from riecjax.equations.model import Model, with_rests
from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding, in_percent
from riecjax.leaves import size_of
from riecjax.records.record import Record

MOVED = 2.0
"""Standard errors of the surer estimate from which on what is done at rest moves a parameter."""


def at_rest_findings(
    model: Model,
    records: Sequence[Record],
    found: Estimate,
    otherwise: Callable[[Model], Estimate],
) -> list[Finding]:
    """That velocities rest, what was done about it, and what it did to the parameters.

    **Arguments:** `otherwise`, makes the estimate by a model that does the other thing.
    """
    rests = [rests_of(model, record) for record in records]
    names = tuple(dict.fromkeys(name for of in rests for name in of))
    if not names:
        return []
    count = sum(record.sample_count for record in records)
    shares = (max((rest.share for rest in of.values()), default=0.0) for of in rests)
    rested = sum(share * record.sample_count for share, record in zip(shares, records))
    masked = any(in_motion(model, record) is not model for record in records)
    # Parameters that the other treatment moves, with both values.
    moved: dict[str, tuple[float, float]] = {}
    if masked or model.at_rest == "keep":
        with contextlib.suppress(RiecjaxError):
            beside = otherwise(with_rests(model, "keep" if model.at_rest == "mask" else "mask"))
            errors = np.minimum(*(np.asarray(one.standard_errors) for one in (found, beside)))
            pairs = {name: (float(found[name]), float(beside[name])) for name in found.parameters}
            moved = {
                name: (value, other)
                for (name, (value, other)), error in zip(pairs.items(), errors)
                if abs(other - value) > MOVED * error
            }
    width = max(rest.width for of in rests for rest in of.values())
    which = " and ".join(f"'{name}'" for name in names)
    if masked:
        done = f"weights that vanish there, over {width:.2g} to each side of zero, leave it out"
        change, step = "; with it", ""
    elif model.at_rest == "keep":
        done, change = "it was kept", "; without it"
        step = "Leave it out: at_rest='mask' (--at-rest mask)"
    else:
        done = "it was kept, since the equation holds derivatives of other motions than this one"
        change, step = "", "Mask it in the equation: where=rx.equations.faster_than(...)"
    listed = ", ".join(f"{n} {a:.4g} would be {b:.4g}" for n, (a, b) in moved.items())
    message = (
        f"{which} is at rest {in_percent(rested / count)} of the time, where friction is whatever "
        f"balances the other forces; {done}{change + ' ' if moved else ''}{listed}."
    )
    doubts = {} if masked else {n: abs(b - a) / size_of(a) for n, (a, b) in moved.items()}
    if step:
        message += f" {step}."
    options = ("--at-rest", "mask") if moved and not masked else ()
    return [Finding("at_rest", message, names, tuple(doubts), 0.0, doubts, options, step)]
