"""Before a fit: whether these records can answer the question that a model asks."""

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Array, Float

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.doubts.kinematics import check_kinematics, implied
from riecjax.equations.bases import RoofFunctions
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model
from riecjax.errors import IdentifiabilityError
from riecjax.estimation.constant_target import target_findings
from riecjax.estimation.excitation import (
    Excitation,
    excitations,
    raise_if_refused,
    refusal_by,
)
from riecjax.estimation.parameters import ParameterTable, plan_parameters
from riecjax.estimation.projection import linearised
from riecjax.findings import Finding
from riecjax.records.faults.signals import check_signals
from riecjax.records.record import Record, Records
from riecjax.records.recording import Recording, explaining_errors, findings_of
from riecjax.records.relations import Relation, relations
from riecjax.settings import Check as CheckSettings
from riecjax.settings import taking
from riecjax.shows import Shown
from riecjax.summaries.normal_equations import Survey
from riecjax.summaries.summarise import ready, signals_read, summed, task
from riecjax.summaries.summary import Summary

if TYPE_CHECKING:
    from riecjax.elements.evidence import Evidence

FEWEST_STRETCHES = 10
"""Stretches of twice the longest window that the records should hold."""
QUADRATURE_ERROR = 0.01
"""Share of a regressor that the integrals' error may reach."""
KNOWN_TERMS = "the known terms"
"""What stands for them beside the names of parameters."""


# It prints as a table, which no named tuple can take from a base class.
@dataclass(frozen=True, eq=False, repr=False)
class Check(Shown):
    """What stands against identifying a model from records.

    **Fields:** `findings`; `excitations`, one for each stage; `signals`, what the `criterion`
    reads; `by_refinement`, standard error of each parameter as a share of its value, where windows
    cannot tell parameters from noise, and output error from these recordings can.
    """

    findings: list[Finding]
    excitations: list[Excitation]
    signals: tuple[str, ...]
    criterion: AbstractCriterion
    by_refinement: dict[str, float] | None = None

    @property
    def refusal(self) -> Finding | None:
        """What rules an answer out, the most important; `None` if nothing does.

        Where one signal is a copy of another, that is said in its place.
        """
        return refusal_by(self.findings) if self.by_refinement is None else None

    @property
    def answerable(self) -> bool:
        """Whether nothing found rules an answer out."""
        return self.refusal is None

    def raise_if_refused(self) -> None:
        """Raise what rules an answer out.

        **Raises:** `IdentifiabilityError` with the finding's message and code.
        """
        raise_if_refused(self.findings)


def raise_if_not_carried(evidence: "Iterable[Evidence]", excitations: Iterable[Excitation]) -> None:
    """Raise that recordings carry no such element where that is why nothing tells regressors apart.

    **Raises:** `IdentifiabilityError` with the finding's message and code.
    """
    refused = {one.stage_name for one in excitations if refusal_by(one.findings())}
    for one in evidence:
        if one.stage in refused and not one.carried:
            findings = one.findings()
            message = " ".join(finding.message for finding in findings)
            raise IdentifiabilityError(message, findings[0].code)


@contextlib.contextmanager
def naming_copies(
    model: Model, recordings: Sequence[Recording], criterion: AbstractCriterion
) -> Iterator[None]:
    """Say of a refusal that one signal is a copy of another, where that is why.

    **Raises:** `IdentifiabilityError`, as what it is around.
    """
    try:
        yield
    except IdentifiabilityError as error:
        for recording in recordings:
            names = read_of(model, recording, criterion)
            for finding in check_signals(recording.record, names, computed=recording.computed):
                if finding.about.explains_refusal:
                    message = f"{finding.message} {error}"
                    raise IdentifiabilityError(message, finding.code) from None
        raise


@taking(CheckSettings)
def check(model: Equation | Model, records: Records, settings: CheckSettings) -> Check:
    """Look at sensors, sampling, length and excitation before a fit; arguments as for `identify`.

    Nothing is estimated but hidden modes, whose shapes the regressors depend on, and nothing that
    is found here stops a fit; see [`Check.answerable`][].
    What a [`Recording`][riecjax.Recording] says of signals that are read comes first.

    **Raises:** as `identify`, for what can be said without arithmetic.
    """
    return looked_at(as_model(model), records, settings)[0]


def looked_at(
    model: Model, records: Records, settings: CheckSettings
) -> tuple[Check, Summary, ParameterTable]:
    """[`check`][], with the sums that it is of and what would be estimated of them."""
    recordings = ready(model, records, settings.noise)
    asked = task(model, recordings, settings, settings.key)
    table = plan_parameters(model, len(recordings), settings.known, settings.per_record)
    with explaining_errors(recordings, model.says_change_of):
        summary = summed(asked, survey=True)
    checked, linear = check_sums(model, summary, table, table.known)
    return check_recordings(model, recordings, table, linear, checked), summary, table


def check_sums(
    model: Model, summary: Summary, table: ParameterTable, known: Mapping[str, Array]
) -> tuple[Check, Summary]:
    """What sums by themselves tell of the parameters to be estimated; and the sums, linearised
    about hidden elements, of which these values are `known`."""
    summary = linearised(model, summary, known)
    excited = excitations(summary, table)
    findings = [finding for stage in excited for finding in stage.findings()]
    return Check(findings, excited, (), summary.criterion), summary


def check_recordings(
    model: Model,
    recordings: Sequence[Recording],
    table: ParameterTable,
    summary: Summary,
    checked: Check,
) -> Check:
    """What was `checked` of sums, with what their recordings and survey tell; of whose noise
    something is known."""
    read = {one: read_of(model, one, summary.criterion, summed=True) for one in recordings}
    # Deviations from the mean are no regressors of hidden elements.
    constant = [] if model.has_hidden else target_findings(model, table, summary)
    sensors = [of_sensors(model, one, read[one]) for one in recordings]

    def told(number: int, finding: Finding) -> Finding:
        """Of which recording it is; what is proposed, if it does no harm to those without it."""
        prefix = f"record {number}: " if len(recordings) > 1 else ""
        finding = finding._replace(message=prefix + finding.message)
        same = finding.code, finding.signals
        everywhere = all(any((f.code, f.signals) == same for f in own) for own in sensors)
        if "--leave-out" in finding.remedy or everywhere:
            return finding
        # Options are for all recordings.
        step = finding.step and f"{finding.step}, in record {number} alone"
        return finding._replace(remedy=(), step=step)

    findings = [
        *findings_of(recordings, read.__getitem__),
        *(told(i, finding) for i, own in enumerate(sensors, 1) for finding in own),
        *_windows([one.record for one in recordings], summary.criterion),
        *_quadrature(summary),
        *_break_points(model, summary),
        *constant,
        *checked.findings,
    ]
    signals = tuple(dict.fromkeys(name for names in read.values() for name in names))
    return replace(checked, findings=findings, signals=signals)


def read_of(
    model: Model, recording: Recording, criterion: AbstractCriterion, summed: bool = False
) -> tuple[str, ...]:
    """Names of the signals that a criterion reads; errors name the recording."""
    with recording.explaining_errors():
        return signals_read(model, recording.record, criterion, summed)


def _pairs(model: Model, read: Collection[str]) -> list[tuple[str, str]]:
    """Signals that are read and their derivatives, as the model knows them."""
    every = (pair for pair in model.derivatives if not isinstance(pair, Relation))
    return [pair for pair in every if {*pair} <= {*read}]


def compared_relations(model: Model, record: Record, read: Collection[str]) -> list[Relation]:
    """Relations by which sensors are held against each other, of which these signals are read:
    those that the model knows, and those that the signals show."""
    # Of an input that no equation reads, as a road, a recording may tell all the same.
    sums = [one for one in model.kinematics if {*one.names} <= {*record.arrays}]
    known = [*relations([*_pairs(model, read), *sums])]
    return [*known, *implied(record, [*read], known)]


def of_sensors(model: Model, recording: Recording, read: Collection[str]) -> list[Finding]:
    """What is amiss with the sensors of one recording, of which these signals are read."""
    record, computed = recording.record, recording.computed
    of_signals = check_signals(record, read, computed=computed, pairs=_pairs(model, read))
    # A value that is held, or cut off, is no gain: to scale it makes the rest wrong as well.
    # Nor are rows lost where one signal alone jumps, or is it late for what it held.
    held = {n for f in of_signals if f.about.holds for n in f.signals}
    # What holds was seen when it was read.
    compared = compared_relations(model, record, read)
    compared = [one for one in compared if one not in recording.kinematics]
    of_pairs = check_kinematics(record, compared)
    of_pairs = [f for f in of_pairs if not (f.about.feigned and held & {*f.signals})]
    return [*of_signals, *of_pairs]


def recording_findings(
    model: Model, recording: Recording, criterion: AbstractCriterion
) -> list[Finding]:
    """What is amiss with one recording and its sensors, as far as a criterion reads it.

    Each finding names the parameters that it concerns, those of equations that read its signals;
    one that names none concerns all.

    **Raises:** `DataError` for an absent signal or a record shorter than a window.
    """
    read, record = read_of(model, recording, criterion, summed=True), recording.record
    findings = [*recording.concerning(read).findings, *of_sensors(model, recording, read)]
    concerned = [
        finding.parameters or parameters_reading(model, record, criterion, finding.signals)
        for finding in findings
    ]
    return [f._replace(parameters=names) for f, names in zip(findings, concerned)]


def parameters_reading(
    model: Model, record: Record, criterion: AbstractCriterion, signals: Collection[str]
) -> tuple[str, ...]:
    """Parameters of the equations that read some of these signals for a criterion."""
    read = ((e, e.signals_read(record, criterion.smoothness)) for e in model.equations)
    return tuple(dict.fromkeys(n for e, names in read if {*signals} & names for n in e.parameters))


def _break_points(model: Model, summary: Summary) -> Iterator[Finding]:
    """Roof functions past the reach of the data, whose values would be extrapolated."""
    surveys = [survey for survey, _ in _surveys(summary)]
    for term in (term for equation in model.equations for term in equation.terms):
        if not isinstance(term.basis, RoofFunctions):
            continue
        reach = [s.reach[str(term.name)] for s in surveys if term.name in s.reach]
        least, most = np.min(reach), np.max(reach)
        points = np.asarray(term.basis.break_points)
        # The end segments are continued: what counts is data past the last but one.
        below = least > points[1] or (least > 0.5 * (points[0] + points[1]) and most >= points[-2])
        ends = (points[0], below), (points[-1], most < 0.5 * (points[-1] + points[-2]))
        if idle := [point for point, unreached in ends if unreached]:
            listed = " and ".join(f"{point:g}" for point in idle)
            yield Finding(
                "break_points_outside",
                f"{term.name}: the data reach from {least:.3g} to {most:.3g}, "
                f"far from the break point at {listed}, whose value is extrapolated. Move it into "
                f"the reach of the data.",
                parameters=tuple(term.parameters),
            )


def _windows(records: list[Record], criterion: AbstractCriterion) -> Iterator[Finding]:
    windows = criterion.windows
    if windows is None:
        return
    alpha, beta = float(windows.alpha), float(windows.beta)
    coarsest = max(float(record.time_step) for record in records)
    fewest = criterion.test_function.fewest_samples
    if alpha < (fewest - 0.5) * coarsest:
        yield Finding(
            "short_windows",
            f"the shortest window, {alpha:g} s, spans {alpha / coarsest:.1f} samples of "
            f"{coarsest:g} s; below {fewest} it is hardly an integral. Choose a larger alpha, or "
            f"sample faster.",
        )
    stretches = sum(round(float(record.duration) / (2 * beta)) for record in records)
    if stretches < FEWEST_STRETCHES:
        total = sum(float(record.duration) for record in records)
        yield Finding(
            "short_record",
            f"{total:.3g} s recorded are only {stretches} stretches of twice the longest window, "
            f"{beta:g} s; intervals will be rough. Record for longer or choose a smaller beta.",
        )


def _quadrature(summary: Summary) -> Iterator[Finding]:
    """Compare the integrals with those of the highest order: how far the sampling carries."""
    sums: dict[str, Float[np.ndarray, "2"]] = {}
    for survey, names in _surveys(summary):
        energies = np.diagonal(survey.quadrature, axis1=1, axis2=2)
        for name, both in zip((KNOWN_TERMS, *names), energies.T):
            sums[name] = sums.get(name, 0.0) + np.asarray(both)
    # Terms that are not finite are for the fit to refuse.
    shares = {
        name: np.nan_to_num(np.sqrt(error / max(size, 1e-300)), posinf=0)
        for name, (error, size) in sums.items()
    }
    worst = max(shares, key=lambda name: shares[name])
    if shares[worst] > QUADRATURE_ERROR:
        yield Finding(
            "coarse_sampling",
            f"the motion is sampled so coarsely that its integrals are "
            f"{100 * shares[worst]:.2g} % off (at {worst}). Use quadrature of higher order (on the "
            f"command line: --quadrature 6), up-sample the record (--upsample 8), or sample "
            f"faster.",
            parameters=() if worst == KNOWN_TERMS else (worst,),
            doubt=min(float(shares[worst]), 1.0),
            remedy=("--quadrature", "6"),
            step="Integrate by a higher order",
        )


def _surveys(summary: Summary) -> Iterator[tuple[Survey, tuple[str, ...]]]:
    """Of each equation on each recording, with its parameters."""
    for one in summary.recordings:
        for equation in (e for stage in one.stages for e in stage):
            assert equation.survey is not None
            yield equation.survey, equation.parameters
