"""What a user should know of data or of a result, with a code for scripts.

`CODES` has every code that a finding may have: what it is about, in words, and what decides. Their
order is that of importance: of several codes of one kind, the first says most of their cause. Each
has a row in docs/warnings.md, a test that raises it, and one that must not.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    import numpy as np


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


def option_for(option: str, signals: Iterable[str], value: str) -> tuple[str, ...]:
    """An option of the command line for each of these signals, `--shift v=0.005`."""
    return tuple(word for name in signals for word in (option, f"{name}={value}"))


def line_taken_off(name: str, time: "np.ndarray", offset: float, change: float) -> tuple[str, ...]:
    """The option that takes an offset off a signal, and a change along the record about its middle.

    A formula, and not the mean or the straight line of what was recorded: those are the machine's
    as well, as far as it does not come back to where it began. None for a name that no formula has.
    """
    if not name.isidentifier():
        return ()
    rate, middle = change / float(time[-1] - time[0]), 0.5 * (time[0] + time[-1])
    constant = f"-({offset:.6g})" if offset else ""
    line = f"-({rate:.6g})*(t-{middle:.15g})" if change else ""
    return ("--derive", f"{name}={name}{constant}{line}")


Kind = Literal["undetermined", "sensors", "model", "noise", "data", "computation", "reproduction"]


class FindingCode(NamedTuple):
    """What is known of a code.

    **Fields:** `kind` of cause; `phrase` for a sentence, with places for `{signals}` and
    `{parameters}`; `threshold`, "module:NAME" of the constant that decides, empty where none does:
    where it is a fact such as a missing sample.
    """

    kind: Kind
    phrase: str
    threshold: str = ""

    def said(self, signals: tuple[str, ...] = (), parameters: tuple[str, ...] = ()) -> str:
        """The phrase, of these signals and parameters."""
        return self.phrase.format(
            signals=" and ".join(signals) or "a signal",
            parameters=", ".join(parameters) or "some parameters",
        )


def code_of(code: str) -> FindingCode:
    """What is known of this code; of an unknown one, its words."""
    return CODES.get(code) or FindingCode("computation", code.replace("_", " "))


CODES: dict[str, FindingCode] = {
    "constant_target": FindingCode(
        "undetermined", "one term alone reproduces the input", "estimation.constant_target:CONSTANT"
    ),
    "unidentifiable": FindingCode(
        "undetermined",
        "the recordings cannot tell {parameters} apart",
        "estimation.excitation:UNIDENTIFIABLE",
    ),
    "undetermined": FindingCode("undetermined", "the recordings say nothing of {parameters}"),
    "mode_not_carried": FindingCode(
        "undetermined", "the recordings carry no such mode", "estimation.evidence:CERTAIN"
    ),
    "series_spring_not_carried": FindingCode(
        "undetermined",
        "the recordings do not tell {parameters} from infinity",
        "estimation.estimate:TOLD_LAG",
    ),
    "negative_value": FindingCode("undetermined", "{parameters} is below zero"),
    "interval_wider_than_estimate": FindingCode(
        "undetermined",
        "the recordings hardly determine {parameters}",
        "estimation.estimate:MATTERING_SHARE",
    ),
    "not_excited": FindingCode("undetermined", "the recordings hold nothing of {parameters}"),
    "rarely_excited": FindingCode(
        "undetermined", "{parameters} is seldom excited", "estimation.estimate:LOST_SHARE"
    ),
    "prior_disagrees": FindingCode(
        "sensors",
        "the recordings and the prior of {parameters} disagree",
        "assessment.refining:STRANGE",
    ),
    "outside_bound": FindingCode("sensors", "{parameters} lies outside its bounds"),
    "time_unit_doubtful": FindingCode("sensors", "time may be in another unit than seconds"),
    "unit_mismatch": FindingCode("sensors", "{signals} has another unit than the model expects"),
    "not_its_derivative": FindingCode(
        "sensors", "{signals} do not fit each other", "records.faults.derivative_pairs:GROSS"
    ),
    "at_rest": FindingCode(
        "sensors", "{signals} rests where friction jumps", "records.faults.at_rest:LEAST"
    ),
    "copied_signal": FindingCode(
        "sensors", "{signals} are one signal", "records.faults.rows:ROUNDED"
    ),
    "duplicate_recording": FindingCode(
        "sensors", "a recording was given twice", "records.faults.rows:ALIKE"
    ),
    "lost_rows": FindingCode(
        "sensors", "{signals} part by a jump", "records.faults.derivative_pairs:LOST"
    ),
    "two_clocks": FindingCode(
        "sensors", "{signals} run by two clocks", "records.faults.derivative_pairs:CHANGE"
    ),
    "silent_input": FindingCode(
        "sensors", "{signals} says nothing", "validation.input_faults:NOTHING_EXPLAINED"
    ),
    "late_signal": FindingCode("sensors", "{signals} is late", "validation.late_signals:LEVEL"),
    "low_passed": FindingCode(
        "sensors", "one of {signals} is filtered", "records.faults.derivative_pairs:LIKELIER"
    ),
    "wrong_gain": FindingCode(
        "sensors", "{signals} do not fit each other in size", "records.faults.derivative_pairs:GAIN"
    ),
    "drifting_signal": FindingCode(
        "sensors", "one of {signals} drifts", "records.faults.derivative_pairs:OFFSET"
    ),
    "velocity_offset": FindingCode(
        "sensors", "one of {signals} has an offset", "records.faults.derivative_pairs:OFFSET"
    ),
    "repeated_rows": FindingCode(
        "sensors", "rows stand in the recording twice", "records.faults.rows:FEWEST"
    ),
    "wrong_zero": FindingCode(
        "sensors", "some sensor's zero is off", "estimation.constant_target:LEAST"
    ),
    "constant_signal": FindingCode("sensors", "{signals} never varies"),
    "stuck_sensor": FindingCode(
        "sensors", "{signals} is stuck for a while", "records.faults.signals:STUCK_RATIO"
    ),
    "clipped": FindingCode("sensors", "{signals} is clipped", "records.faults.signals:PILE_UP"),
    "outliers": FindingCode("sensors", "{signals} has outliers", "records.faults.spikes:SPIKE"),
    "hum": FindingCode(
        "sensors", "the mains hum in {signals}", "records.preparation.hum:BY_CHANCE"
    ),
    "missing_samples": FindingCode("sensors", "samples of {signals} are missing"),
    "quantised": FindingCode(
        "sensors", "{signals} is coarsely quantised", "records.faults.signals:COARSE"
    ),
    "column_left_out": FindingCode("sensors", "a column of {signals} is left out"),
    "part_left_out": FindingCode("sensors", "a part of a file is left out"),
    "nothing_cut": FindingCode("sensors", "a cut removes nothing"),
    "file_changed": FindingCode("sensors", "a file is not the one that was read before"),
    "rows_left_out": FindingCode("sensors", "windows that touch a missing sample are left out"),
    "unmodelled_mode": FindingCode(
        "model", "the model leaves out a mode", "validation.residuals:NOTABLE_SIZE"
    ),
    "large_residual": FindingCode(
        "model",
        "the model leaves more than half of the signal",
        "estimation.estimate:LARGE_RESIDUAL",
    ),
    "residual_follows_signal": FindingCode(
        "model",
        "what the model leaves follows {signals}",
        "validation.residuals:NOTABLE_CORRELATION",
    ),
    "hysteresis": FindingCode(
        "model",
        "what the model leaves depends on the way that the motion came",
        "validation.residuals:NOTABLE_GAIN",
    ),
    "window_sensitive": FindingCode(
        "model", "estimates drift with window length", "validation.sweep:SMALLEST_DRIFT"
    ),
    "uneven_errors": FindingCode(
        "model", "errors differ much along the record", "validation.residuals:NOTABLE_RATIO"
    ),
    "does_not_predict": FindingCode(
        "model", "the model does not predict", "validation.held_out:PREDICTS_ROUGHLY"
    ),
    "records_disagree": FindingCode(
        "model", "the recordings disagree", "estimation.estimate:NOTABLE_INFLATION"
    ),
    "no_known_term": FindingCode(
        "model", "no term of an equation is known", "estimation.estimate:NOTABLE_SHRINKAGE"
    ),
    "break_points_outside": FindingCode("model", "a break point lies outside the data"),
    "noise_dominates": FindingCode(
        "noise",
        "noise of {signals} makes much of what tells {parameters} apart",
        "estimation.excitation:DOMINATES",
    ),
    "nearly_collinear": FindingCode(
        "data", "little tells {parameters} apart", "estimation.excitation:NEARLY_COLLINEAR"
    ),
    "ill_conditioned": FindingCode("data", "little tells some parameters apart"),
    "few_blocks": FindingCode(
        "data",
        "few stretches of the record tell of {parameters}",
        "uncertainty.intervals:ENOUGH_FREEDOM",
    ),
    "few_effective_windows": FindingCode(
        "data", "few independent windows tell of {parameters}", "estimation.estimate:FEWEST_WINDOWS"
    ),
    "short_record": FindingCode("data", "the record is short", "estimation.estimate:FEWEST_BLOCKS"),
    "mode_elsewhere": FindingCode("computation", "no mode is near the frequency asked for"),
    "coarse_sampling": FindingCode(
        "computation", "the motion is sampled coarsely", "estimation.check:QUADRATURE_ERROR"
    ),
    "coarse_steps": FindingCode("computation", "the simulation's steps are coarse"),
    "refinement_not_converged": FindingCode("computation", "the refinement did not converge"),
    "refined_predicts_worse": FindingCode(
        "computation", "the refined model predicts worse", "assessment.refining:WORSE"
    ),
    "at_bound": FindingCode("computation", "{parameters} sits on a bound"),
    "short_windows": FindingCode("computation", "the shortest window spans few samples"),
    "single_precision": FindingCode("computation", "it was computed in 32-bit"),
    "band_snapped": FindingCode("computation", "windows of a neighbouring band were taken"),
    "residuals_not_tested": FindingCode("computation", "what the model leaves was not tested"),
    "not_validated": FindingCode("computation", "it was not validated"),
    "validated_on_fitted": FindingCode("computation", "it was validated on what it was fitted to"),
    "simulation_lost": FindingCode("reproduction", "a simulation was lost"),
    "few_roads": FindingCode("reproduction", "ranges over roads are rough"),
}
KINDS: tuple[Kind, ...] = ("undetermined", "sensors", "model", "noise", "data", "computation")
"""Kinds of causes in a verdict. What a user says of a parameter is held against it as a sensor."""


def codes_of(kind: Kind) -> list[str]:
    """Codes of this kind, first what says most of it."""
    return [code for code, known in CODES.items() if known.kind == kind]
