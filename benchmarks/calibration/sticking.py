"""Is a joint that sticks identified? Coverage of nominal 95 % intervals over seeds.

    python -m benchmarks.calibration sticking [--seeds 100] [--case clean|velocity|encoder]
        [--at-rest keep]

The joint of tests/machines.py, 40 s at 500 Hz, rests for 4 % of the time.
"""

import argparse

import numpy as np
from tests.machines import JOINT, JOINT_SENSORS, JOINT_TRUTH, joint, joint_record

import riecjax as rx


def main() -> None:
    """Print, for each case, mean error and spread in percent, and the share covered."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--case", choices=JOINT_SENSORS, action="append")
    parser.add_argument("--at-rest", choices=["mask", "keep"], default="mask")
    asked = parser.parse_args()
    rx.start_jax()
    truth = np.array(list(JOINT_TRUTH.values()))
    print(f"{'case':10}{'':10}", *(f"{name:>8}" for name in JOINT_TRUTH))
    for case in asked.case or JOINT_SENSORS:
        errors, covered = [], []
        for seed in range(asked.seeds):
            summary = rx.summarise(
                JOINT, joint_record(joint(seed), case, seed), at_rest=asked.at_rest
            )
            estimate = rx.estimate(JOINT, summary).to_dict()
            errors.append([estimate[name]["value"] for name in JOINT_TRUTH] / truth - 1)
            ends = np.array([estimate[name]["interval"] for name in JOINT_TRUTH])
            covered.append((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
        for label, row in (
            ("mean %", 100 * np.mean(errors, axis=0)),
            ("spread %", 100 * np.std(errors, axis=0)),
            ("covered %", 100 * np.mean(covered, axis=0)),
        ):
            print(f"{case:10}{label:10}", *(f"{value:8.2f}" for value in row), flush=True)


if __name__ == "__main__":
    main()
