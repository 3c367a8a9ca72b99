"""What a user should know of data or of a result, with a code for scripts.

`CODES` has the class of every code: what it is about, in words, and what it means for a verdict.
Their order is that of importance: of several codes of one kind, the first says most of their cause.
Each has a row in docs/warnings.md, a test that raises it, and one that must not. A test of a user's
own registers its codes by `CODES["rattle"] = FindingClass("sensors", "{signals} rattles")`.
"""

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, SupportsFloat, get_args

Kind = Literal["undetermined", "sensors", "model", "noise", "data", "computation", "reproduction"]
KINDS: tuple[Kind, ...] = ("undetermined", "sensors", "model", "noise", "data", "computation")
"""Kinds of causes in a verdict. What a user says of a parameter is held against it as a sensor."""


def joined(names: Sequence[str]) -> str:
    """Names, the last of several behind an "and"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def in_percent(share: SupportsFloat, form: str = ".2g") -> str:
    """A share in words, in this form: `2.3 %`; hundreds of them in digits."""
    percents = 100 * float(share)
    said = f"{percents:{form}}"
    return f"{said if abs(percents) < 100 else f'{float(said):.0f}'} %"


class FindingClass(NamedTuple):
    """What a code means, in words and for a verdict.

    **Fields:**

    - `kind` of cause, and its `phrase` in a sentence, with places for `{signals}`,
      `{one_of}` them, and `{parameters}`.
    - `refuses`: that it leaves no `"answer"` at all, or none by `"windows"`, where output error,
      which needs no derivative, may have one; `explains_refusal`: said in place of a refusal.
    - `rules_out`: the parameters that it names are not to be used, whatever their doubt;
      `symptom`: what makes it so is another cause, if one is known.
    - `widens`: scatter of the parameters that it names is no chance; `short`: the record is short.
    - `assumed`: nothing recorded shows it, and nothing rules it out; `refutes`: the recordings
      contradict a value, which is not good then, however small its doubt, if its remedy is known.
    - `undo`: its remedy takes the fault off a record, to say how far parameters move; `holds`: the
      signal holds its value for a while, and `feigned`: what such a signal seems to have as well.
    - `disorder`: sensors of one motion do not go together, so that no term is to be looked for.
    - `step`: what to do about it, in words with the same places, and the `options` of
      `riecjax identify` that do it.
    """

    kind: Kind
    phrase: str
    refuses: Literal["", "windows", "answer"] = ""
    explains_refusal: bool = False
    rules_out: bool = False
    symptom: bool = False
    widens: bool = False
    short: bool = False
    assumed: bool = False
    refutes: bool = False
    undo: bool = False
    holds: bool = False
    feigned: bool = False
    disorder: bool = False
    step: str = ""
    options: tuple[str, ...] = ()

    def said(self, signals: tuple[str, ...] = (), parameters: tuple[str, ...] = ()) -> str:
        """The phrase, of these signals and parameters."""
        listed = joined(signals) or "a signal"
        return self.phrase.format(
            signals=listed,
            one_of=f"one of {listed}" if len(signals) > 1 else listed,
            parameters=", ".join(parameters) or "some parameters",
        )


class Finding(NamedTuple):
    """Something a user should know, with a code for scripts.

    **Fields:** `code`, one of `CODES`; `message`, with what to do about it;
    `signals` and `parameters`, the names of those that it concerns, empty where it concerns all or
    none; `doubt`, the share of a value by which it puts each of them in doubt, where it tells, and
    `doubts`, the same by parameter where it differs; `remedy`, options of `riecjax identify` that
    put it right, and `step`, the same in words.
    """

    code: str
    message: str
    signals: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    doubt: float = 0.0
    doubts: Mapping[str, float] = {}
    remedy: tuple[str, ...] = ()
    step: str = ""

    @property
    def about(self) -> FindingClass:
        """What its code means."""
        return class_of(self.code)

    @property
    def importance(self) -> int:
        """The place of its code among `CODES`, behind all of them if it is not registered."""
        codes = [*CODES]
        return codes.index(self.code) if self.code in CODES else len(codes)


FINEST = 2.5e-3
"""Share of a value below which nothing is claimed: no sensor is calibrated better, and derivatives
that were formed of samples move values by up to as much."""


@dataclass(frozen=True)
class Step:
    """Something to do: what for, and the options of `riecjax identify` that do it; values of
    parameters before and after, where it was tried; the command, where one is known."""

    words: str
    options: tuple[str, ...] = ()
    changed: Mapping[str, tuple[float, float]] | None = field(default=None, compare=False)
    command: str | None = None

    @property
    def said(self) -> str:
        """What for, and what it does to the parameter that it changes most."""
        shares = {
            name: abs(after / before - 1)
            for name, (before, after) in (self.changed or {}).items()
            if before
        }
        most = max(shares, key=lambda name: shares[name], default="")
        if not most or shares[most] < FINEST:
            return self.words
        before, after = (self.changed or {})[most]
        return f"{self.words} ({most} goes from {before:.4g} to {after:.4g})"


def class_of(code: str) -> FindingClass:
    """What a code means. One that is not registered is said in its own words, and counts as what is
    amiss with recordings does: by the doubt that a finding states."""
    return CODES.get(code) or FindingClass("sensors", code.replace("_", " "))


def option_for(option: str, signals: Iterable[str], value: str) -> tuple[str, ...]:
    """An option of the command line for each of these signals, `--shift v=0.005`."""
    return tuple(word for name in signals for word in (option, f"{name}={value}"))


SMOOTH = ("--test-function", "bump")
"""Options of windows that read positions alone."""
LONGER = "Record for longer, or excite the machine all along"
RICHER = "Excite the machine more richly, or hold a parameter (--set NAME=VALUE)"
_undetermined, _sensors, _model, _noise, _data, _computation, _reproduction = (
    functools.partial(FindingClass, kind) for kind in get_args(Kind)
)
CODES: dict[str, FindingClass] = {
    "constant_target": _undetermined("one term alone reproduces the input", refuses="answer"),
    "not_excited": _undetermined("the recordings hold nothing of {parameters}", refuses="answer"),
    "unidentifiable": _undetermined(
        "the recordings cannot tell {parameters} apart",
        refuses="windows",
        rules_out=True,
    ),
    "undetermined": _undetermined("the recordings say nothing of {parameters}", rules_out=True),
    "mode_not_carried": _undetermined("the recordings carry no such mode", rules_out=True),
    "element_not_carried": _undetermined("the recordings carry no such element", rules_out=True),
    "series_spring_not_carried": _undetermined(
        "the recordings do not tell {parameters} from infinity", rules_out=True
    ),
    "negative_value": _undetermined("{parameters} is below zero", rules_out=True),
    "interval_wider_than_estimate": _undetermined(
        "the recordings hardly determine {parameters}", rules_out=True, symptom=True
    ),
    "prior_disagrees": _sensors(
        "the recordings and the prior of {parameters} disagree",
        step="Check what you said of {parameters}, its unit too, or leave it out",
    ),
    "time_unit_doubtful": _sensors(
        "time may be in another unit than seconds",
        step="State the unit of time in its column's name, as in 'time [ms]', or scale it "
        "(--scale)",
    ),
    "unit_mismatch": _sensors("{signals} has another unit than the model expects"),
    "not_its_derivative": _sensors("{signals} do not fit each other", disorder=True, feigned=True),
    "at_rest": _sensors("{signals} rests where friction jumps"),
    "copied_signal": _sensors("{signals} are one signal", explains_refusal=True),
    "duplicate_recording": _sensors("a recording was given twice"),
    "lost_rows": _sensors("{signals} part by a jump", disorder=True, feigned=True),
    "two_clocks": _sensors("{signals} run by two clocks", disorder=True),
    "silent_input": _sensors("{signals} says nothing"),
    "reversed_input": _sensors("{signals} has the opposite sign"),
    "late_signal": _sensors(
        "{signals} and the rest are not in time", undo=True, feigned=True, disorder=True
    ),
    "low_passed": _sensors("{one_of} is filtered", undo=True, feigned=True, disorder=True),
    "wrong_gain": _sensors("{signals} do not fit each other in size", undo=True, feigned=True),
    "drifting_signal": _sensors("{one_of} drifts", undo=True),
    "velocity_offset": _sensors("{one_of} has an offset", undo=True),
    "repeated_rows": _sensors("rows stand in the recording twice"),
    "wrong_zero": _sensors("a sensor's zero is off, or a constant force is missing"),
    "constant_signal": _sensors("{signals} never varies"),
    "stuck_sensor": _sensors("{signals} is stuck for a while", undo=True, holds=True),
    "clipped": _sensors("{signals} is clipped", undo=True, holds=True),
    "held_signal": _sensors("{signals} comes more seldom than rows", undo=True, holds=True),
    "outliers": _sensors("{signals} has outliers"),
    "hum": _sensors("the mains hum in {signals}"),
    "missing_samples": _sensors("samples of {signals} are missing"),
    "sampled_input": _sensors(
        "{signals} changes between its samples",
        assumed=True,
        step="Sample {signals} faster, or behind a filter that keeps the impulse",
    ),
    "quantised": _sensors("{signals} is coarsely quantised"),
    "column_left_out": _sensors("a column of {signals} is left out"),
    "part_left_out": _sensors("a part of a file is left out"),
    "nothing_cut": _sensors("a cut removes nothing"),
    "file_changed": _sensors("a file is not the one that was read before"),
    "rows_left_out": _sensors("windows that touch a missing sample are left out"),
    "stages_disagree": _model(
        "later equations refute what earlier ones found", disorder=True, refutes=True
    ),
    "missing_term": _model("the model lacks a term"),
    "unmodelled_mode": _model("the model leaves out a mode"),
    "unexplained": _model("the model leaves more than noise"),
    "not_weighed": _model("the model leaves more than noise", assumed=True),
    "large_residual": _model("the model leaves more than half of the signal"),
    "hysteresis": _model("what the model leaves depends on the way that the motion came"),
    "window_sensitive": _model("estimates drift with window length"),
    "uneven_errors": _model("errors differ much along the record"),
    "does_not_predict": _model("the model does not predict"),
    "records_disagree": _model("the recordings disagree", widens=True),
    "no_known_term": _model("no term of an equation is known"),
    "break_points_outside": _model("a break point lies outside the data"),
    "noise_dominates": _noise(
        "noise of {signals} makes much of what tells {parameters} apart",
        step="Compare simulations, which need no derivative",
        options=("--refine", "output-error"),
    ),
    "nearly_collinear": _data("little tells {parameters} apart", step=RICHER),
    "ill_conditioned": _data("little tells some parameters apart", step=RICHER),
    "few_blocks": _data(
        "few stretches of the record tell of {parameters}", short=True, step=LONGER
    ),
    "few_effective_windows": _data(
        "few independent windows tell of {parameters}", short=True, step=LONGER
    ),
    "short_record": _data("the record is short", short=True, step=LONGER),
    "rests_on_prior": _data("{parameters} rests on its prior"),
    "mode_elsewhere": _computation("no mode is near the frequency asked for"),
    "coarse_sampling": _computation("the motion is sampled coarsely"),
    "coarse_steps": _computation("the simulation's steps are coarse"),
    "refinement_not_converged": _computation("the refinement did not converge"),
    "refined_predicts_worse": _computation("the refined model predicts worse"),
    "at_bound": _computation("{parameters} sits on a bound"),
    "short_windows": _computation("the shortest window spans few samples"),
    "single_precision": _computation("it was computed in 32-bit"),
    "band_snapped": _computation("windows of a neighbouring band were taken"),
    "residuals_not_tested": _computation("what the model leaves was not tested"),
    "test_failed": _computation("a test of your own failed"),
    "not_offered": _computation("some kinds of terms were not offered"),
    "not_validated": _computation("it was not validated"),
    "validated_on_fitted": _computation("it was validated on what it was fitted to"),
    "simulation_lost": _reproduction("a simulation was lost"),
    "few_roads": _reproduction("ranges over roads are rough"),
}
"""Of each kind of cause its codes, first what says most of it."""
