"""Recordings that allow no answer: one line that says why, and nothing written."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import call, quarter_car_columns, rejected, write_csv

from nightly import nightly_among

Columns = dict[str, np.ndarray]


@pytest.fixture(autouse=True)
def working_folder() -> None:
    write_csv(Path("good.csv"), quarter_car_columns())


def refused(capsys, file: object, *options: object, model="quarter-car") -> str:
    """The message for a record, with a folder asked for that must not appear."""
    arguments = ("identify", file, "--model", model, "--refine", "none", *options)
    return rejected(capsys, 1, *arguments, "--out", "results")


def spoil(name: str, place: int | slice, value: float) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        columns[name][place] = value
        return columns

    return change


def without(name: str) -> Callable[[Columns], Columns]:
    return lambda columns: {k: v for k, v in columns.items() if k != name}


def part(rows: slice) -> Callable[[Columns], Columns]:
    return lambda columns: {name: values[rows] for name, values in columns.items()}


def jittered(columns: Columns) -> Columns:
    late = np.random.default_rng(0).uniform(0, 0.3, columns["t"].size)
    return {**columns, "t": columns["t"] + late * columns["t"][1]}


DOLS = ("--criterion", "dols")
FEW = ("--low-pass", "x1=50", *DOLS)
RECORDS = {
    "missing column": (without("F_t"), (), ("no signal 'F_t'", "x1, x2", "--map F_t=COLUMN")),
    "no acceleration": (without("dx4"), DOLS, ("'dx4'", "derivative", "--map dx4=COLUMN")),
    "no time": (without("t"), (), ("no time column", "--map t=COLUMN")),
    "only time": (lambda columns: {"t": columns["t"]}, (), ("at least one signal",)),
    "no number": (spoil("x2", slice(None), np.nan), (), ("x2",)),
    "infinite": (spoil("x4", 9, -np.inf), (), ("'x4'", "infinite", "sample 9")),
    "time falls": (spoil("t", 7, 0.0), (), ("time must increase", "sample 7")),
    "gaps in every window": (
        spoil("x2", slice(None, None, 3), np.nan), (), ("every window touches",)),
    "uneven": (jittered, (), ("evenly spaced", "--resample HZ")),
    "one sample": (part(slice(1)), (), ("at least two samples",)),
    "fewer samples than a window": (part(slice(40)), (), ("bad.csv", "beta = 0.5 s", "0.195 s")),
    "15 samples filtered": (part(slice(15)), FEW, ("long enough for a step",)),
}  # fmt: skip


@pytest.mark.parametrize("case", nightly_among(RECORDS, ["gaps in every window"]))
def test_records_that_allow_no_answer(capsys, case):
    change, options, words = RECORDS[case]
    write_csv(Path("bad.csv"), change(quarter_car_columns()))
    message = refused(capsys, "bad.csv", "--outliers", "keep", *options)
    assert all(word in message for word in words), message


def axis_columns() -> Columns:
    """What the model `emps` reads: one equation, quick to compile."""
    car = quarter_car_columns()
    return {"t": car["t"], "q": car["x2"], "dq": car["x3"], "force": car["F_t"]}


def test_collinear_regressors_are_named(capsys):
    columns = axis_columns()
    # sign(dq) is 1 throughout, as is the regressor of the offset.
    write_csv(Path("bad.csv"), {**columns, "dq": np.abs(columns["dq"])})
    message = refused(capsys, "bad.csv", *DOLS, model="emps")
    assert all(word in message for word in ("cannot tell these apart", "Fc", "offset", "--set"))
    assert "Fv" not in message


def test_numbers_too_large_to_square_are_refused_with_their_cause(capsys):
    # 1e200 squared is beyond what a double holds: no answer, and none must be made up.
    columns = {k: v if k == "t" else 1e200 * v for k, v in axis_columns().items()}
    write_csv(Path("bad.csv"), columns)
    assert "collinear" not in refused(capsys, "bad.csv", model="emps")


def npz(columns: Columns) -> bytes:
    np.savez("whole.npz", **columns)  # pyright: ignore[reportArgumentType]
    return Path("whole.npz").read_bytes()


FILES = {
    "none.csv": "there is no file 'none.csv'",
    "none.npz": "there is no file 'none.npz'",
    "good.xls": "cannot read 'good.xls'",
    "good": "cannot read 'good'",
    "good.csv/x.csv": "there is no file",
    ".": "'.'",
}


@pytest.mark.parametrize("name", FILES)
def test_files_that_are_not_recordings(capsys, name):
    assert FILES[name] in refused(capsys, name)


def test_a_signal_whose_column_was_left_out_says_why(capsys):
    Path("bad.npz").write_bytes(npz({**quarter_car_columns(), "x2": np.zeros(399)}))
    Path("whole.npz").unlink()
    message = refused(capsys, "bad.npz")
    assert "column 'x2' was left out: its length differs from the time's" in message
    assert "so that the record has no signal 'x2'; it has: x1, x3" in message
    assert "--map" not in message


@pytest.mark.slow
@pytest.mark.raises_finding("column_left_out")
def test_a_signal_that_is_computed_because_its_column_was_left_out(capsys):
    columns = axis_columns()
    time = columns["t"]
    columns |= {"q": np.sin(9 * time) + np.sin(23 * time), "dq": np.full(400, "on")}
    Path("axis.npz").write_bytes(npz(columns))
    result = call(capsys, "identify", "axis.npz", "--model", "emps", "--no-sweep", "--json")
    (said,) = [w["message"] for w in result.document["warnings"] if w["code"] == "column_left_out"]
    assert "axis.npz: column 'dq' was left out: it holds no real numbers" in said
    assert "dq is computed from other signals instead" in said


@pytest.mark.portable
def test_a_process_exits_with_the_status_one_line_and_a_document():
    Path("head.csv").write_text("t,x1\n")
    words = ["identify", "head.csv", "--model", "quarter-car", "--json"]
    script = "from riecjax.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    error = json.loads(done.stdout)["error"]
    assert error["code"] == "data"
    assert done.stderr == f"riecjax: {error['message']}\n"
