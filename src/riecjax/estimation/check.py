"""Before a fit: whether these records can answer the question that a model asks."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Key

from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.bases import RoofFunctions
from riecjax.equations.equation import Equation
from riecjax.equations.term import Terms, evaluate
from riecjax.errors import IdentifiabilityError
from riecjax.estimation.assembly import all_rows
from riecjax.estimation.constant_target import constant_targets
from riecjax.estimation.excitation import Excitation, excitation
from riecjax.estimation.identify import pose, record_keys, signals_read
from riecjax.estimation.procedure import HasProcedure, Procedure
from riecjax.estimation.sharing import Sharing
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.records.consistency import check_derivatives
from riecjax.records.quality import check_signals
from riecjax.records.record import Record

FEWEST_SAMPLES = 4
"""Samples that the shortest window should span."""
FEWEST_STRETCHES = 10
"""Stretches of twice the longest window that the records should hold."""
QUADRATURE_ERROR = 0.01
"""Share of a regressor that the integrals' error may reach."""
FATAL = ("constant_target", "not_excited", "unidentifiable")
"""Codes of findings that leave no answer, rather than a doubtful one."""


class Check(NamedTuple):
    """What stands against identifying a model from records.

    **Fields:** `findings`; `excitations`, one for each stage; `signals`, what is read.
    """

    findings: list[Finding]
    excitations: list[Excitation]
    signals: tuple[str, ...]

    @property
    def refusal(self) -> Finding | None:
        """What rules an answer out, the first of its kind in `FATAL`; `None` if nothing does."""
        return _refusal(self.findings)

    @property
    def answerable(self) -> bool:
        """Whether nothing found rules an answer out."""
        return self.refusal is None


def raise_if_refused(excitations: Iterable[Excitation]) -> None:
    """Raise what a check refuses beside what `identify` raises, before the rest of it is done.

    **Raises:** `IdentifiabilityError` with the finding's message and code.
    """
    refusal = _refusal(finding for stage in excitations for finding in stage.findings())
    if refusal is not None:
        raise IdentifiabilityError(refusal.message, refusal.code)


def _refusal(findings: Iterable[Finding]) -> Finding | None:
    fatal = [finding for finding in findings if finding.code in FATAL]
    return min(fatal, key=lambda finding: FATAL.index(finding.code), default=None)


def check(
    model: Equation | Procedure | HasProcedure,
    records: Record | Sequence[Record],
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    own: Sequence[str] = (),
    excitations: list[Excitation] | None = None,
) -> Check:
    """Look at sensors, sampling, length and excitation before a fit; arguments as for `identify`.

    Nothing is estimated, and nothing that is found here stops a fit; see [`Check.answerable`][].
    `excitations` are those that [`excitation`][] found with the same arguments, if it was asked.

    **Raises:** as `identify`, for what can be said without arithmetic.
    """
    asked = pose(model, records, criterion, key=key, known=known, own=own)
    procedure, recordings, criterion = asked.procedure, asked.records, asked.criterion
    read = [signals_read(procedure, record, criterion) for record in recordings]
    if excitations is None:
        excitations = excitation(procedure, recordings, criterion, key=key, known=known, own=own)
    excitations = on_host(excitations)
    findings = [
        *_sensors(procedure, recordings, read),
        *_windows(recordings, criterion),
        *_quadrature(procedure, recordings, criterion, key),
        *_break_points(procedure, recordings),
        *constant_targets(procedure, asked.sharing, recordings, criterion, asked.given),
        *(finding for stage in excitations for finding in stage.findings()),
    ]
    return Check(findings, excitations, tuple(dict.fromkeys(n for names in read for n in names)))


def _sensors(
    procedure: Procedure, records: list[Record], read: list[tuple[str, ...]]
) -> list[Finding]:
    findings = []
    for i, (record, names) in enumerate(zip(records, read)):
        prefix = f"record {i + 1}: " if len(records) > 1 else ""
        pairs = [
            pair
            for stage in procedure.stages
            for equation in stage
            for pair in equation.derivatives
            if set(pair) <= set(names)
        ]
        findings += [
            Finding(finding.code, prefix + finding.message)
            for finding in (*check_signals(record, names), *check_derivatives(record, pairs))
        ]
    return findings


def _break_points(procedure: Procedure, records: list[Record]) -> Iterator[Finding]:
    """Roof functions past the reach of the data, whose values would be extrapolated."""
    equations = [equation for stage in procedure.stages for equation in stage]
    curves = [term for equation in equations for term in equation.terms if isinstance(term, Terms)]
    for term in curves:
        if not isinstance(term.basis, RoofFunctions):
            continue
        samples = np.concatenate([np.asarray(evaluate(term.of, record)[0]) for record in records])
        points = np.asarray(term.basis.break_points)
        # The end segments are continued: what counts is data past the last but one.
        idle = [points[0]] if samples.min() > points[1] else []
        idle += [points[-1]] if samples.max() < points[-2] else []
        if samples.min() > 0.5 * (points[0] + points[1]) and not idle:
            idle.append(points[0])
        if samples.max() < 0.5 * (points[-1] + points[-2]) and points[-1] not in idle:
            idle.append(points[-1])
        if idle:
            listed = " and ".join(f"{point:g}" for point in idle)
            yield Finding(
                "break_points_outside",
                f"{term.prefix}: the data reach from {samples.min():.3g} to {samples.max():.3g}, "
                f"far from the break point at {listed}, whose value is extrapolated. Move it into "
                f"the reach of the data.",
            )


def _windows(records: list[Record], criterion: AbstractCriterion) -> list[Finding]:
    if not isinstance(criterion, RIEC):
        return []
    findings = []
    alpha, beta = float(criterion.windows.alpha), float(criterion.windows.beta)
    coarsest = max(float(record.time_step) for record in records)
    if alpha < (FEWEST_SAMPLES - 0.5) * coarsest:
        findings.append(
            Finding(
                "short_windows",
                f"the shortest window, {alpha:g} s, spans {alpha / coarsest:.1f} samples of "
                f"{coarsest:g} s; below {FEWEST_SAMPLES} it is hardly an integral. Choose a larger "
                f"alpha, or sample faster.",
            )
        )
    stretches = sum(round(float(record.duration) / (2 * beta)) for record in records)
    if stretches < FEWEST_STRETCHES:
        total = sum(float(record.duration) for record in records)
        findings.append(
            Finding(
                "short_record",
                f"{total:.3g} s recorded are only {stretches} stretches of twice the longest "
                f"window, {beta:g} s; intervals will be rough. Record for longer or choose a "
                f"smaller beta.",
            )
        )
    return findings


def _quadrature(
    procedure: Procedure,
    records: list[Record],
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
) -> list[Finding]:
    """Compare the integrals with those of the highest order: how far the sampling carries."""
    if not isinstance(criterion, RIEC):
        return []
    drawn = criterion.sampled.windows
    if isinstance(drawn, RandomWindows) and drawn.between_samples:
        return []
    finer = RIEC(criterion.windows, criterion.test_function.finest())
    if finer.test_function == criterion.test_function:
        return []
    sharing = Sharing(procedure.parameters, (), len(records))
    keys = record_keys(key, len(records))
    worst, share = "", 0.0
    for rows, better in zip(
        all_rows(procedure, sharing, records, criterion, keys),
        all_rows(procedure, sharing, records, finer, keys),
    ):
        fine = np.asarray(better.columns)
        # Terms that are not finite are for the fit to refuse.
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.sum((np.asarray(rows.columns) - fine) ** 2, axis=1)
            size = np.sum(fine**2, axis=1)
            shares = np.nan_to_num(np.sqrt(error / np.maximum(size, 1e-300)), posinf=0)
        at = int(np.argmax(shares))
        if shares[at] > share:
            worst, share = ("the known terms", *rows.parameters)[at], float(shares[at])
    if share <= QUADRATURE_ERROR:
        return []
    return [
        Finding(
            "coarse_sampling",
            f"the motion is sampled so coarsely that its integrals are {100 * share:.2g} % off (at "
            f"{worst}). Use quadrature of higher order (on the command line: --quadrature 6), "
            f"up-sample the record (--upsample 8), or sample faster.",
        )
    ]
