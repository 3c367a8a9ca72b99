"""Is what is said of an answer true of it? `python -m benchmarks.calibration PART [options]`.

`verdicts`: levels and doubts of right and wrong models; `constants`: numbers that decide them;
`coverage` and `small_samples`: intervals;
`sensor_noise`: bias and bounds; `hidden_modes`, `backlash`: those that are there and those that
are not.
"""

from benchmarks.recorded import run_part

PARTS = ("verdicts", "constants", "coverage", "small_samples", "sensor_noise", "hidden_modes",
         "backlash")  # fmt: skip

if __name__ == "__main__":
    run_part("calibration", PARTS)
