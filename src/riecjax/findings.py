"""What a user should know of data or of a result, with a code for scripts.

`CODES` has every code that a finding may have: what it is about, and that in words. Their order is
that of importance: of several codes of one kind, the first says most of their cause. Each has a row
in docs/warnings.md, a test that raises it, and one that must not.
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
    """What is known of a code: the `kind` of cause, and its `phrase`."""

    kind: Kind
    phrase: str

    def said(self, signals: tuple[str, ...] = (), parameters: tuple[str, ...] = ()) -> str:
        """The phrase, of these signals and parameters."""
        return self.phrase.format(
            signals=" and ".join(signals) or "a signal",
            parameters=", ".join(parameters) or "some parameters",
        )


def code_of(code: str) -> FindingCode:
    """What is known of this code; of an unknown one, its words."""
    return CODES.get(code) or FindingCode("computation", code.replace("_", " "))


PHRASES: dict[Kind, dict[str, str]] = {
    "undetermined": {
        "constant_target": "one term alone reproduces the input",
        "unidentifiable": "the recordings cannot tell {parameters} apart",
        "undetermined": "the recordings say nothing of {parameters}",
        "mode_not_carried": "the recordings carry no such mode",
        "series_spring_not_carried": "the recordings do not tell {parameters} from infinity",
        "negative_value": "{parameters} is below zero",
        "interval_wider_than_estimate": "the recordings hardly determine {parameters}",
        "not_excited": "the recordings hold nothing of {parameters}",
        "rarely_excited": "{parameters} is seldom excited",
    },
    "sensors": {
        "prior_disagrees": "the recordings and the prior of {parameters} disagree",
        "outside_bound": "{parameters} lies outside its bounds",
        "time_unit_doubtful": "time may be in another unit than seconds",
        "unit_mismatch": "{signals} has another unit than the model expects",
        "not_its_derivative": "{signals} do not fit each other",
        "at_rest": "{signals} rests where friction jumps",
        "copied_signal": "{signals} are one signal",
        "duplicate_recording": "a recording was given twice",
        "lost_rows": "{signals} part by a jump",
        "two_clocks": "{signals} run by two clocks",
        "silent_input": "{signals} says nothing",
        "late_signal": "{signals} is late",
        "low_passed": "one of {signals} is filtered",
        "wrong_gain": "{signals} do not fit each other in size",
        "drifting_signal": "one of {signals} drifts",
        "velocity_offset": "one of {signals} has an offset",
        "repeated_rows": "rows stand in the recording twice",
        "wrong_zero": "some sensor's zero is off",
        "constant_signal": "{signals} never varies",
        "stuck_sensor": "{signals} is stuck for a while",
        "clipped": "{signals} is clipped",
        "outliers": "{signals} has outliers",
        "hum": "the mains hum in {signals}",
        "missing_samples": "samples of {signals} are missing",
        "quantised": "{signals} is coarsely quantised",
        "column_left_out": "a column of {signals} is left out",
        "part_left_out": "a part of a file is left out",
        "nothing_cut": "a cut removes nothing",
        "file_changed": "a file is not the one that was read before",
        "rows_left_out": "windows that touch a missing sample are left out",
    },
    "model": {
        "unmodelled_mode": "the model leaves out a mode",
        "large_residual": "the model leaves more than half of the signal",
        "residual_follows_signal": "what the model leaves follows {signals}",
        "hysteresis": "what the model leaves depends on the way that the motion came",
        "window_sensitive": "estimates drift with window length",
        "uneven_errors": "errors differ much along the record",
        "does_not_predict": "the model does not predict",
        "records_disagree": "the recordings disagree",
        "no_known_term": "no term of an equation is known",
        "break_points_outside": "a break point lies outside the data",
    },
    "noise": {
        "noise_dominates": "noise of {signals} makes much of what tells {parameters} apart",
    },
    "data": {
        "nearly_collinear": "little tells {parameters} apart",
        "ill_conditioned": "little tells some parameters apart",
        "few_blocks": "few stretches of the record tell of {parameters}",
        "few_effective_windows": "few independent windows tell of {parameters}",
        "short_record": "the record is short",
    },
    "computation": {
        "mode_elsewhere": "no mode is near the frequency asked for",
        "coarse_sampling": "the motion is sampled coarsely",
        "coarse_steps": "the simulation's steps are coarse",
        "refinement_not_converged": "the refinement did not converge",
        "refined_predicts_worse": "the refined model predicts worse",
        "at_bound": "{parameters} sits on a bound",
        "short_windows": "the shortest window spans few samples",
        "single_precision": "it was computed in 32-bit",
        "band_snapped": "windows of a neighbouring band were taken",
        "residuals_not_tested": "what the model leaves was not tested",
        "not_validated": "it was not validated",
        "validated_on_fitted": "it was validated on what it was fitted to",
    },
    "reproduction": {
        "simulation_lost": "a simulation was lost",
        "few_roads": "ranges over roads are rough",
    },
}
"""Of each kind of cause its codes, first what says most of it, each with words for a sentence: they
have places for `{signals}` and `{parameters}`."""
CODES = {
    code: FindingCode(kind, phrase)
    for kind, codes in PHRASES.items()
    for code, phrase in codes.items()
}
KINDS: tuple[Kind, ...] = ("undetermined", "sensors", "model", "noise", "data", "computation")
"""Kinds of causes in a verdict. What a user says of a parameter is held against it as a sensor."""
