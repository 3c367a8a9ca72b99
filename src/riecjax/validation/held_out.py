"""Whether a model predicts a recording that it was not identified from.

A simulation that runs to its end has shown nothing yet. The verdict is about the signals: a fit
(`nrmse_fit`) of 80 % and more is predicted well, of 50 to 80 % roughly, less is not predicted, and
below 0 % the measured mean would have been the better prediction.

**Fits.** With the error e and the measured x of mean m and standard deviation s over n samples,

    p   = 100 |e| / |x|                eq. (28)
    fit = 100 (1 - |e| / |x - m|)      NRMSE fit
    VAF = 100 (1 - var(e) / var(x))    variance accounted for.

|x|^2 = n (s^2 + m^2) and |x - m|^2 = n s^2, so p = (100 - fit) s / sqrt(s^2 + m^2): of a position
far from zero p is small even if its motion is predicted badly, while fit and VAF do not depend on
where zero is. |e|^2 / |x - m|^2 = 1 - R^2: a fit of 80 % is an R^2 of 0.96, 50 % one of 0.75. VAF
leaves the error's mean out as well: it is 100 R^2 for errors of zero mean and larger otherwise.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax import arrays as xp
from riecjax.errors import DataError, SimulationError
from riecjax.leaves import finite, told
from riecjax.records.record import Record, shared_length
from riecjax.records.signal import Signal, both
from riecjax.shows import Drawn
from riecjax.simulation.linearisation import jacobians, spread_points
from riecjax.simulation.method import AbstractMethod
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import (
    PREDICTS_WELL,
    AbstractSystem,
    compared_signals,
    input_levels,
    measured_states,
    state_sources,
)

PREDICTS_ROUGHLY = 50.0
"""Fit in percent from which a signal is predicted at all."""


def nrmse_fit(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """100 (1 - ||predicted - measured|| / ||measured - mean||) in percent, over the last axis.

    100 is perfect, 0 as good as the measured mean, below 0 worse than it. Samples that are not
    `present` are left out. NaN of a signal that does not vary.
    """
    return _measures(predicted, measured, present)[1]


def variance_accounted_for(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """100 (1 - var(predicted - measured) / var(measured)) in percent, over the last axis.

    100 for a prediction that is off by a constant only. Samples that are not `present` are left
    out. NaN of a signal that does not vary.
    """
    return _measures(predicted, measured, present)[2]


def percentage_error(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """p_i of eq. (28): 100 ||predicted - measured|| / ||measured||, over the last axis.

    0 is perfect; predicting zero gives 100. Samples that are not `present` are left out.
    """
    return _measures(predicted, measured, present)[0]


def _measures(
    predicted: Array, measured: Array, present: Array | None
) -> tuple[Array, Array, Array]:
    """p, NRMSE fit and VAF in percent, over the last axis."""
    valid = xp.broadcast_to(True if present is None else present, measured.shape)
    count = xp.maximum(xp.sum(valid, axis=-1, keepdims=True), 1)

    def spread(values: Array) -> Array:
        """Sum of squares about the mean."""
        mean = xp.sum(xp.where(valid, values, 0.0), axis=-1, keepdims=True) / count
        return xp.sum(xp.where(valid, values - mean, 0.0) ** 2, axis=-1)

    error, reference = (xp.where(valid, each, 0.0) for each in (predicted - measured, measured))
    energy, whole = xp.sum(error**2, axis=-1), spread(measured)
    varies = whole > 0
    scale = xp.where(varies, whole, 1.0)
    # The root of 0 has no derivative, and a perfect prediction is where a fit wants to go.
    imperfect = energy / scale > 0
    root = xp.where(imperfect, xp.sqrt(xp.where(imperfect, energy / scale, 1.0)), 0.0)
    return (
        100 * xp.sqrt(energy) / xp.sqrt(xp.sum(reference**2, axis=-1)),
        xp.where(varies, 100 * (1 - root), xp.nan),
        xp.where(varies, 100 * (1 - spread(error) / scale), xp.nan),
    )


class Validation(dict[str, Array]):
    """p_i in percent by signal name; `total` is their sum, as in Table 5."""

    @property
    def total(self) -> Array:
        """Sum over the signals."""
        return sum(self.values(), start=xp.zeros(()))


def in_both(predicted: Record, measured: Record, name: str) -> tuple[Array, Array, Array | None]:
    """A signal of both records, and where both have their sample of it; `None` if everywhere."""
    present: Any = both(predicted.signal(name).present, measured.signal(name).present)
    return predicted[name], measured[name], present


def validate(predicted: Record, measured: Record, signals: Sequence[str]) -> Validation:
    """p_i of every signal of a simulated record, compared with the measured one.

    Samples that are missing in either record are left out.

    **Raises:** `DataError` if a signal is missing in either record.
    """
    return Validation({s: percentage_error(*in_both(predicted, measured, s)) for s in signals})


class SignalFit(NamedTuple):
    """How well one signal is predicted, in percent, over `samples` samples."""

    p: Float[Array, ""]
    """Error of eq. (28); 0 is perfect."""
    fit: Float[Array, ""]
    """`nrmse_fit`; 100 is perfect, 0 the measured mean."""
    vaf: Float[Array, ""]
    """Variance accounted for; 100 is perfect but for a constant."""
    samples: int

    @property
    def grade(self) -> str:
        """well, roughly, not, worse than its mean; or unknown, of a signal that does not vary."""
        fit = float(self.fit)
        if np.isnan(fit):
            return "unknown"
        if fit >= PREDICTS_WELL:
            return "well"
        if fit >= PREDICTS_ROUGHLY:
            return "roughly"
        return "not" if fit >= 0 else "worse than its mean"


SHORTEST_STRETCH = 20
"""Samples of an unbroken stretch below which it is skipped: it would be all transient."""


def unbroken_stretches(
    system: AbstractSystem,
    measured: Record,
    recorded: Sequence[str],
    sources: Mapping[str, str],
    horizon: float | None,
) -> list[tuple[int, int]]:
    """Unbroken stretches of the inputs, or parts of them, each from where the state is known."""
    present = measured.present(recorded)
    known = np.ones(measured.sample_count, bool) if present is None else np.asarray(present)
    if "differences" in sources.values():
        known = known & np.roll(known, -1) & np.roll(known, -2)
    # Without inputs a pause still breaks the motion: every recorded signal misses its sample there.
    names = system.input_names or tuple(recorded) or tuple(measured.arrays)
    found, samples = [], measured.sample_count
    if horizon is not None:
        samples = max(round(horizon / float(measured.time_step)), SHORTEST_STRETCH)
    for whole in measured.segments(names):
        # Parts of a horizon or a little more.
        count = max((whole.stop - whole.start) // samples, 1)
        edges = np.linspace(whole.start, whole.stop, count + 1).astype(int).tolist()
        for first, stop in itertools.pairwise(edges):
            starts = np.flatnonzero(known[first:stop])
            if starts.size and stop - first - starts[0] >= SHORTEST_STRETCH:
                found.append((first + int(starts[0]), stop))
    if not found:
        raise DataError(
            f"no unbroken stretch of {SHORTEST_STRETCH} samples is left in which "
            f"{', '.join(names)} are recorded."
        )
    return found


class HeldOut(Drawn, eqx.Module):
    """What became of a model on a recording.

    **Fields:**

    - `signals`: fit of each signal that was compared.
    - `judged`: those that `predicts` is about: the states, or what the caller named.
    - `reason` why not every stretch was simulated to its end; empty where it `ran`.
    - `predicts`: it ran, and every judged signal has a fit of at least 50 %.
    - `verdict`: one sentence about all of this.
    - `record`: inputs and everything simulated, on the time of the measured record; samples that
      were not simulated are marked missing.
    - `stretches`: (first, past last) sample of each simulated stretch.
    - `started_from`: for each state `measured`, `differences` (of its recorded integral), `given`,
      `zero`, or of a hidden element that moves along with its body `carried`.
    - `drifting`: positions that are off while their velocity is predicted: free integrals.
    - `horizon`: seconds after which the simulation started anew; `None` if it did not.
    - `measured`: the signals that were compared, as recorded.
    """

    signals: dict[str, SignalFit]
    record: Record
    judged: tuple[str, ...] = eqx.field(static=True)
    reason: str = eqx.field(static=True)
    predicts: bool = eqx.field(static=True)
    verdict: str = eqx.field(static=True)
    stretches: tuple[tuple[int, int], ...] = eqx.field(static=True)
    started_from: tuple[tuple[str, str], ...] = eqx.field(static=True)
    drifting: tuple[str, ...] = eqx.field(static=True)
    horizon: float | None = eqx.field(static=True, default=None)
    measured: Record | None = None

    @property
    def ran(self) -> bool:
        """Whether every stretch was simulated to its end."""
        return not self.reason

    @property
    def worst_fit(self) -> float:
        """The worst fit in percent of any judged signal; -inf if it did not run."""
        fits = [float(self.signals[name].fit) for name in self.judged] if self.ran else []
        return min((fit for fit in fits if fit == fit), default=-float("inf"))

    def entry(self) -> dict[str, Any]:
        """Everything but the record, as plain data for JSON; fits in percent, `None` if unknown."""
        return {
            **told(self, "ran", "reason", "predicts", "verdict"),
            "signals": {
                name: {
                    "p_percent": finite(one.p),
                    "fit_percent": finite(one.fit),
                    "vaf_percent": finite(one.vaf),
                    "samples": one.samples,
                    "grade": one.grade,
                    "judged": name in self.judged,
                }
                for name, one in self.signals.items()
            },
            "stretches": [list(stretch) for stretch in self.stretches],
            "samples": self.record.sample_count,
            "samples_simulated": sum(stop - start for start, stop in self.stretches),
            "started_from": dict(self.started_from),
            "drifting": list(self.drifting),
            "horizon_s": self.horizon,
            "rule": {
                "well_from_fit_percent": PREDICTS_WELL,
                "roughly_from_fit_percent": PREDICTS_ROUGHLY,
            },
        }


def validate_held_out(
    system: AbstractSystem,
    measured: Record,
    *,
    signals: Sequence[str] | None = None,
    method: AbstractMethod | None = None,
    initial_state: Mapping[str, Array | float] | None = None,
    horizon: float | None = None,
) -> HeldOut:
    """Simulate along the measured inputs from the measured state, and compare.

    Every stretch in which all inputs have their samples is simulated from the state measured at its
    start; stretches under 20 samples are skipped. A state that is not recorded starts from
    one-sided differences if it is the velocity of a recorded state, otherwise from zero, and the
    verdict says so. Hidden modes start moving along with their bodies. Not under jit.

    **Arguments:**

    - `signals`: what to compare and judge. By default every state and other simulated quantity
      that the record holds is compared, and the states are judged if any is there.
    - `method`: as for `simulate`.
    - `initial_state`: state name to value at the start; at later stretches only of those states
      that are not recorded.
    - `horizon`: start anew from what was recorded after so many seconds, at least 20 samples: of an
      unstable motion the rest shows no more than how its first error grew.

    **Raises:** `DataError` if an input or one of `signals` is not in the record, if nothing can be
    compared, or if no stretch has 20 samples; `ModelError` for a state or a signal that the system
    does not have.
    """
    given = dict(initial_state or {})
    system.require_states(given)
    judged = compared_signals(system, [measured], signals)
    compared = signals or [name for name in system.simulated_names if name in measured.arrays]
    recorded = [name for name in system.state_names if name in measured.arrays]
    sources = state_sources(system, measured)
    sources |= {name: "carried" for name in system.carried if sources[name] == "zero"}
    sources |= dict.fromkeys(given, "given")
    # A free motion has no inputs: some signal only says how many samples there are.
    driving = system.input_names or list(measured.arrays)[:1]
    stretches = unbroken_stretches(system, measured, recorded, sources, horizon)
    arrays: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    reason = ""
    for start, stop in stretches:
        # What the caller gives holds at the start; further on the record knows better.
        first = {
            name: value
            for name, value in given.items()
            if start == stretches[0][0] or name not in recorded
        }
        states = measured_states(system, measured.part(start, start + 3), first)
        first = dict(zip(system.state_names, np.asarray(states)[0]))
        count = stop - start
        # Each length compiles; of those that others share there are few.
        places = start + np.minimum(np.arange(shared_length(count)), count - 1)
        inputs = Record({n: measured[n][places] for n in driving}, measured.time_step)
        simulation = simulate(system, inputs, method=method, initial_state=first)
        reached = min(int(simulation.samples_reached), count)
        if reached < count and not reason:
            try:
                simulation.checked()
            except SimulationError as error:
                reason = str(error)
        # All that was simulated on the time of the measured record.
        made = simulation.record.select(*system.simulated_names)
        units |= dict(made.units)
        part = slice(start, start + reached)
        for name, values in made.arrays.items():
            array = arrays.setdefault(name, np.full(measured.sample_count, np.nan))
            array[part] = np.asarray(values)[:reached]
    units |= dict(measured.units)
    record = measured.with_signals(
        {name: Signal.of(values, units.get(name, "")) for name, values in arrays.items()}
    ).select(*system.input_names, *arrays)
    fits = {}
    for name in compared:
        values, truth, present = in_both(record, measured, name)
        samples = truth.size if present is None else int(xp.sum(present))
        fits[name] = SignalFit(*_measures(values, truth, present), samples)
    # Positions that are not predicted though their velocity is, and that nothing depends on.
    drifting = [
        position
        for position, velocity in system.velocity_of.items()
        if position in fits
        and velocity in fits
        and fits[position].grade in ("not", "worse than its mean")
        and fits[velocity].grade in ("well", "roughly")
    ]
    if drifting:
        chosen = np.flatnonzero(~np.isnan(arrays[system.state_names[0]]))
        chosen = chosen[spread_points(chosen.size)]
        states = measured_states(system, record)[chosen]
        influence = jacobians(system, states, input_levels(system, measured)[chosen])
        place = system.state_names.index
        drifting = [q for q in drifting if not bool(xp.any(influence[:, :, place(q)]))]
    grades = {name: fits[name].grade for name in judged}
    graded = {*grades.values()} - {"unknown"}
    predicts = not reason and bool(graded) and graded <= {"well", "roughly"}
    phrases = {
        "well": "predicted well",
        "roughly": "predicted roughly",
        "not": "not predicted",
        "worse than its mean": "predicted worse than by the measured mean",
        "unknown": "constant in the record and cannot be judged",
    }
    parts = []
    for grade, phrase in phrases.items():
        if names := [name for name in judged if grades[name] == grade]:
            shown = ", ".join(f"{max(float(fits[name].fit), -999.0):.1f}" for name in names)
            of_fit = "" if grade == "unknown" else f" (fit {shown} %)"
            parts.append(f"{_are(names)} {phrase}{of_fit}")
    parts += [
        f"{name} drifts since it only adds up {system.velocity_of[name]}, which is predicted, and "
        f"nothing in the model pulls it back"
        for name in drifting
    ]
    for start in ("differences", "zero"):
        if names := [name for name, source in sources.items() if source == start]:
            parts.append(f"{_are(names)} not recorded and started from {start}")
    head = "predicts the record" if predicts else "does not predict the record"
    anew = "" if horizon is None else f", anew from the recording every {horizon:.3g} s,"
    verdict = f"It ran{anew} {'and' if predicts else 'but'} {head}: {'; '.join(parts)}."
    return HeldOut(
        fits,
        record,
        judged,
        reason,
        predicts,
        f"It did not run: {reason}" if reason else verdict,
        tuple(stretches),
        tuple(sources.items()),
        tuple(drifting),
        horizon,
        measured.select(*compared),
    )


def _are(names: Sequence[str]) -> str:
    return f"{', '.join(names)} {'is' if len(names) == 1 else 'are'}"
