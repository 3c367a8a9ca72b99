"""The verb: which terms a model lacks, told from recordings."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.suited import criterion_for, with_velocities
from riecjax.discovery.candidate import AnyCandidate, Candidate, as_candidates, default_candidates
from riecjax.discovery.discovery import Chosen, Discovery, Rejected, is_more_than_noise
from riecjax.discovery.search import (
    Again,
    Offer,
    Search,
    Step,
    Sums,
    again,
    by_equation,
    extended,
    members,
    without_taken,
    without_twins,
)
from riecjax.equations.equation import Equation
from riecjax.equations.hidden_elements import (
    HiddenMode,
    ModeParameters,
    accelerated,
    mode_frequency,
)
from riecjax.equations.memories import with_memories
from riecjax.equations.model import Model, as_model, with_rests
from riecjax.equations.motions import reading_velocities
from riecjax.errors import DataError, ModelError, RiecjaxError
from riecjax.estimation.check import of_sensors, read_of
from riecjax.estimation.estimate import EquationFit, Estimate
from riecjax.estimation.identify import identify
from riecjax.estimation.parameters import plan_parameters
from riecjax.records.preparation.alignment import shift
from riecjax.records.record import Records
from riecjax.records.recording import Recording, as_recordings
from riecjax.settings import Discover as DiscoverSettings
from riecjax.settings import taking
from riecjax.summaries.task import ready
from riecjax.uncertainty.intervals import AbstractIntervals, intervals_of
from riecjax.validation.late_signals import SignalDelay, finding_of, late_cause

if TYPE_CHECKING:
    from riecjax.findings import Finding

FEWEST = 6
"""Folds of time that a choice is made from at the least."""
LATE = 3
"""Delays that are taken off at the most, one after the other."""
TAKEN_OFF = "terms are of recordings with it in time"
IN_DISORDER = ("late_signal", "low_passed", "two_clocks", "lost_rows", "not_its_derivative")
"""What is amiss among the sensors of one motion."""


@taking(DiscoverSettings)
def discover(model: Equation | Model, records: Records, settings: DiscoverSettings) -> Discovery:
    """Find the terms that a model lacks, by what they predict of blocks of time left out.

    The model's own terms stay. Candidates are added, exchanged and taken away again by what they
    explain of the motion beyond the sensors' noise, all from one pass over the samples, and only
    what chance does not explain is kept: of a model that lacks nothing one search in twenty adds a
    term at most. Not under jit.

    **Arguments:** `model`, `records`, `criterion`, `known`, `intervals`, `noise` and `at_rest` as
    for [`identify`][];

    - `candidates` that the model may lack: terms, [`Candidate`][riecjax.discovery.Candidate]s or
      [`Shaped`][riecjax.discovery.Shaped]s; by default the [`default_candidates`][] of its motions,
      a signal's delay, and a hidden mode.
    - `hold_out`: share at the end of each recording that has no part in the choice, and from which
      alone parameters and their intervals come then. Without it all is used for both, and
      standard errors include the choice, by searching again in data drawn again.
    - `least`: share of what is unexplained that a term must make up for; `smallest`, share of the
      target's energy: how exact the recordings are.
    - `resamples`: how many times that is done; `seed` of what is drawn.

    **Returns:** a [`Discovery`][riecjax.discovery.Discovery].

    **Raises:** as [`identify`][]; `ModelError` for a model with hidden elements, and for candidates
    that are none; `DataError` for recordings too short to leave blocks of time out.
    """
    model = with_rests(as_model(model), settings.at_rest)
    if model.has_hidden:
        raise ModelError(
            "terms are looked for beside a model without hidden modes and springs: leave these out."
        )
    # In the model's own words: of candidates none can be known, nor set a scale.
    if unknown := [name for name in settings.known if name not in model.parameter_names]:
        raise ModelError(
            f"unknown parameter '{unknown[0]}'; the model has: {', '.join(model.parameter_names)}."
        )
    model.plan({*model.known, *settings.known})
    # Velocities that candidates read and no sensor measured are formed, if they can be.
    reading, recordings = reading_velocities(model), []
    for one in as_recordings(records):
        with contextlib.suppress(DataError):  # too short, which sums will say
            record, steps = with_velocities(reading, one.record)
            one = replace(one, record=record, steps=(*one.steps, *steps))
        recordings.append(one)
    if settings.candidates is None:
        units = {signal.name: signal.unit for signal in model.signals}
        sampled = [one.record for one in recordings]
        for record in sampled:
            units |= {name: unit for name, unit in dict(record.units).items() if unit}
        names = [name for stage in model.equation_names for name in stage]
        usual = default_candidates(model.equations, names, sampled, units)
        offered = without_twins(without_taken(usual, model.parameter_names), model)
    else:
        offered = as_candidates(settings.candidates)
    with_all = extended(model, members(offered))
    plan_parameters(with_all, 1, settings.known, ())
    whole = ready(with_all, recordings, settings.noise)
    plain = [one.record for one in whole]
    own = criterion_for(settings, model, plain)
    # Without draws of its own, standard errors by blocks are the same.
    usual = settings.intervals in (None, "bootstrap") and settings.seed == 0
    intervals = None if usual else intervals_of(settings.intervals, settings.seed)
    for one in whole:  # before they are given states that nobody recorded
        read_of(model, one, own)
    held = {**{name: float(value) for name, value in model.known.items()}, **settings.known}
    asked = _Asked(model, offered, own, held, intervals, settings)
    if settings.candidates is not None:  # these, and nothing else
        return _found(asked, whole)[0]
    answer, in_time = _in_time(asked, whole)
    if not answer.leaves_more or any(one.code in IN_DISORDER for one in answer.amiss):
        return answer
    return _with_mode(asked, answer, in_time)


class _Asked(NamedTuple):
    """What is asked of the recordings, however often they are searched."""

    model: Model
    offered: list[AnyCandidate]
    criterion: AbstractCriterion
    known: Mapping[str, float]
    intervals: AbstractIntervals | None
    settings: DiscoverSettings

    def parts(self, recordings: list[Recording]) -> tuple[list[Recording], list[Recording]]:
        """What is searched, and what values are from."""
        if self.settings.hold_out is None:
            return recordings, recordings
        first, last = zip(*(one.split(self.settings.hold_out) for one in recordings))
        return list(first), list(last)

    def identified(
        self, model: Model, recordings: list[Recording], criterion: AbstractCriterion | None
    ) -> Estimate:
        """The estimate of a model."""
        settings = {"intervals": self.intervals, "at_rest": self.settings.at_rest}
        return identify(model, self.parts(recordings)[1], criterion, known=self.known, **settings)


def _in_time(asked: _Asked, recordings: list[Recording]) -> tuple[Discovery, list[Recording]]:
    """What is found once signals are in time that come late against the terms found.

    Terms stand for a delay: damping turns a phase as well. It is taken off only where a search
    leaves less without it.
    """
    found, late = _found(asked, recordings)
    known: list[Finding] = []
    while late is not None and len(known) < LATE:
        told = found.findings[-1]
        if told.code != "late_signal":
            break
        moved = dict.fromkeys(late.signals, late.seconds)
        try:
            in_time = [replace(one, record=shift(one.record, moved)) for one in recordings]
            again, late = _found(asked, in_time)
        except RiecjaxError:  # nothing is left of a signal
            break
        if _left(again) >= _left(found):
            break
        delays = {name: found.delays.get(name, 0.0) + more for name, more in moved.items()}
        known.append(told._replace(message=f"{told.message.partition('. ')[0]}; {TAKEN_OFF}"))
        found, recordings = replace(again, delays={**found.delays, **delays}), in_time
    return replace(found, findings=(*known, *found.findings)), recordings


def _left(found: Discovery) -> float:
    """What is unexplained of all equations, noise not counted."""
    return sum(steps[-1].of_motion for steps in found.paths.values())


def _found(asked: _Asked, whole: list[Recording]) -> tuple[Discovery, SignalDelay | None]:
    """What is found in recordings as they are, and the delay that explains what is left."""
    first, last = asked.parts(whole)
    model, settings = asked.model, asked.settings
    shares = settings.least, settings.smallest
    sums = Sums(model, first, asked.criterion, asked.offered, asked.known, *shares)
    stages = _searched(sums)
    times = 0 if settings.hold_out is not None else settings.resamples
    drawn = [again(search, chosen, settings.seed, times) for search, chosen in stages]
    chosen = [_as_chosen(sums, search, of, one, drawn) for search, of in stages for one in of]
    larger = _with_chosen(model, chosen)
    estimate = asked.identified(larger, whole, asked.criterion)
    # What is amiss with recordings, and what is late against the equations.
    amiss: list[Finding] = []
    records = [with_memories(one.record, larger.memories) for one in last]
    for one, record in zip(last, records, strict=True):
        one = replace(one, record=record)
        read = read_of(larger, one, estimate.criterion)
        amiss += [*one.concerning(read).findings, *of_sensors(larger, one, read)]
    late = None
    # Of signals that contradict each other an equation blames the wrong one.
    if not any(one.code in IN_DISORDER for one in amiss):
        with contextlib.suppress(RiecjaxError):  # too short to tell
            late = late_cause(larger, records, estimate)
    amiss += [] if late is None else [finding_of(late, records[0])]
    # The nearest of each law.
    rejected: dict[str, Rejected] = {}
    for search, of_stage in stages:
        for offer, gain, chance in search.next_best(of_stage):
            rejected.setdefault(offer.family, Rejected(offer.family, gain, chance))
    found = Discovery(
        larger,
        model,
        tuple(chosen),
        tuple(sorted(rejected.values(), key=lambda one: -one.gain)),
        {
            " + ".join(names): tuple(search.path(of_stage))
            for names, (search, of_stage) in zip(model.equation_names, stages, strict=True)
            if search.offers
        },
        estimate,
        _errors(estimate, stages, chosen, drawn),
        settings.hold_out or 0.0,
        sum(len({one.family for one in search.offers}) for search, _ in stages),
        tuple({one.message: one for one in amiss}.values()),
    )
    return found, late


def _searched(sums: Sums) -> list[tuple[Search, list[Offer]]]:
    """A search of each stage that terms were offered to, and what it found."""
    found: dict[str, float] = {}
    stages = []
    for number, _ in enumerate(sums.model.stages):
        search, chosen = sums.settled(number, found)
        if search.folds.number < FEWEST:
            raise DataError(
                f"the recordings hold {search.folds.number} blocks of time, of which terms are to "
                f"be chosen by leaving some out: {FEWEST} are needed. Record for longer, or choose "
                f"a smaller beta."
            )
        places = [step.added for step in search.path(chosen)]
        chosen = sorted(chosen, key=lambda one: places.index(one.family))
        names = (*search.kept, *(name for one in chosen for name in one.columns))
        found |= dict(zip(names, map(float, search.folds.fitted(names))))
        stages.append((search, chosen))
    return stages


def _as_chosen(
    sums: Sums, search: Search, beside: Sequence[Offer], offer: Offer, drawn: Sequence[Again]
) -> Chosen:
    shares = [one.shares[offer.family] for one in drawn if offer.family in one.shares]
    share = max(shares, default=np.nan)
    one = sums.candidate(offer.family)
    if isinstance(one, Candidate):
        return Chosen(one, None, "", np.nan, share)
    assert offer.number is not None
    width = float(one.widths[offer.number])
    error = sums.width_error(search, beside, offer)
    return Chosen(one.chosen(width), width, one.unit, error, share)


def _with_chosen(model: Model, chosen: Sequence[Chosen]) -> Model:
    candidates = [one.candidate for one in chosen]
    if not candidates:
        return model
    meanings = {name: one.meaning for one in candidates for name in one.columns}
    memories = list(dict.fromkeys(memory for one in candidates for memory in one.memories))
    return model.with_terms(by_equation(model, candidates), memories=memories, meanings=meanings)


def _errors(
    estimate: Estimate,
    stages: Sequence[tuple[Search, list[Offer]]],
    chosen: Sequence[Chosen],
    drawn: Sequence[Again],
) -> dict[str, float]:
    """Standard errors that include the choice: never less than the estimate's own."""
    taken = [one for _, of_stage in stages for one in of_stage]
    called = {
        name: other
        for offer, one in zip(taken, chosen, strict=True)
        for name, other in zip(offer.columns, one.candidate.columns, strict=True)
    }
    own = dict(zip(estimate.parameters, map(float, estimate.standard_errors)))
    for one in drawn:
        for name, error in one.errors.items():
            final = called.get(name, name)
            if final in own and error == error:
                own[final] = max(own[final], error)
    return own


# A further hidden mode, instead of terms or beside them.
#
# An oscillator on a body rings in the body's equation. Terms of its velocity and position explain a
# part of that, one more for each thing that it does, and are no forces of the machine. Its three
# coefficients do not stand in the sums of candidates: `identify` finds them, and
# what both leave beyond noise says which it is.

LEAVES = 0.3
"""Of the error beyond noise that terms leave, rms, what is left with a mode at most that is
added: a tenth of the energy."""
TOLD = 3.0
"""Standard errors from zero of a term that stays beside a mode; without the mode it may have stood
for it."""


def _with_mode(asked: _Asked, found: Discovery, recordings: list[Recording]) -> Discovery:
    """The same, or where much less is left with a hidden mode, with it: instead of all terms, or
    beside those that are still told from zero."""
    model = found.start
    # Hidden elements have criteria of their own.
    criterion = asked.criterion if asked.settings.says_of_criterion else None
    stages = {name: " + ".join(names) for names in model.equation_names for name in names}
    bodies = {n: accelerated(one) for n, one in zip(stages, model.equations, strict=True)}
    fits = found.estimate.equations
    for name in sorted((n for n in stages if bodies[n]), key=lambda n: -float(fits[n].model_rms)):
        most = LEAVES * float(fits[name].model_rms)
        for on in reversed(bodies[name]):

            def beside(chosen: Sequence[Chosen], by: _Asked = asked, on: str = on) -> Estimate:
                larger = _with_chosen(model, chosen).with_modes(HiddenMode(on))
                return by.identified(larger, recordings, criterion)

            try:
                chosen, estimate = _staying(found, name, beside, asked)
            except RiecjaxError:  # no mode is to be found on this body
                continue
            if float(estimate.equations[name].model_rms) < most:
                start = found.estimate
                if found.chosen:
                    start = asked.identified(model, recordings, criterion)
                number = ModeParameters.of(len(model.modes))
                frequency, _ = mode_frequency(estimate.values, number)
                stage = stages[name] if stages[name] in found.paths else name
                terms = " + ".join(one.candidate.name for one in chosen)
                path = [_step(terms, fits[name])] if chosen else []
                last = _step("mode", estimate.equations[name])
                mode = HiddenMode(on, float(f"{float(frequency):.4g}"))
                errors = map(float, estimate.standard_errors)
                return replace(
                    found,
                    model=_with_chosen(model, chosen).with_modes(mode),
                    chosen=chosen,
                    rejected=(),
                    mode=mode,
                    paths={stage: (_step("", start.equations[name]), *path, last)},
                    estimate=estimate,
                    errors=dict(zip(estimate.parameters, errors, strict=True)),
                )
    return found


def _staying(
    found: Discovery, name: str, beside: Callable[..., Estimate], asked: _Asked
) -> tuple[tuple[Chosen, ...], Estimate]:
    """Terms that stay beside a mode, and the estimate with both; `beside` makes one of terms."""
    alone = beside(())
    left = _step("mode", alone.equations[name])
    if not found.chosen or not is_more_than_noise(left):
        return (), alone
    # Standard errors by blocks of time, whatever intervals were asked for.
    both = beside(found.chosen, asked._replace(intervals=None))
    errors = dict(zip(both.parameters, map(float, both.standard_errors), strict=True))
    stay = tuple(
        one
        for one in found.chosen
        if any(abs(float(both[n])) > TOLD * errors[n] for n in one.candidate.columns)
    )
    if len(stay) < len(found.chosen) or asked.intervals is not None:
        both = beside(stay) if stay else alone
    less = _step("mode", both.equations[name]).of_motion < 0.5 * left.of_motion
    return (stay, both) if less else ((), alone)


def _step(added: str, fit: EquationFit) -> Step:
    """What a fit leaves, of all that it was fitted to."""
    whole, of_motion = (float(of) ** 2 for of in (fit.relative_rms, fit.model_rms))
    return Step(added, whole, of_motion, float("nan"), float("nan"))
