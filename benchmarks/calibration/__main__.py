"""Is what is said of an answer true of it? `python -m benchmarks.calibration PART [options]`.

`verdicts`: levels and doubts of right and wrong models; `coverage` and `small_samples`: intervals;
`sensor_noise`: bias and bounds; `hidden_modes`: modes that are there and that are not;
`refinement_gate`: when refined values are taken; `sticking`: a joint that rests.
"""

from benchmarks.recorded import run_part

PARTS = (
    "verdicts",
    "coverage",
    "small_samples",
    "sensor_noise",
    "hidden_modes",
    "refinement_gate",
    "sticking",
)

if __name__ == "__main__":
    run_part("calibration", PARTS)
