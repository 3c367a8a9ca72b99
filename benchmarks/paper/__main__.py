"""The paper's quarter car beyond its tables: `python -m benchmarks.paper PART [options]`.

`reconstruct_curves` is `make calibrate`; `source_model` finds the model behind the recordings.
"""

from benchmarks.recorded import run_part

PARTS = ("reconstruct_curves", "source_model")

if __name__ == "__main__":
    run_part("paper", PARTS)
