"""The answer of an identification, typed: a field for each key of results.json, in its order.

JSON, terminal, page, notebooks and comparison are made of it. docs/results.schema.json is its JSON
schema. Numbers that JSON has no word for are `None`; a key that is not always there is `UNSET`
where it is not. Keys that were added after schema 1 have a value for documents without them.
"""

import math
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from msgspec import UNSET, UnsetType

from riecjax.assessment.assess import Assessment
from riecjax.errors import ModelError, printable
from riecjax.estimation.estimate import Estimate, intervals_entry, parameter_entries
from riecjax.findings import Finding, Step
from riecjax.leaves import finite
from riecjax.records.noise_judgement import noise_entries
from riecjax.records.recording import Recording, common_steps
from riecjax.reporting.document import SCHEMA, Document, versions
from riecjax.reporting.equations import model_in_words
from riecjax.shows import Tabled
from riecjax.validation.residuals import Peak

Number = float | None
Ends = tuple[Number, Number]
if TYPE_CHECKING:
    from riecjax.assessment.verdict import Cause, Verdict
    from riecjax.doubts.check import Check
    from riecjax.estimation.stages import EquationFit, StageSolution

P = TypeVar("P")
Settings = dict[str, Any]
"""Settings of a criterion, `name` first: whoever writes a criterion says which."""
MOST_STEPS = 3
"""Things to do next that are told."""
WithOptions = Callable[[Sequence[str]], Sequence[str]]
"""Arguments of `riecjax`, those that made a result, with further options in their places."""


class Part(msgspec.Struct):
    """Keys of a document, and what they hold."""


class Known(Part):
    """A parameter; one that was not estimated has no more than this."""

    value: Number
    unit: str


class Parameter(Known):
    """An estimated parameter; of the linear estimate, what its windows say too."""

    std_error: Number = None
    interval95: Ends = (None, None)
    naive_std_error: Number | UnsetType = UNSET
    effective_windows: Number | UnsetType = UNSET


class Fit(Part):
    """What an equation leaves in windows."""

    relative_rms: Number
    rms: Number = None
    rows: int = 0


class StageFit(Part, kw_only=True):
    """A stage: its equations, what they determine, and what they leave."""

    equation: str
    parameters: list[str] = []
    relative_rms: Number
    rms: Number = None
    rows: int = 0
    condition_number: Number = None
    rank: int = 0
    equations: list[str] = []


class ResidualPart(Part):
    """What stages and equations leave."""

    relative_rms: Number = None
    stages: list[StageFit] = []
    equations: dict[str, Fit] = {}


class Judgement(Part):
    """Whether to trust a parameter, why, and the ends of the interval that counts every doubt."""

    level: str
    reason: str
    doubt: Ends = (None, None)
    share: Number = None


class CausePart(Part):
    """What lies behind warnings of these codes."""

    kind: str
    phrase: str
    parameters: list[str]
    share: Number
    codes: list[str]


class VerdictPart(Part):
    """Which parameters can be trusted, how far, and what to do about the rest."""

    sentence: str = ""
    parameters: dict[str, Judgement] = {}
    causes: list[CausePart] = []
    next: list[Step] = []
    followed: list[Step] = []


class StrayMode(Part):
    """A mode that was looked for near another frequency."""

    parameters: list[str]
    asked_hz: Number
    found_hz: Number


class HeldOutShares(Part):
    """Shares unexplained of blocks left out, with the mode and without."""

    with_mode: Number = msgspec.field(name="with")
    without: Number
    gain: Number
    gain_std_error: Number


class ModePart(Part, kw_only=True):
    """What speaks for a hidden mode, the last one of a stage."""

    on: str
    equation: str
    parameters: list[str]
    frequency_hz: Number
    frequency_std_error_hz: Number
    damping_ratio: Number
    damping_ratio_std_error: Number
    window_s: tuple[float, float]
    strays: list[StrayMode] = []
    carried: bool
    oscillates: bool
    explained: Number
    held_out: HeldOutShares
    map: dict[str, list[Number]]


class Excitation(Part):
    """How much of a parameter's regressor is its own, and how much is noise."""

    equation: str
    own_share: Number
    noise_share: Number


class NoisePart(Part):
    """Standard deviation of a signal's noise, and which share of the signal's that is."""

    std: Number
    unit: str
    share: Number


class Correlation(Part):
    """Correlation of the linear estimates."""

    parameters: list[str] = []
    matrix: list[list[Number]] = []


class WindowErrors(Part):
    """Errors of windows along the record."""

    relative_rms: Number
    mean_square_ratio: Number
    target_mean_square_ratio: Number
    p_value: Number


class ResidualTest(Part):
    """Tests of what one equation leaves, sample by sample."""

    relative_rms: Number
    band_hz: Number
    peak: Peak | None
    windows: WindowErrors | None = None


class WindowSweepPart(Part):
    """Estimates from windows of one length after another."""

    alpha: list[Number]
    beta: list[Number]
    parameters: dict[str, dict[str, list[Number]]]
    relative_rms: dict[str, list[Number]]


class ChannelWhiteness(Part):
    """What is left of a channel, beside white noise."""

    statistic: Number
    chi_squared: Number = None
    share: Number = None


class WhitenessPart(Part):
    """Whether what a refinement leaves is white noise."""

    white: bool
    vanishing: bool
    largest: Number
    threshold: Number
    channels: dict[str, ChannelWhiteness]


class LeftBeforeAfter(Part):
    """What is left of a quantity before and after a refinement, root mean square."""

    before: Number
    after: Number
    unit: str


class IntervalsPart(Part):
    """Where intervals come from."""

    method: str
    blocks: int
    block_seconds: Number


class SimulatedSignal(Part):
    """A signal, simulated, beside what was recorded of it; in percent."""

    p_percent: Number
    fit_percent: Number
    vaf_percent: Number
    samples: int
    grade: str
    judged: bool


class HeldOutPart(Part, kw_only=True):
    """A simulation along a recording; `on` which, unless what it stands in says that."""

    on: str | UnsetType = UNSET
    ran: bool
    reason: str
    predicts: bool
    verdict: str
    signals: dict[str, SimulatedSignal]
    stretches: list[tuple[int, int]]
    samples: int
    samples_simulated: int
    started_from: dict[str, str]
    drifting: list[str]
    horizon_s: Number
    rule: dict[str, float]

    def fit(self, name: str) -> Number:
        """Fit of a signal in percent, where it is known."""
        return self.signals[name].fit_percent if name in self.signals else None


class SimulationPart(Part):
    """Simulations along a recording with the start of a refinement and with its result."""

    on: str
    fitted: bool
    before: HeldOutPart
    after: HeldOutPart


class RefinementPart(Part):
    """A refinement, and whether its values are the answer.

    What is of a search is `None` or empty where none was made.
    """

    chosen: bool = False
    declined: str | None = None
    chi_squared: Number = None
    whiteness: WhitenessPart | None = None
    identified: dict[str, Parameter] = {}
    refined: dict[str, Parameter] | None = None
    by: Settings | None = None
    converged: bool | None = None
    reason: str | None = None
    steps: int | None = None
    basis: str | None = None
    left: dict[str, LeftBeforeAfter] = {}
    intervals: IntervalsPart | None = None
    at_bound: list[str] = []
    simulations: list[SimulationPart] = []


class WarningPart(Part):
    """A [`Finding`][riecjax.Finding]."""

    code: str
    message: str
    signals: list[str] = []
    parameters: list[str] = []
    doubt: Number = 0.0
    doubts: dict[str, float] = {}
    remedy: list[str] = []
    step: str = ""

    @property
    def finding(self) -> Finding:
        """The finding that it was."""
        return Finding(
            code=self.code,
            message=self.message,
            signals=tuple(self.signals),
            parameters=tuple(self.parameters),
            doubt=self.doubt or 0.0,
            doubts=self.doubts,
            remedy=tuple(self.remedy),
            step=self.step,
        )


class RecordPart(Part, kw_only=True):
    """Where a recording is from, and how it is sampled."""

    file: str
    part: str | None = None
    samples: int
    time_step: float

    @property
    def name(self) -> str:
        """By its file, and by its part of one that holds several."""
        return ", ".join(filter(None, (self.file, self.part)))


class FilePart(Part):
    """A file that an answer is made from."""

    file: str
    bytes: int = 0
    sha256: str = ""


class Provenance(Part):
    """What an answer was made by and from."""

    command: str | None = None
    seed: int | None = None
    records: list[RecordPart] = []
    start_times: list[Number] = []
    preparation: list[str] = []
    converted: dict[str, str] = {}
    intervals: IntervalsPart | None = None
    versions: dict[str, str] = {}
    files: list[FilePart] | UnsetType = UNSET


class Answer(Tabled, Part, kw_only=True):
    """The document that `riecjax identify --json` prints and results.json holds; what [`load`][]
    reads of that. Values, intervals and tables come by parameter, as of an estimate.

    Of an estimate by itself it has what is known as soon as a model is identified: the first keys.
    """

    schema: int = SCHEMA
    model: str = ""
    criterion: Settings
    parameters: dict[str, Parameter]
    known: dict[str, Known]
    condition_number: Number = None
    rank: int = 0
    residual: ResidualPart = msgspec.field(default_factory=ResidualPart)
    equations: list[str] = []
    verdict: VerdictPart = msgspec.field(default_factory=VerdictPart)
    modes: list[ModePart] = []
    excitation: dict[str, Excitation] = {}
    noise: dict[str, NoisePart] = {}
    correlation: Correlation = msgspec.field(default_factory=Correlation)
    residual_tests: dict[str, ResidualTest] | None = None
    window_sweep: WindowSweepPart | None = None
    refinement: RefinementPart | None = None
    validation: list[HeldOutPart] = []
    tests: dict[str, Any] | UnsetType = UNSET
    warnings: list[WarningPart]
    provenance: Provenance = msgspec.field(default_factory=Provenance)
    job: dict[str, Any] | UnsetType = UNSET
    checksum: str | UnsetType = UNSET

    def __getitem__(self, name: str) -> float:
        return _or_nan(self._entry(name).value)

    def __iter__(self) -> Iterator[str]:
        return iter((*self.parameters, *self.known))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter."""
        return {name: self._entry(name).unit for name in self}

    def standard_error(self, name: str) -> float:
        """Standard error of an estimated parameter."""
        entry = self._entry(name)
        return _or_nan(entry.std_error if isinstance(entry, Parameter) else None)

    def interval(self, name: str) -> tuple[float, float]:
        """Ends of the 95 % interval of an estimated parameter."""
        self._entry(name)
        return self.interval_by_name().get(name, (math.nan, math.nan))

    def interval_by_name(self) -> dict[str, tuple[float, float]]:
        """As `interval`, of every estimated parameter."""
        ends = {name: entry.interval95 for name, entry in self.parameters.items()}
        return {name: (_or_nan(low), _or_nan(high)) for name, (low, high) in ends.items()}

    def findings(self) -> list[Finding]:
        """The warnings of the identification."""
        return [warning.finding for warning in self.warnings]

    def _entry(self, name: str) -> Known:
        entries = {**self.known, **self.parameters}
        if name not in entries:
            raise ModelError(f"no parameter '{name}'; there are: {', '.join(self)}.")
        return entries[name]


def _or_nan(number: Number) -> float:
    return math.nan if number is None else number


def read(kind: type[P], document: Any) -> P:
    """A document, or a part of one, from plain data, in which numbers may be NumPy's.

    **Raises:** `msgspec.ValidationError`, which says where it is none.
    """
    return msgspec.convert(finite(document), kind)


def answer_of(
    result: Assessment, command: Sequence[str] = (), with_options: WithOptions | None = None
) -> Answer:
    """The answer of an assessment, as a document.

    **Arguments:** `command`: the arguments of `riecjax` that made it, if any did; `with_options`
    makes arguments of `riecjax` that do what to do next: without, there is no command for it.
    """
    estimate, key, seed = result.estimate, result.key, None
    if key is not None:
        # The seed that `jax.random.key` makes this key of: its words, the highest first.
        words = jax.random.key_data(key) if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else key
        seed = int.from_bytes(np.asarray(words).astype(">u4").tobytes(), "big")
    document = estimate_entries(estimate, result.model.name)
    if result.answer is not estimate:
        document["parameters"] = parameter_entries(result.answer)
    further = {test.name: test.entry() for test in result.own_tests}
    entries = {test.name: test.entry() for test in result.tests if test.name not in further}
    return read(
        Answer,
        {
            **document,
            "equations": model_in_words(result.model),
            "verdict": verdict_entries(result.verdict, with_options),
            "excitation": excitation_entries(result.checked),
            "noise": noise_entries(
                [one.record for one in result.recordings], result.checked.signals
            ),
            "correlation": {
                "parameters": estimate.parameters,
                "matrix": estimate.correlation,
            },
            **entries,
            **({"tests": further} if further else {}),
            "warnings": [finding._asdict() for finding in result.findings()],
            "provenance": {
                "command": as_typed(command) if command else None,
                "seed": seed,
                "records": [recording_entry(recording) for recording in result.recordings],
                "start_times": start_times(result.recordings),
                "preparation": common_steps(result.recordings),
                "converted": {k: u for r in result.recordings for k, u in r.converted.items()},
                "intervals": intervals_entry(estimate),
                "versions": versions(),
            },
        },
    )


def part_of(source: Any) -> Answer:
    """What an object holds of parameters, as an answer that may have nothing else.

    **Raises:** `ModelError` for an object that holds none.
    """
    match source:
        case Answer():
            return source
        case Assessment():
            return answer_of(source)
        case Estimate():
            return read(Answer, estimate_entries(source))
    raise ModelError(
        f"there are no parameters in a {type(source).__name__}: give what rx.identify, "
        f"rx.estimate, rx.refine, rx.assess or rx.load return."
    )


def estimate_entries(estimate: Estimate, model: str = "") -> Document:
    """The first keys of an answer; of a refined estimate, parameters alone."""
    units = dict(estimate.units)
    known = {name: {"value": estimate[name], "unit": units[name]} for name in estimate.known}
    document: Document = {"criterion": {}, "known": known, "warnings": []}
    if estimate.search is not None:
        return {**document, "parameters": parameter_entries(estimate)}

    def left(fit: "EquationFit | StageSolution") -> Document:
        return {
            "relative_rms": fit.relative_rms,
            "rms": fit.residual_rms,
            "rows": int(np.asarray(fit.count)),
        }

    stages = [
        {
            "equation": name,
            "parameters": stage.parameters,
            **left(stage),
            "condition_number": stage.solution.condition_number,
            "rank": int(np.asarray(stage.solution.rank)),
            "equations": names,
        }
        for name, names, stage in zip(
            estimate.stage_names, estimate.equation_names, estimate.stages
        )
    ]
    return {
        **document,
        "model": model,
        "criterion": estimate.criterion.describe(),
        "parameters": parameter_entries(estimate),
        "condition_number": estimate.condition_number,
        "rank": int(np.asarray(estimate.rank)),
        "residual": {
            "relative_rms": stages[-1]["relative_rms"],
            "stages": stages,
            "equations": {name: left(fit) for name, fit in estimate.equations.items()},
        },
    }


def verdict_entries(verdict: "Verdict", with_options: WithOptions | None = None) -> Document:
    """The part of an answer about the verdict."""
    return {
        "sentence": verdict.sentence,
        "parameters": {name: judged._asdict() for name, judged in verdict.parameters.items()},
        "causes": [
            {
                **cause._asdict(),
                "codes": list(dict.fromkeys(finding.code for finding in cause.findings)),
            }
            for cause in verdict.causes
        ],
        "next": [*next_steps(verdict.causes, with_options)],
        "followed": [*verdict.followed],
    }


def next_steps(
    causes: "Sequence[Cause]", with_options: WithOptions | None = None
) -> Iterator[Step]:
    """What to do, with a command that does it; what has one comes first, but for what voids all."""
    urgent = {cause.step: cause.voids for cause in reversed(causes) if cause.step is not None}
    steps = sorted(reversed(urgent), key=lambda step: (not urgent[step], not step.options))
    different: dict[object, Step] = {}
    for step in steps:  # two causes may ask for the same
        different.setdefault(step.options or step.words, step)
    for step in [*different.values()][:MOST_STEPS]:
        proposed = with_options(step.options) if with_options and step.options else None
        command = as_typed(proposed) if proposed else None
        yield replace(step, command=command)


def as_typed(arguments: Sequence[str]) -> str:
    """`riecjax` with these arguments, as this system's shell takes it."""
    # To cmd.exe a single quote is a letter like others.
    join = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
    return join(["riecjax", *arguments])


def excitation_entries(checked: "Check") -> Document:
    """For each parameter, how much of its regressor is its own, and how much is noise."""
    return {
        name: {"equation": stage.stage_name, "own_share": own, "noise_share": noise}
        for stage in checked.excitations
        for name, own, noise in zip(stage.parameters, stage.own_share, stage.noise_share)
    }


def recording_entry(recording: Recording) -> Document:
    """Where a recording is from, and how it is sampled."""
    return {
        "file": printable(recording.source),
        "part": recording.part or None,
        "samples": recording.record.sample_count,
        "time_step": recording.record.time_step,
    }


def start_times(recordings: Sequence[Recording]) -> list[float]:
    """The time stamp of each recording's first sample, from which all other times count."""
    return [float(r.record.start_time - r.record.skipped) for r in recordings]
