"""What the data demand of a model's equations: faults of sensors and missing terms, in words.

All doubts are weighed at once, from one pass over rows of windows. A delay that is significant is
undone, taken again, and held against a low-pass; one that changes along the record is followed. A
cause is told where it explains nearly all that the model leaves beyond noise and moves a parameter;
what explains as much is named beside it, and where that is so, no option is proposed: the
recordings cannot tell which of them would be right.
"""

import copy
import shlex
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from riecjax.doubts.causes import CLEARER, FEWEST, LEVEL, LOST, NO_DELAYS, OF_NOISE, Causes
from riecjax.doubts.columns import (
    STATES,
    Asked,
    Doubt,
    folds_of,
    longest_delay,
    plausible,
    sensors,
)
from riecjax.doubts.delays import (
    LEAST,
    SMALLEST,
    Course,
    Settled,
    Shifts,
    low_pass_of,
    settled,
)
from riecjax.doubts.lacked_elements import best_element, elsewhere
from riecjax.equations import expressions
from riecjax.equations.element import Told
from riecjax.equations.expressions import constant
from riecjax.equations.model import Model, as_model
from riecjax.equations.motions import per
from riecjax.estimation.estimate import Estimate
from riecjax.findings import FINEST, Finding, in_percent, joined, option_for
from riecjax.records.record import Record
from riecjax.records.time_base import PPM
from riecjax.summaries.summarise import signals_read

HALF = 0.5
"""Share of what is left that a delay's column leaves at most, for the delay to be undone."""
MOVES = 1.0
"""Standard errors by which a cause moves some parameter at the least."""
NOTABLE = 0.02
"""Rms that is left, over the target's, from which a cause matters whatever it moves."""
NEAR = 8
"""Doubts that gain most, of which noise is taken off."""


class Cause(NamedTuple):
    """A doubt that the data demand.

    **Fields:** `doubt`; its `size` in the unit of its column; rms that is left beyond noise with
    it, `left`, and without, `before`, as shares of the target's; `moved`, shares by which
    parameters change with it or with what explains as much, and `own` with it alone; what is found
    once it is `undone`;
    `offset` of what drifts at the record's middle; `instead`, other doubts that explain nearly as
    much, of which some are the `same` column, and `certain`, whether all others leave clearly more;
    whether it `is_part` of what is amiss, which is to be undone before the rest is found;
    `admitted`, all doubts that were let in one after the other, where nothing explains what is
    left, and these a part of it.
    """

    doubt: Doubt
    size: float
    before: float
    left: float
    moved: Mapping[str, float]
    undone: Settled | None = None
    offset: float = 0.0
    certain: bool = True
    is_part: bool = False
    instead: tuple[Doubt, ...] = ()
    same: tuple[Doubt, ...] = ()
    admitted: tuple[Doubt, ...] = ()
    own: Mapping[str, float] = {}


@dataclass(eq=False)
class Weighing:
    """What is `asked`, on records: all doubts as `rough` ones, of which noise is not taken off, and
    those that may be a cause, as `causes`; signals whose delay may be `changing` along a record;
    whether the equation `is_exact` but for noise, or may leave out what rough shapes explain,
    hysteresis and modes."""

    asked: Asked
    records: Sequence[Record]
    rough: Causes
    causes: Causes
    changing: Collection[tuple[str, ...]] = ()
    is_exact: bool = False

    @classmethod
    def of(
        cls,
        asked: Asked,
        records: Sequence[Record],
        doubts: Sequence[Doubt],
        is_exact: bool = False,
        is_moot: Callable[[Causes], bool] = lambda rough: False,
    ) -> "Weighing":
        """Noise is taken off those doubts alone that may be a cause, and states of hysteresis,
        whose shapes are rough, are tried where much is left; a first weighing of which `is_moot` is
        true has nothing to explain."""
        sizes = plausible(doubts, records)
        plain = [doubt for doubt in doubts if doubt.kind != STATES]
        rough = Causes(folds_of(asked, records, plain, "plain"), plain, sizes)
        if len(plain) < len(doubts) and rough.before > NOTABLE**2 * rough.folds.energy:
            rough = Causes(folds_of(asked, records, doubts, "plain"), doubts, sizes)
        asked = asked._replace(base=rough.base)
        # An equation that leaves out nothing is not explained by what is significant by chance.
        is_promising = rough.is_promising or (is_exact and any(map(rough.is_sure, rough.offered)))
        if not is_promising or is_moot(rough):
            none = copy.copy(rough)
            none.offered = []
            return cls(asked, records, rough, none, (), is_exact)
        delays = {doubt.signals: [doubt] for doubt in rough.of("delay")}
        changing = {
            one.signals
            for one in rough.of("clock")
            for beside in ([], delays.get(one.signals, []))
            if rough.is_sure(one, beside) and rough.left([*beside, one]) < HALF * rough.left(beside)
        }
        return cls(asked, records, rough, _likely(asked, records, rough), changing, is_exact)

    def found(self) -> list[Cause]:
        """What the data demand; nothing where nothing explains what is left."""
        causes = self.causes
        # Rough shapes, of hysteresis and of modes, tell nothing of what is little.
        is_notable = causes.before > NOTABLE**2 * causes.folds.energy
        others = causes.of(*NO_DELAYS, *([STATES] if is_notable else []))
        # Where something else explains what is left, no delay is too large for its column.
        explained = any(
            causes.is_sure(one) and causes.is_little(causes.left([one])) for one in others
        )
        large = causes.before > LOST * causes.folds.energy and not explained
        known = dict[Doubt, Settled]()
        for doubt in causes.of("zero", "gain", "delay"):
            is_delay = doubt.kind == "delay"
            undone = self._undone(doubt, large and is_delay)
            if is_delay and not explained:
                undone = self._followed(doubt, undone, large) or undone
            if undone is not None:
                known[doubt] = undone
                causes.settle(doubt, undone.left * causes.folds.energy)
        delays = [doubt for doubt in known if doubt.kind == "delay"]
        chosen = causes.demanded([*delays, *others], sure=known)
        drifting = [doubt for doubt in chosen if doubt.kind == "drift"]
        chosen = [doubt for doubt in chosen if not causes.is_zero_of(doubt, drifting)]
        if not chosen and self.is_exact:
            return self._part_of(known)
        if chosen:
            told = [self._cause(doubt, chosen, known.get(doubt)) for doubt in chosen]
            # A column tells of what is undone to first order alone: what it leaves is no doubt's.
            if self.is_exact or known.keys() & {*chosen}:
                return told
            # What drifts has a zero as well.
            is_zero = self.rough.is_zero_of
            zeros = [d for d in causes.every if d.kind == "zero" and is_zero(d, drifting)]
            return [*told, *self._part(None, [*chosen, *zeros])]
        element = self._element() if is_notable else None
        if element is not None and causes.is_little(element.left**2 * causes.folds.energy):
            return [element]
        return self._part(element)

    def _part(self, element: Cause | None, beside: Sequence[Doubt] = ()) -> list[Cause]:
        """Doubts that explain a part of what is left beside some, let in one after the other, with
        the farthest that any of them, or an element, moves each parameter."""
        fair, every = self.causes, [*beside]
        if self.rough.admitted(beside) != every:
            # What rough columns make sure of may be the noise that they share with regressors.
            fair = fair if fair.offered else _likely(self.asked, self.records, self.rough)
            every = fair.admitted(beside)
        chosen = every[len(beside) :]
        some = (fair.names(every[:count]) for count in range(len(beside), len(every) + 1))
        fits = [fair.folds.values(names) for names in some]
        moves = [self._moved(fit, fits[0]) for fit in fits[1:]]
        moved = _farthest([*moves, *([] if element is None else [element.moved])])
        before, left = (fair.rms(fair.left(some)) for some in (beside, every))
        if chosen and (element is None or left < element.left):
            size = fits[-1][chosen[0].name]
            return [Cause(chosen[0], size, before, left, moved, admitted=tuple(chosen))]
        return [] if element is None else [element._replace(moved=moved, admitted=(element.doubt,))]

    def _part_of(self, known: Mapping[Doubt, Settled]) -> list[Cause]:
        """The delay that explains most of what is left, where others are beside it: columns of what
        is as large are right to first order alone."""
        causes = self.causes
        delays = [doubt for doubt in known if doubt.kind == "delay" and known[doubt].course is None]
        best = min(delays, key=lambda delay: causes.left([delay]), default=None)
        if best is None or not causes.left([best]) < HALF * causes.before:
            return []
        return [self._cause(best, [best], known[best])._replace(is_part=True)]

    def _undone(self, doubt: Doubt, large: bool) -> Settled | None:
        """A delay, zero or gain once it is undone, since its column is right to first order alone,
        if it is no chance; of a delay the low-pass that leaves less. One that may be too `large`
        for its column is looked for farther away."""
        causes, energy = self.causes, self.causes.folds.energy
        near = causes.is_sure(doubt) and causes.left([doubt]) < HALF * causes.before
        # What is the same as a constant is right as it is.
        is_straight = doubt.kind != "delay" and causes.same_as(doubt, causes.of("zero", "term"))
        if is_straight or not (large or near):
            return None
        most = causes.plausible[doubt.name]
        found = settled(self.asked, self.records, doubt, most)
        if large and (found is None or not causes.is_little(found.left * energy)):
            shift = Shifts(self.asked, self.records, doubt.signals).start()
            start = shift * float(self.records[0].time_step)
            found = settled(self.asked, self.records, doubt, most, start)
        if found is None or not abs(found.size) > found.reach:
            return None
        if doubt.kind == "delay" and not abs(found.samples) > SMALLEST:
            return None
        if doubt.kind != "delay" or found.size < 0:
            return found
        share = low_pass_of(self.asked, self.records, doubt, found.size)
        if share.chance < LEVEL and share.value > HALF:
            return settled(self.asked, self.records, doubt, most, found.size, True) or found
        return found._replace(certain=share._replace(value=share.value - 1).chance < LEVEL)

    def _cause(
        self,
        doubt: Doubt,
        chosen: Sequence[Doubt],
        undone: Settled | None,
        causes: Causes | None = None,
    ) -> Cause:
        """One of the doubts that are chosen, with what it does."""
        causes = causes or self.causes
        folds = causes.folds
        beside = [other for other in chosen if other is not doubt]
        drifts = doubt.kind == "drift"
        zeros = [one for one in causes.of("zero") if drifts and one.signals == doubt.signals]
        chosen = [*chosen, *zeros]
        names, without = causes.names(chosen), causes.names(beside)
        after = folds.values(names)
        if undone is None and doubt.kind in ("zero", "gain", "drift"):
            # Its column is made with the parameters that it moves.
            again = folds_of(self.asked.with_values(after), self.records, chosen)
            after = again.values(names)
        # Of delays that change the best is told.
        instead = [] if undone is not None and undone.course else causes.instead(chosen, doubt)
        before = folds.values(without)
        others = [folds.values(causes.names([*beside, other])) for other in instead]
        values = [after if undone is None else undone.values, *others]
        moves = [self._moved(each, before) for each in values]
        return Cause(
            doubt,
            after[doubt.name] if undone is None else undone.size,
            causes.rms(causes.left(beside)),
            causes.rms(causes.left(chosen)),
            _farthest(moves),
            undone,
            offset=after[zeros[0].name] if zeros else 0.0,
            certain=causes.is_certain(chosen, doubt, instead),
            same=tuple(causes.same_as(doubt, [one for one in causes.every if one in instead])),
            instead=tuple(instead),
            own=moves[0],
        )

    def _followed(self, doubt: Doubt, steady: Settled | None, large: bool) -> Settled | None:
        """The delay of a single record that changes along it, if that explains what is left, and
        clearly more of it than one that stays."""
        causes, energy = self.causes, self.causes.folds.energy
        if len(self.records) > 1 or not (large or doubt.signals in self.changing):
            return None
        if steady is not None and energy * steady.left <= OF_NOISE * causes.noise:
            return None
        shifts = Shifts(self.asked, self.records, doubt.signals, self.is_exact)
        found = shifts.course(0 if steady is None else round(steady.samples), large)
        if found is None or not causes.is_little(energy * found.left):
            return None
        if steady is None or not causes.is_little(energy * steady.left):
            return found
        return found if CLEARER * found.left < steady.left else None

    def _element(self) -> Cause | None:
        """An element in one of the places that explains what is left."""
        causes = self.causes
        element = best_element(self.asked, self.records)
        if element is None:
            return None
        folds = folds_of(element.asked, self.records, [element.doubt])
        found = Causes(folds, [element.doubt], {}, causes.trials)
        best = element.doubt
        if not (found.is_sure(best) and found.left([best]) < found.before):
            return None
        cause = self._cause(best, [best], None, found)
        moved = dict(cause.moved)
        for doubt, asked in elsewhere(element, self.records):
            folds = folds_of(asked, self.records, [doubt])
            names = [name for name in folds.parameters if name != doubt.name]
            moved = self._moved(folds.values(folds.parameters), folds.values(names)) | moved
        return cause._replace(moved=moved, own=moved)

    def _moved(self, after: Mapping[str, float], before: Mapping[str, float]) -> dict[str, float]:
        """Shares by which parameters change, each in the stage that finds it."""
        found: dict[str, float] = {}
        for column, value in before.items():
            name = column.partition(".")[2]
            if name in self.asked.values and name not in found and value and column in after:
                found[name] = after[column] / value - 1
        return found


def _likely(asked: Asked, records: Sequence[Record], rough: Causes) -> Causes:
    """The doubts that may be a cause, by products that noise is taken off."""
    resting = asked.resting_on_earlier
    near = [doubt for doubt in rough.nearest(NEAR) if doubt.equation not in resting]
    return Causes(folds_of(asked, records, near), near, rough.plausible, rough.trials)


def _farthest(moves: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Of each parameter the largest of its moves, with its sign."""
    names = dict.fromkeys(name for some in moves for name in some)
    return {name: max((some.get(name, 0.0) for some in moves), key=abs) for name in names}


def why_not_weighed(model: Model, records: Sequence[Record], estimate: Estimate) -> str:
    """Why columns tell no cause of what is left, in words; empty where they do."""
    if model.has_hidden:
        return "beside hidden elements"
    if any(estimate.table[name].recording is not None for name in estimate.parameters):
        return "beside parameters of each recording"
    if estimate.criterion.all_windows is None or estimate.summary is None:
        return "from windows drawn at random"
    told = int(estimate.block_count) >= FEWEST and longest_delay(records) > 2
    return "" if told else "from so short a record"


@np.errstate(all="ignore")
def demanded(
    model: Model,
    records: Sequence[Record],
    estimate: Estimate,
    lacked: Callable[[Model, Sequence[Record]], Sequence[Doubt]] = lambda model, records: (),
) -> list[Cause]:
    """What the data demand, of what may be amiss (not under jit).

    **Arguments:** `lacked`, terms that a model may lack, besides faults of its sensors.

    **Raises:** as [`summarise`][riecjax.summarise].
    """
    model, criterion = as_model(model), estimate.criterion
    read = {n for each in records for n in signals_read(model, each, criterion, summed=True)}
    doubts = [*sensors(model, records, read), *lacked(model, records)]
    try:
        weighing = Weighing.of(Asked.of(model, estimate), records, doubts)
        return [cause for cause in weighing.found() if _matters(cause, estimate)]
    except np.linalg.LinAlgError:  # of samples whose products are no numbers
        return []


def _matters(cause: Cause, estimate: Estimate) -> bool:
    """Whether it moves some parameter by more than chance does; a term, or what leaves much,
    matters in any case."""
    is_term = cause.doubt.term is not None and not cause.admitted
    if cause.admitted and max(map(abs, cause.moved.values()), default=0.0) < FINEST:
        return False
    if is_term or cause.before > NOTABLE:
        return True
    errors = dict(zip(estimate.parameters, np.asarray(estimate.standard_errors, float)))
    moved = {n: share * float(estimate[n]) for n, share in cause.moved.items() if n in errors}
    return any(abs(change) > MOVES * errors[name] for name, change in moved.items())


class Equated(NamedTuple):
    """What a signal is held against, in words: which `says` otherwise, and `leaves` so much `of`
    what it explains; the code of a `zero`."""

    says: str = "the equation says"
    leaves: str = "the model leaves"
    of: str = "the target"
    zero: str = "wrong_zero"


EQUATION = Equated()


def finding_of(
    cause: Cause, model: Model, records: Sequence[Record], against: Equated = EQUATION
) -> Finding:
    """The finding that a cause makes, seen in records of a model."""
    if cause.admitted:
        return _of_part(cause)
    names = cause.doubt.signals or tuple(n for one in cause.same for n in one.signals)
    if cause.doubt.elements:
        names = tuple(element.place for element in cause.doubt.elements)
    elif cause.doubt.term is not None and not names:
        names = expressions.signals_read(cause.doubt.term.of)
    elif cause.doubt.lacked is not None:
        names = (cause.doubt.lacked.element.place,)
    if cause.undone is not None and cause.undone.course is not None:
        said = _of_course(names, cause.undone.course, records[0])
    elif cause.doubt.kind == "delay" and cause.undone is not None:
        said = _of_delay(names, cause.undone, against.says)
    else:
        said = _of_size(cause, model, records[0], against.says)
    most = max(cause.own, key=lambda name: abs(cause.own[name]), default="")
    moves = f", and {most} changes by {in_percent(cause.own[most], '+.2g')}" if most else ""
    way = "taken off" if cause.doubt.signals else "let in"
    message = (
        f"{said.what}. With that {way}, {against.leaves} {in_percent(cause.left)} of {against.of} "
        f"beyond noise instead of {in_percent(cause.before)}{moves}."
    )
    remedy, step = said.remedy, said.step
    # The best term, and the best sensor.
    others = [one for one in cause.instead if one not in cause.same]
    kinds = {one.term is None: one for one in reversed(others)}
    others = [one for one in others if one in kinds.values()]
    if cause.same:
        message = f"{message} The same is {' or '.join(map(described, cause.same))}."
    if others:
        listed = " or ".join(map(described, others))
        message = f"{message} Nearly as much is explained by {listed}."
    if cause.certain:
        message = f"{message} {said.then}".rstrip()
    else:
        # Which of them would be right these recordings cannot tell.
        remedy, step = (), "Find out which it is by other motion, or by a calibration"
    doubts = {name: abs(share) for name, share in cause.moved.items()}
    code = against.zero if said.code == "wrong_zero" else said.code
    return Finding(code, message, names, tuple(doubts), doubts=doubts, remedy=remedy, step=step)


def described(doubt: Doubt) -> str:
    """A doubt, in a few words."""
    if doubt.term is not None:
        return f"{doubt.meaning} ({doubt.name})"
    if doubt.lacked is not None:
        return doubt.lacked.element.lacked_at(doubt.lacked.at)
    if doubt.kind == "clock":
        return f"a delay of {joined(doubt.signals)} that changes"
    return f"a {doubt.name}"


def _of_part(cause: Cause) -> Finding:
    """What is left without a cause, and what explains a part of it."""
    listed = joined([described(one) for one in cause.admitted])
    most = max(cause.moved, key=lambda name: abs(cause.moved[name]))
    message = (
        f"the model leaves {in_percent(cause.before)} of the target beyond noise, and nothing that "
        f"was weighed explains it alone. With {listed} let in, {in_percent(cause.left)} is left, "
        f"and {most} changes by up to {in_percent(cause.moved[most], '+.2g')}."
    )
    doubts = {name: abs(share) for name, share in cause.moved.items()}
    return Finding("unexplained", message, parameters=tuple(doubts), doubts=doubts)


def _of_delay(signals: Sequence[str], delay: Settled, says: str) -> Told:
    names = " and ".join(signals)
    milliseconds = f"{1e3 * abs(delay.size):.3g} ms"
    size = f"{milliseconds} ({abs(delay.samples):.3g} samples, +-{1e3 * delay.reach:.2g} ms)"
    if delay.low_passed:
        remedy = option_for("--unfilter", signals, f"{delay.size:.4g}")
        return Told(
            "low_passed",
            f"{names}: behind a first-order low-pass with a time constant of {size}, a cut-off at "
            f"{1 / (2 * np.pi * delay.size):.3g} Hz",
            f"Record it without that filter, or undo it ({shlex.join(remedy)}).",
            remedy,
            f"Undo the low-pass of {names}",
        )
    remedy = option_for("--shift", signals, f"{delay.size:.4g}")
    way = f"earlier than {says}: all others are late, or low-passed"
    if delay.size > 0:
        way = f"later than {says}{'' if delay.certain else ', or low-passed'}"
    return Told(
        "late_signal",
        f"{names} come{'s' * (len(signals) == 1)} {size} {way}",
        f"Shift it (on the command line: {shlex.join(remedy)}), or record all by one clock.",
        remedy,
        f"{'Advance' if delay.size > 0 else 'Delay'} {names} by {milliseconds}",
    )


def _of_course(signals: Sequence[str], course: Course, record: Record) -> Told:
    names, time, step = " and ".join(signals), np.asarray(record.elapsed), float(record.time_step)
    lasts = f"from {course.first:.3g} to {course.last:.3g} samples"
    if course.kind == "clocks":
        # Clocks go on through pauses.
        samples = float(time[-1] - time[0]) / step / (time.size - 1)
        rate = 1e6 * course.change / (course.place[1] - course.place[0]) / samples
        # They are set from the recording's first sample on, before what was looked at.
        first = course.first * step - PPM * rate * float(time[0])
        shifted = signals if abs(first) > LEAST["clocks"] * step else ()
        remedy = (
            *option_for("--shift", shifted, f"{first:.4g}"),
            *option_for("--clock", signals, f"{rate:.5g}"),
        )
        way = "falls behind" if course.change > 0 else "gets ahead of"
        action = f"Set the clock of {names}, or record it by that of the others"
        return Told(
            "two_clocks",
            f"{names} {way} the others evenly, {lasts}: its clock differs by {rate:.3g} ppm",
            f"{action} ({shlex.join(remedy)}).",
            remedy,
            action,
        )
    reach = longest_delay([record])
    first, last = (time[min(place + reach, time.size - 1)] for place in course.place)
    # What lost rows is early from there on; what agrees with it there is no better for it.
    is_before = abs(course.first) <= abs(course.last)
    remedy = ("--to", f"{first:.7g}") if is_before else ("--from", f"{last:.7g}")
    action = "Use the part of the record in which it is in time"
    return Told(
        "lost_rows",
        f"the delay of {names} jumps {lasts} between {first:.4g} and {last:.4g} s: "
        f"{'all others have' if course.change > 0 else 'it has'} lost rows there",
        f"{action} ({shlex.join(remedy)}).",
        remedy,
        action,
    )


def _amount(size: float, unit: str = "", *_: str) -> str:
    return f"{size:.3g} {unit}".rstrip()


def _of_zero(cause: Cause, model: Model, record: Record, says: str) -> Told:
    """The zero of a sensor, and the constant that it may be as well."""
    doubt, size = cause.doubt, cause.size
    zeros = [one.signals[0] for one in (doubt, *cause.same) if one.kind == "zero"]
    if doubt.term is not None:
        amount = _amount(size, *doubt.term.units.values())
        what = (
            f"a constant is missing ({amount}), of a sensor's zero or of a force that is left out"
        )
    else:
        what = f"{zeros[0]} reads {_amount(size, record.signal(zeros[0]).unit)} more than {says}"
    known = [t for e in model.equations for t in e.terms if t.signal and not t.parameters]
    inputs = [str(t.signal) for t in known if not t.derivative]
    inputs = [name for name in inputs if name in zeros or doubt.term is not None]
    if inputs:
        remedy = ("--unknown-offset", inputs[0])
        then = f"Estimate it (on the command line: {shlex.join(remedy)}; "
        then += "rx.Term('offset', rx.constant))"
        step = f"Estimate the zero of the sensor of {inputs[0]}, or a constant force"
    else:
        remedy = option_for("--zero", doubt.signals[:1], f"{size:.6g}")
        then = step = f"Take the offset off {zeros[0]}" if zeros else "Add a constant force"
        then += f" (on the command line: {shlex.join(remedy)})" if remedy else ""
    return Told("wrong_zero", what, f"{then}.", remedy, step)


def _of_size(cause: Cause, model: Model, record: Record, says: str) -> Told:
    """A zero, a gain, a drift, or a term that the model lacks."""
    doubt, size = cause.doubt, cause.size
    is_constant = doubt.term is not None and doubt.term.of is constant
    if is_constant or any(one.kind == "zero" for one in (doubt, *cause.same)):
        return _of_zero(cause, model, record, says)
    if doubt.lacked is not None:
        return doubt.lacked.element.as_cause(doubt.equation, doubt.lacked.at, size)
    if doubt.elements:
        (element,) = doubt.elements
        unit = per(record.signal(element.place).unit, "1/s")
        return element.as_cause(doubt.equation, (), size, unit)
    if doubt.term is not None:
        amount = _amount(size, *doubt.term.units.values())
        return Told(
            "missing_term",
            f"{doubt.equation}: the model lacks a term, {doubt.meaning} ({doubt.name} = {amount})",
            "Add it (riecjax discover writes the model).",
            step=f"Add the term that is missing, {doubt.meaning}: riecjax discover",
        )
    (name,) = doubt.signals
    amount = _amount(size, record.signal(name).unit)
    if doubt.kind == "gain":
        remedy, step = ("--scale", f"{name}={1 / (1 + size):.5g}"), f"Scale {name}"
        what = f"{name} is {1 + size:.4g} times what {says}"
        return Told("wrong_gain", what, f"{step} ({shlex.join(remedy)}).", remedy, step)
    start, *_, end = np.asarray(record.elapsed)
    slope = size / (end - start)
    zero = cause.offset - slope * 0.5 * (start + end)
    remedy = (
        *option_for("--zero", (name,), f"{zero:.6g}"),
        *option_for("--slope", (name,), f"{slope:.6g}"),
    )
    return Told(
        "drifting_signal",
        f"what the model leaves grows evenly with time, as if {name} drifted by {amount} along the "
        f"record",
        f"Take it off (on the command line: {shlex.join(remedy)}), or look for what else changes "
        f"with time, such as friction of a machine that warms up.",
        remedy,
        f"Take the straight line off {name}",
    )
