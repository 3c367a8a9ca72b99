"""Every code that a finding may have: what it is about, in words, and what it was computed from.

The order is that of importance: of several codes of one kind, the first says most of their cause.
Each has a row in docs/warnings.md, a test that raises it, and one that must not.
"""

from typing import Literal, NamedTuple

Kind = Literal["undetermined", "sensors", "model", "noise", "data", "computation", "reproduction"]
Severity = Literal["refusal", "warning", "remark"]


class FindingCode(NamedTuple):
    """What is known of a code.

    **Fields:** `kind` of cause; `phrase` for a sentence, with places for `{signals}` and
    `{parameters}`; `computed_from`, what was looked at; `threshold`, "module:NAME" of the constant
    that decides, empty where none does: where it is a fact such as a missing sample; `severity`:
    a `refusal` leaves no answer, a `remark` needs nothing done.
    """

    kind: Kind
    phrase: str
    computed_from: str
    threshold: str = ""
    severity: Severity = "warning"

    def said(self, signals: tuple[str, ...] = (), parameters: tuple[str, ...] = ()) -> str:
        """The phrase, of these signals and parameters."""
        return self.phrase.format(
            signals=" and ".join(signals) or "a signal",
            parameters=", ".join(parameters) or "some parameters",
        )


def code_of(code: str) -> FindingCode:
    """What is known of this code; of an unknown one, its words."""
    return CODES.get(code) or FindingCode("computation", code.replace("_", " "), "")


CODES: dict[str, FindingCode] = {
    "constant_target": FindingCode(
        "undetermined",
        "one term alone reproduces the input",
        "averages and scatter of the target's window sums",
        "estimation.constant_target:CONSTANT",
        "refusal",
    ),
    "unidentifiable": FindingCode(
        "undetermined",
        "the recordings cannot tell {parameters} apart",
        "singular values of the scaled regressors",
        "estimation.excitation:UNIDENTIFIABLE",
        "refusal",
    ),
    "undetermined": FindingCode(
        "undetermined",
        "the recordings say nothing of {parameters}",
        "singular values of the output error's Jacobian",
    ),
    "mode_not_carried": FindingCode(
        "undetermined",
        "the recordings carry no such mode",
        "what the mode explains of stretches that it was not fitted to",
        "estimation.mode_evidence:CERTAIN",
    ),
    "series_spring_not_carried": FindingCode(
        "undetermined",
        "the recordings do not tell {parameters} from infinity",
        "the spring's lag over its standard error",
        "estimation.estimate:TOLD_LAG",
    ),
    "negative_value": FindingCode(
        "undetermined", "{parameters} is below zero", "the interval of a mass or a damper"
    ),
    "interval_wider_than_estimate": FindingCode(
        "undetermined",
        "the recordings hardly determine {parameters}",
        "the interval, and the size of the parameter's term",
        "estimation.estimate:MATTERING_SHARE",
    ),
    "not_excited": FindingCode(
        "undetermined",
        "the recordings hold nothing of {parameters}",
        "the size of a regressor",
        severity="refusal",
    ),
    "rarely_excited": FindingCode(
        "undetermined",
        "{parameters} is seldom excited",
        "bootstrap replicates that leave a parameter open",
        "estimation.estimate:LOST_SHARE",
    ),
    "prior_disagrees": FindingCode(
        "sensors",
        "the recordings and the prior of {parameters} disagree",
        "the prior against the estimate without it",
        "assessment.refining:STRANGE",
    ),
    "outside_bound": FindingCode(
        "sensors", "{parameters} lies outside its bounds", "the linear estimate against bounds"
    ),
    "time_unit_doubtful": FindingCode(
        "sensors",
        "time may be in another unit than seconds",
        "time stamps, and the model's windows",
    ),
    "unit_mismatch": FindingCode(
        "sensors",
        "{signals} has another unit than the model expects",
        "the dimensions of a file's unit and of the model's",
    ),
    "not_its_derivative": FindingCode(
        "sensors",
        "{signals} do not fit each other",
        "increments of a signal against the integral of its derivative",
        "records.consistency:GAIN",
    ),
    "at_rest": FindingCode(
        "sensors",
        "{signals} rests where friction jumps",
        "stretches in which a velocity scatters about zero no more than its noise",
        "records.faults.at_rest:LEAST",
        "remark",
    ),
    "copied_signal": FindingCode(
        "sensors",
        "{signals} are one signal",
        "what a straight line leaves of one signal by another",
        "records.faults.rows:ROUNDED",
    ),
    "duplicate_recording": FindingCode(
        "sensors",
        "a recording was given twice",
        "samples of recordings, wherever in them they lie",
        "records.faults.rows:ALIKE",
    ),
    "lost_rows": FindingCode(
        "sensors",
        "{signals} part by a jump",
        "the delay of a derivative, from part to part of the record",
        "records.faults.derivative_pairs:LOST",
    ),
    "two_clocks": FindingCode(
        "sensors",
        "{signals} run by two clocks",
        "the delay of a derivative, from part to part of the record",
        "records.faults.derivative_pairs:CHANGE",
    ),
    "silent_input": FindingCode(
        "sensors",
        "{signals} says nothing",
        "an input's noise against its deviation, and what the equation explains of it",
        "validation.silent_inputs:NOTHING_EXPLAINED",
    ),
    "late_signal": FindingCode(
        "sensors",
        "{signals} is late",
        "phase of a derivative against its signal, over frequencies; or the delay at which an "
        "equation leaves least, and what it leaves there beyond noise",
        "validation.late_signals:LEVEL",
    ),
    "low_passed": FindingCode(
        "sensors",
        "one of {signals} is filtered",
        "phase and size of a derivative against its signal, over frequencies",
        "records.faults.derivative_pairs:LIKELIER",
    ),
    "wrong_gain": FindingCode(
        "sensors",
        "{signals} do not fit each other in size",
        "size of a derivative against its signal, over frequencies",
        "records.faults.derivative_pairs:GAIN",
    ),
    "drifting_signal": FindingCode(
        "sensors",
        "one of {signals} drifts",
        "a derivative's lowest frequencies against its signal's",
        "records.faults.derivative_pairs:OFFSET",
    ),
    "velocity_offset": FindingCode(
        "sensors",
        "one of {signals} has an offset",
        "a derivative's mean against the change of its signal",
        "records.faults.derivative_pairs:OFFSET",
    ),
    "repeated_rows": FindingCode(
        "sensors",
        "rows stand in the recording twice",
        "rows that are others to the bit",
        "records.faults.rows:FEWEST",
    ),
    "wrong_zero": FindingCode(
        "sensors",
        "some sensor's zero is off",
        "a fit of means and motion against one of motion alone",
        "estimation.constant_target:LEAST",
    ),
    "constant_signal": FindingCode("sensors", "{signals} never varies", "distinct values"),
    "stuck_sensor": FindingCode(
        "sensors",
        "{signals} is stuck for a while",
        "runs of one value that begin or end abruptly while other signals move",
        "records.faults.stuck_sensor:STUCK_RATIO",
    ),
    "clipped": FindingCode(
        "sensors",
        "{signals} is clipped",
        "how often and how abruptly a signal meets its extreme values",
        "records.faults.clipping:PILE_UP",
    ),
    "outliers": FindingCode(
        "sensors",
        "{signals} has outliers",
        "sixth differences, and polynomials through the samples around, against the noise",
        "records.faults.spikes:SPIKE",
    ),
    "hum": FindingCode(
        "sensors",
        "the mains hum in {signals}",
        "lines of a grid in a signal's spectrum against what surrounds them",
        "records.preparation.hum:BY_CHANCE",
    ),
    "missing_samples": FindingCode(
        "sensors", "samples of {signals} are missing", "samples that are no number"
    ),
    "quantised": FindingCode(
        "sensors",
        "{signals} is coarsely quantised",
        "the greatest common step of a signal's values against its size",
        "records.faults.signals:COARSE",
    ),
    "column_left_out": FindingCode(
        "sensors",
        "a column of {signals} is left out",
        "a column that cannot be read, whose signal others give",
        severity="remark",
    ),
    "part_left_out": FindingCode(
        "sensors", "a part of a file is left out", "a part that cannot be read"
    ),
    "nothing_cut": FindingCode(
        "sensors", "a cut removes nothing", "the record's first and last time"
    ),
    "file_changed": FindingCode(
        "sensors", "a file is not the one that was read before", "its SHA-256"
    ),
    "rows_left_out": FindingCode(
        "sensors",
        "windows that touch a missing sample are left out",
        "windows that a record without gaps would hold",
        severity="remark",
    ),
    "unmodelled_mode": FindingCode(
        "model",
        "the model leaves out a mode",
        "a peak in the spectrum of the equation error",
        "validation.equation_residual:NOTABLE_SIZE",
    ),
    "large_residual": FindingCode(
        "model",
        "the model leaves more than half of the signal",
        "the rms of the equation error over that of its target",
        "estimation.estimate:LARGE_RESIDUAL",
    ),
    "residual_follows_signal": FindingCode(
        "model",
        "what the model leaves follows {signals}",
        "correlation of the equation error with a signal at lags",
        "validation.equation_residual:NOTABLE_CORRELATION",
    ),
    "hysteresis": FindingCode(
        "model",
        "what the model leaves depends on the way that the motion came",
        "what a state that goes with the displacement explains beyond any function of the motion",
        "validation.loops:NOTABLE_GAIN",
    ),
    "window_sensitive": FindingCode(
        "model",
        "estimates drift with window length",
        "estimates of bands of window lengths, and their joint covariance",
        "studies.sweep:SMALLEST_DRIFT",
    ),
    "uneven_errors": FindingCode(
        "model",
        "errors differ much along the record",
        "mean squares of window errors over stretches of time",
        "validation.equation_residual:NOTABLE_RATIO",
    ),
    "does_not_predict": FindingCode(
        "model",
        "the model does not predict",
        "a simulation against a recording it was not fitted to",
        "validation.goodness_of_fit:PREDICTS_ROUGHLY",
    ),
    "records_disagree": FindingCode(
        "model",
        "the recordings disagree",
        "scatter between recordings against that within them",
        "estimation.estimate:NOTABLE_INFLATION",
    ),
    "no_known_term": FindingCode(
        "model",
        "no term of an equation is known",
        "shrinkage by the equation's residual",
        "estimation.estimate:NOTABLE_SHRINKAGE",
    ),
    "break_points_outside": FindingCode(
        "model", "a break point lies outside the data", "the range of a signal against break points"
    ),
    "noise_dominates": FindingCode(
        "noise",
        "noise of {signals} makes much of what tells {parameters} apart",
        "the largest generalised eigenvalue of noise and regressors",
        "estimation.excitation:DOMINATES",
    ),
    "nearly_collinear": FindingCode(
        "data",
        "little tells {parameters} apart",
        "singular values of the scaled regressors",
        "estimation.excitation:NEARLY_COLLINEAR",
    ),
    "ill_conditioned": FindingCode(
        "data", "little tells some parameters apart", "the condition of the normal equations"
    ),
    "few_blocks": FindingCode(
        "data",
        "few stretches of the record tell of {parameters}",
        "degrees of freedom of a parameter's variance",
        "uncertainty.intervals:ENOUGH_FREEDOM",
    ),
    "few_effective_windows": FindingCode(
        "data",
        "few independent windows tell of {parameters}",
        "correlation of the windows' errors",
        "estimation.estimate:FEWEST_WINDOWS",
    ),
    "short_record": FindingCode(
        "data",
        "the record is short",
        "independent blocks in the record",
        "estimation.estimate:FEWEST_BLOCKS",
    ),
    "mode_elsewhere": FindingCode(
        "computation",
        "no mode is near the frequency asked for",
        "where the search for a mode ended",
    ),
    "coarse_sampling": FindingCode(
        "computation",
        "the motion is sampled coarsely",
        "integrals by two orders of quadrature",
        "estimation.check:QUADRATURE_ERROR",
    ),
    "coarse_steps": FindingCode(
        "computation", "the simulation's steps are coarse", "the answer with steps half as long"
    ),
    "refinement_not_converged": FindingCode(
        "computation", "the refinement did not converge", "the search's result"
    ),
    "refined_predicts_worse": FindingCode(
        "computation",
        "the refined model predicts worse",
        "predictions by both answers",
        "assessment.refining:WORSE",
    ),
    "at_bound": FindingCode("computation", "{parameters} sits on a bound", "the refined values"),
    "short_windows": FindingCode(
        "computation", "the shortest window spans few samples", "samples in the shortest window"
    ),
    "single_precision": FindingCode(
        "computation", "it was computed in 32-bit", "the type of the result"
    ),
    "band_snapped": FindingCode(
        "computation",
        "windows of a neighbouring band were taken",
        "bins of window lengths in a Summary",
        severity="remark",
    ),
    "residuals_not_tested": FindingCode(
        "computation", "what the model leaves was not tested", "the length of the record"
    ),
    "not_validated": FindingCode("computation", "it was not validated", "a simulation that failed"),
    "validated_on_fitted": FindingCode(
        "computation", "it was validated on what it was fitted to", "the recordings of both"
    ),
    "simulation_lost": FindingCode(
        "reproduction", "a simulation was lost", "results that are not finite"
    ),
    "few_roads": FindingCode(
        "reproduction", "ranges over roads are rough", "the number of roads", severity="remark"
    ),
}
KINDS: tuple[Kind, ...] = ("undetermined", "sensors", "model", "noise", "data", "computation")
"""Kinds of causes in a verdict. What a user says of a parameter is held against it as a sensor."""


def codes_of(kind: Kind) -> list[str]:
    """Codes of this kind, first what says most of it."""
    return [code for code, known in CODES.items() if known.kind == kind]
