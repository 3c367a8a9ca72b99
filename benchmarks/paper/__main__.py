"""The paper's quarter car beyond its tables: `python -m benchmarks.paper PART [options]`.

`reconstruct_curves` is `make calibrate`; `source_model` and `source_fit` find the model behind the
recordings; `refined_quarter_car` refines all variants; `input_design` compares inputs.
"""

from benchmarks.recorded import run_part

PARTS = (
    "reconstruct_curves",
    "source_model",
    "source_fit",
    "refined_quarter_car",
    "input_design",
)

if __name__ == "__main__":
    run_part("paper", PARTS)
