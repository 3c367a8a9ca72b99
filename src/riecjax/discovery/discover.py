"""The verb: which terms a model lacks, told from recordings, and the model with them as a file."""

import contextlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.suited import criterion_for, with_velocities
from riecjax.discovery.candidate import (
    Candidate,
    Shaped,
    as_candidates,
    default_candidates,
    members,
    not_offered,
)
from riecjax.discovery.search import Question, Rejected, Step, Sums, again, extended, without_twins
from riecjax.doubts.check import of_sensors, read_of
from riecjax.doubts.equation_faults import Cause, demanded, finding_of
from riecjax.elements.catalogue import discovered_kinds
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model, with_rests
from riecjax.equations.motions import reading_velocities
from riecjax.equations.term import written
from riecjax.errors import DataError, ModelError, RiecjaxError, refuse_unknown
from riecjax.estimation.estimate import EquationFit, Estimate
from riecjax.estimation.evidence import is_carried
from riecjax.estimation.identify import identify
from riecjax.estimation.parameters import plan_parameters
from riecjax.findings import Finding
from riecjax.records.preparation.resampling import shift
from riecjax.records.recording import Recording, as_recordings
from riecjax.settings import Discover as DiscoverSettings
from riecjax.settings import taking
from riecjax.shows import Shown
from riecjax.summaries.summarise import ready
from riecjax.uncertainty.intervals import intervals_of

if TYPE_CHECKING:
    from riecjax.records.record import Records

LATE = 3
"""Delays that are taken off at the most, one after the other."""
TAKEN_OFF = "terms are of recordings with it in time"


ELSE = 1e-4
"""Share of the energy, 1 % of the size, that is unexplained and no noise, to be told."""


def is_more_than_noise(step: Step) -> bool:
    """Whether noise makes less than half of what a step leaves, and the rest is worth telling."""
    return step.of_motion > max(0.5 * step.unexplained, ELSE)


class Chosen(NamedTuple):
    """A candidate that was taken.

    **Fields:** `candidate`; `width` of its law in `width_unit`, `None` of one without, and its
    standard error `width_error`, nan where that is not known; `share` of the searches of data drawn
    again that took it too.
    """

    candidate: Candidate
    width: float | None
    width_unit: str
    width_error: float
    share: float


@dataclass(frozen=True, eq=False, repr=False)
class Discovery(Shown):
    """A model with the terms that it lacked; made by [`discover`][].

    **Fields:**

    - `model`, with what was chosen; `start`, the model that was given.
    - `chosen`, and `rejected`, those nearest to it.
    - `paths` of the stages that terms were offered to: what blocks of time that were left out of
      the fit leave unexplained, with one term more on each line.
    - `estimate` of the model; `errors`, standard errors that include the choice of terms.
    - `held_out`: share of each recording that had no part in the choice and that `estimate` is
      from; 0 where choice and estimate are of all.
    - `offered`: how many candidates could be told apart.
    - `findings`: what is amiss with the recordings, also signals that are late against the
      equations that were found.
    - `delays`, seconds by which such signals were advanced before terms were chosen.
    - `element`: a further one, such as a hidden mode, where much less is left with it; `chosen` are
      those terms that were found without it and are told from zero beside it.
    """

    model: Model
    start: Model
    chosen: tuple[Chosen, ...]
    rejected: tuple[Rejected, ...]
    paths: Mapping[str, tuple[Step, ...]]
    estimate: Estimate
    errors: Mapping[str, float]
    held_out: float
    offered: int
    findings: tuple[Finding, ...] = ()
    delays: Mapping[str, float] = field(default_factory=dict)
    element: Element | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what was found: `delay` (of several signals `delay_u`), the element, terms."""
        late = ["delay"] if len(self.delays) == 1 else [f"delay_{name}" for name in self.delays]
        hidden = [] if self.element is None else [self.element.kind]
        return (*late, *hidden, *(one.candidate.name for one in self.chosen))

    @property
    def leaves_more(self) -> bool:
        """Whether most of what is left is no noise, so that a model lacks something else."""
        return any(is_more_than_noise(steps[-1]) for steps in self.paths.values())

    @property
    def of_motion(self) -> float:
        """What is unexplained of all equations, noise not counted."""
        return sum(steps[-1].of_motion for steps in self.paths.values())

    @property
    def amiss(self) -> tuple[Finding, ...]:
        """Findings but the delays that were taken off."""
        return tuple(
            f
            for f in self.findings
            if not (f.code == "late_signal" and {*f.signals} <= {*self.delays})
        )


@taking(DiscoverSettings)
def discover(model: Equation | Model, records: "Records", settings: DiscoverSettings) -> Discovery:
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
            "terms are looked for beside a model without hidden elements: leave these out."
        )
    # In the model's own words: of candidates none can be known, nor set a scale.
    names = model.parameter_names
    refuse_unknown([name for name in settings.known if name not in names], names)
    model.plan({*model.known, *settings.known})
    # Velocities that candidates read and no sensor measured are formed, if they can be.
    reading, recordings = reading_velocities(model), []
    for recording in as_recordings(records):
        with contextlib.suppress(DataError):  # too short, which sums will say
            record, steps = with_velocities(reading, recording.record)
            recording = replace(recording, record=record, steps=(*recording.steps, *steps))
        recordings.append(recording)
    if settings.candidates is None:
        usual = default_candidates(model, [recording.record for recording in recordings])
        offered = without_twins(usual, model)
    else:
        offered = as_candidates(settings.candidates)
    with_all = extended(model, members(offered))
    plan_parameters(with_all, 1, settings.known, ())
    # States of candidates are formed as they are summed, for each width anew.
    whole = ready(replace(with_all, elements=model.elements), recordings, settings.noise)
    criterion = criterion_for(settings, model, [recording.record for recording in whole])
    # Without draws of its own, standard errors by blocks are the same.
    plain = settings.intervals in (None, "bootstrap") and settings.seed == 0
    intervals = None if plain else intervals_of(settings.intervals, settings.seed)
    for recording in whole:  # before they are given states that nobody recorded
        read_of(model, recording, criterion)
    known = {**{name: float(value) for name, value in model.known.items()}, **settings.known}
    asked = Question(model, offered, criterion, known, intervals, settings)
    if settings.candidates is not None:  # these, and nothing else
        return _found(asked, whole)[0]
    answer, in_time = _in_time(asked, whole)
    lacking = not_offered(model, [recording.record for recording in whole])
    answer = replace(answer, findings=(*lacking, *answer.findings))
    if not answer.leaves_more or any(finding.about.disorder for finding in answer.amiss):
        return answer
    return _with_element(asked, answer, in_time)


def _identified(
    asked: Question, model: Model, recordings: list[Recording], criterion: AbstractCriterion | None
) -> Estimate:
    settings = {"intervals": asked.intervals, "at_rest": asked.settings.at_rest}
    return identify(model, asked.parts(recordings)[1], criterion, known=asked.known, **settings)


def _in_time(asked: Question, recordings: list[Recording]) -> tuple[Discovery, list[Recording]]:
    """What is found once signals are in time that come late against the terms found.

    Terms stand for a delay: damping turns a phase as well. It is taken off only where a search
    leaves less without it.
    """
    answer, late = _found(asked, recordings)
    known: list[Finding] = []
    while late is not None and len(known) < LATE:
        told = answer.findings[-1]
        if told.code != "late_signal":
            break
        moved = dict.fromkeys(late.doubt.signals, late.size)
        try:
            in_time = [replace(one, record=shift(one.record, moved)) for one in recordings]
            other, late = _found(asked, in_time)
        except RiecjaxError:  # nothing is left of a signal
            break
        if other.of_motion >= answer.of_motion:
            break
        delays = {name: answer.delays.get(name, 0.0) + more for name, more in moved.items()}
        known.append(told._replace(message=f"{told.message.partition('. ')[0]}; {TAKEN_OFF}"))
        answer, recordings = replace(other, delays={**answer.delays, **delays}), in_time
    return replace(answer, findings=(*known, *answer.findings)), recordings


def _found(asked: Question, whole: list[Recording]) -> tuple[Discovery, Cause | None]:
    """What is found in recordings as they are, and the delay that explains what is left."""
    first, last = asked.parts(whole)
    model, settings = asked.model, asked.settings
    stages = Sums(asked, first).stages()
    times = 0 if settings.hold_out is not None else settings.resamples
    chosen, scatter = [], {}
    rejected: dict[str, Rejected] = {}
    for search, of_stage in stages:
        chosen_again, errors = again(search, of_stage, settings.seed, times)
        scatter |= errors
        for candidate in search.next_best(of_stage):  # the nearest of each law
            rejected.setdefault(candidate.name, candidate)
        chosen += [
            Chosen(
                offer.settled,
                offer.width,
                "" if offer.law is None else offer.law.unit,
                search.width_error(of_stage, offer),
                chosen_again.get(offer.family, float("nan")),
            )
            for offer in of_stage
        ]
    larger = extended(model, [one.candidate for one in chosen])
    estimate = _identified(asked, larger, whole, asked.criterion)
    # Standard errors include the choice: they are never less than the estimate's own.
    errors = dict(zip(estimate.parameters, map(float, estimate.standard_errors)))
    errors |= {name: max(errors[name], e) for name, e in scatter.items() if name in errors}
    # What is amiss with recordings, and what is late against the equations.
    amiss: list[Finding] = []
    last = ready(larger, last)
    for recording in last:
        read = read_of(larger, recording, estimate.criterion)
        amiss += [*recording.concerning(read).findings, *of_sensors(larger, recording, read)]
    late = None
    # Of signals that contradict each other an equation blames the wrong one.
    if not any(finding.about.disorder for finding in amiss):
        records = [recording.record for recording in last]
        with contextlib.suppress(RiecjaxError):  # too short to tell
            # Terms are what is searched for; of sensors a delay alone passes for none of them.
            causes = demanded(larger, records, estimate)
            late = next((one for one in causes if one.doubt.kind == "delay"), None)
            amiss += [] if late is None else [finding_of(late, larger, records)]
    answer = Discovery(
        larger,
        model,
        tuple(chosen),
        tuple(sorted(rejected.values(), key=lambda candidate: -candidate.gain)),
        {
            " + ".join(names): tuple(search.path(of_stage))
            for names, (search, of_stage) in zip(model.equation_names, stages, strict=True)
            if search.offers
        },
        estimate,
        errors,
        settings.hold_out or 0.0,
        sum(len({offer.family for offer in search.offers}) for search, _ in stages),
        tuple({finding.message: finding for finding in amiss}.values()),
    )
    return answer, late


# A further element, such as a hidden mode, instead of terms or beside them.
#
# An oscillator on a body rings in the body's equation. Terms of its velocity and position explain a
# part of that, one more for each thing that it does, and are no forces of the machine. Its
# parameters do not stand in the sums of candidates: `identify` finds them, and what both leave
# beyond noise says which it is.

LEAVES = 0.3
"""Of the error beyond noise that terms leave, rms, what is left with an element at most that is
added: a tenth of the energy."""
TOLD = 3.0
"""Standard errors from zero of a term that stays beside an element; without that it may have stood
for it."""


def _with_element(asked: Question, found: Discovery, recordings: list[Recording]) -> Discovery:
    """The same, or where much less is left with a hidden element, with it: instead of all terms, or
    beside those that are still told from zero."""
    model = found.start
    # Hidden elements have criteria of their own.
    criterion = asked.criterion if asked.settings.says_of_criterion else None
    stages = {name: " + ".join(names) for names in model.equation_names for name in names}
    equations = dict(zip(stages, model.equations, strict=True))
    fits = found.estimate.equations
    # What is left of hysteresis rings like a mode: where that is not offered no such element is,
    # nor beside it.
    hysteretic = {one.equation for one in asked.offered if isinstance(one, Shaped) and one.remember}
    tried = [
        (name, kind.at(place))
        for name in sorted(stages, key=lambda n: -float(fits[n].model_rms))
        for kind in discovered_kinds()
        if name in hysteretic or not kind.is_like_hysteresis
        for place in reversed(kind.places(equations[name], model.equations))
    ]

    def beside(name: str, element: Element) -> tuple[tuple[Chosen, ...], Estimate]:
        """Terms that stay beside an element, and the estimate with both, of a named equation."""

        def estimate(chosen: Sequence[Chosen], by: Question = asked) -> Estimate:
            larger = extended(model, [one.candidate for one in chosen])
            return _identified(by, larger.with_elements(element), recordings, criterion)

        alone = estimate(())
        left = _step(element.kind, alone.equations[name])
        if not found.chosen or not is_more_than_noise(left):
            return (), alone
        # Standard errors by blocks of time, whatever intervals were asked for.
        both = estimate(found.chosen, asked._replace(intervals=None))

        def is_told(name: str) -> bool:
            return abs(float(both[name])) > TOLD * float(both.standard_error(name))

        stay = tuple(one for one in found.chosen if any(map(is_told, one.candidate.columns)))
        if len(stay) < len(found.chosen) or asked.intervals is not None:
            both = estimate(stay) if stay else alone
        less = _step(element.kind, both.equations[name]).of_motion < 0.5 * left.of_motion
        return (stay, both) if less else ((), alone)

    for name, element in tried:
        try:
            chosen, estimate = beside(name, element)
        except RiecjaxError:  # none is to be found there
            continue
        left, most = estimate.equations[name].model_rms, LEAVES * float(fits[name].model_rms)
        if float(left) >= most or any(one.width and one.candidate.elements for one in chosen):
            continue
        candidates = [one.candidate for one in chosen]
        larger = extended(model, candidates).with_elements(element)
        if not is_carried(larger.for_records(asked.parts(recordings)[1]), estimate):
            continue
        start = found.estimate
        if found.chosen:
            start = _identified(asked, model, recordings, criterion)
        terms = " + ".join(candidate.name for candidate in candidates)
        path = [_step("", start.equations[name])]
        path += [_step(terms, fits[name])] if chosen else []
        path.append(_step(element.kind, estimate.equations[name]))
        near = element.found_near(estimate.values)
        return replace(
            found,
            model=extended(model, candidates).with_elements(near),
            chosen=chosen,
            rejected=(),
            element=near,
            paths={stages[name] if stages[name] in found.paths else name: tuple(path)},
            estimate=estimate,
            errors=dict(zip(estimate.parameters, map(float, estimate.standard_errors))),
        )
    return found


def _step(added: str, fit: EquationFit) -> Step:
    """What a fit leaves, of all that it was fitted to."""
    whole, of_motion = (float(rms) ** 2 for rms in (fit.relative_rms, fit.model_rms))
    return Step(added, whole, of_motion, float("nan"), float("nan"))


# The model with what was found as a Python file that `identify` and `simulate` take.


def model_source(found: Discovery, model: str, folder: Path, candidates: str | None = None) -> str:
    """The text of a file in a folder that holds the model.

    **Arguments:** `model`, as [`find_model`][riecjax.find_model] takes it, that was searched; and
    `candidates`, the file and object that a term came from which cannot be written down.

    **Raises:** `ModelError` for a term that is a function of the user's own, without `candidates`.
    """
    names = ", ".join(found.names)
    head = f'"""{found.start.name}{f" with {names}" if names else ""}."""\n\n'
    estimate = found.estimate
    values = {n: float(estimate[n]) for n in (*estimate.parameters, *estimate.known)}
    terms = [chosen.candidate for chosen in found.chosen]
    hidden = () if found.element is None else found.element.hidden
    of_element = {name: value for name, value in values.items() if name in hidden}
    added: dict[str, list[str]] = {}
    for candidate in terms:
        lines = [term.source for term in candidate.terms]
        if None in lines:
            if candidates is None:
                raise ModelError(f"{candidate.name} is of a function of your own: name its file.")
            name = written(candidate.name)
            lines = [f"*rx.discovery.named({_path(candidates, folder)}, {name}).terms"]
        equation = candidate.equation or found.start.equation_names[0][0]
        added.setdefault(equation, []).extend(f"{line}," for line in lines)
    body = [f"MODEL = rx.find_model({_path(model, folder)})"]
    if found.chosen or found.element is None:
        equations = [
            line
            for name, lines in added.items()
            for line in _block(f"{written(name)}: [", lines, "],")
        ]
        read = dict.fromkeys(element for candidate in terms for element in candidate.elements)
        states = [f"{element.source}," for element in read]
        others = {name: value for name, value in values.items() if name not in of_element}
        meanings = {name: candidate.meaning for candidate in terms for name in candidate.columns}
        arguments = [
            *_block("{", equations, "},"),
            *(_block("elements=[", states, "],") if states else []),
            *_mapping("values", others),
            *_mapping("meanings", meanings),
        ]
        body = _block(f"{body[0]}.with_terms(", arguments, ")")
    if found.element is not None:
        element = f"{found.element.source},"
        arguments = [element, *_mapping("values", of_element if found.chosen else values)]
        body = [*body[:-1], *_block(f"{body[-1]}.with_elements(", arguments, ")")]
    imports = ["import riecjax as rx", ""]
    if any("{HERE}" in line for line in body):
        imports = ["from pathlib import Path", "", *imports, "HERE = Path(__file__).parent", ""]
    return head + "\n".join([*imports, *body]) + "\n"


def _path(reference: str, folder: Path) -> str:
    """Source of a reference to a model, that of a file relative to the folder."""
    path, separator, attribute = reference.rpartition(":")
    if reference.endswith(".py"):
        path, separator, attribute = reference, "", ""
    if not path.endswith(".py"):
        return written(reference)
    beside = os.path.relpath(Path(path).resolve(), folder.resolve()).replace(os.sep, "/")
    return f'f"{{HERE}}/{beside}{separator}{attribute}"'


def _block(opening: str, lines: Iterable[str], closing: str) -> list[str]:
    return [opening, *(f"    {line}" for line in lines), closing]


def _mapping(name: str, values: Mapping[str, object]) -> list[str]:
    each = (f"{written(key)}: {written(value)}," for key, value in values.items())
    return _block(f"{name}={{", each, "},") if values else []
