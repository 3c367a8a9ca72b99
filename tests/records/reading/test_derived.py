import json

import h5py
import numpy as np
import pytest
import scipy.io

from riecjax.doubts.reading import read_record, read_recordings
from riecjax.errors import DataError, ModelError
from riecjax.records.derived import derived

COLUMNS = {
    "q": np.array([0.5, -1.0, 2.0, 0.25]),
    "vir": np.array([3.0, np.nan, -1.0, 4.0]),
}
Q, VIR = COLUMNS["q"], COLUMNS["vir"]
FORMULAS = {
    "35.15 * vir - mean(vir)": 35.15 * VIR - 2.0,
    "-q**2 + 1": -(Q**2) + 1,
    "(q + 1) / (2 - q)": np.array([1.0, 0.0, np.inf, 1.25 / 1.75]),
    "2 ** -q": 2.0**-Q,
    "sign(q) * abs(q) + tanh(q)": Q + np.tanh(Q),
    "maximum(q, 0) - minimum(0, q)": np.abs(Q),
    "sqrt(exp(2 * log(abs(q))))": np.abs(Q),
    "sin(q)**2 + cos(q)**2 + tan(q) * 0": np.ones(4),
    "+q": Q,
    "7": np.full(4, 7.0),
    " q ": Q,
}


@pytest.mark.parametrize("formula", FORMULAS)
def test_formulas(formula):
    np.testing.assert_allclose(derived(formula, COLUMNS), FORMULAS[formula], rtol=1e-14)


REFUSED = {
    "__import__('os').system('true')": "__import__('os')",
    "q.real": "'q.real'",
    "lambda: 1": "lambda",
    "q if q else 1": "q if q else 1",
    "q < 1": "q < 1",
    "q % 2": "q % 2",
    "~q": "~q",
    "'text'": "'text'",
    "True * q": "True",
    "eval(q)": "eval(q)",
    "sin(q, out=q)": "out=q",
    "sin(*q)": "*q",
    "(y := q)": "y := q",
    "f'{q}'": "f'{q}'",
    "sin + 1": "'sin'",
    "sin(q, q)": "sin takes 1",
    "maximum(q)": "maximum takes 2",
    "q +": "cannot be read",
    "": "cannot be read",
    "q\0": "cannot be read",
    "9" * 400: "too large",
    "(" * 500 + "q" + ")" * 500: "too deep|cannot be read",
    "-" * 1990 + "q": "too deep",
    "q" * 3000: "2000 characters",
}


@pytest.mark.parametrize("formula", REFUSED, ids=lambda text: text[:20].replace("\0", "0"))
def test_whatever_else_is_refused_and_named(formula):
    with pytest.raises(ModelError) as raised:
        derived(formula, COLUMNS)
    assert any(words in str(raised.value) for words in REFUSED[formula].split("|"))
    assert len(str(raised.value)) < 400


@pytest.mark.parametrize("formula", ["9**9**9 * q", "q * 9.0**9**9**9", "exp(1e9) + q"])
def test_huge_powers_are_infinite_and_quick(tmp_path, formula):
    assert np.isinf(derived(formula, COLUMNS)).any()
    (tmp_path / "a.csv").write_text("t,q\n0,1\n1,2\n")
    with pytest.raises(DataError, match=r"a\.csv: signal 'y' has 2 infinite"):
        read_record(tmp_path / "a.csv", derive={"y": formula})


def test_derived_signals_of_a_file(tmp_path):
    (tmp_path / "a.csv").write_text("t,vir,q (mm)\n0,1,10\n0.5,,20\n1,3,30\n")
    record = read_record(
        tmp_path / "a.csv",
        rename={"q": "q (mm)"},
        scale={"q": 1e-3},
        derive={"force": "35 * vir - mean(vir)", "power": "force * q * t", "q": "-q"},
        units={"force": "N", "power": "kW"},
    )
    assert np.asarray(record.present(["force"])).tolist() == [True, False, True]
    np.testing.assert_allclose(record["force"][np.array([0, 2])], [33.0, 103.0])
    np.testing.assert_allclose(record["power"][2], 1e3 * 103 * 0.03)
    np.testing.assert_allclose(record["q"], [-0.01, -0.02, -0.03])
    assert dict(record.units) == {"force": "N", "power": "W"}


def h5(path, log):
    with h5py.File(path, "w") as file:
        for name, values in log.items():
            file[name.replace(".", "/")] = values


RIGS = {"gain": 3.2, "car": {"mass": 1.5}}, {"gain": -0.4, "car": {"mass": 7}}
FLAT = [{"gain": rig["gain"], "car.mass": rig["car"]["mass"]} for rig in RIGS]
"""Single values beside the arrays of two recordings."""
WRITERS = {
    "json": lambda path, i, log: path.write_text(json.dumps(RIGS[i] | log)),
    "common group.json": lambda path, i, log: path.write_text(json.dumps({"a": RIGS[i] | log})),
    "list.json": lambda path, i, log: path.write_text(json.dumps([rig | log for rig in RIGS])),
    "npz": lambda path, i, log: np.savez(path, **FLAT[i], **log),
    "mat": lambda path, i, log: scipy.io.savemat(path, RIGS[i] | log),
    "h5": lambda path, i, log: h5(path, FLAT[i] | log),
}


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("i", [0, 1])
def test_single_values_of_a_file_in_formulas(tmp_path, ending, i):
    t = 0.01 * np.arange(40)
    current, path = np.cos(3 * t), tmp_path / f"a.{ending}"
    WRITERS[ending](path, i, {"t": t.tolist(), "current": current.tolist()})
    record = read_recordings(path, derive={"F": "gain * current - car.mass"})[
        i if ending[0] == "l" else 0
    ].record
    np.testing.assert_allclose(record["F"], FLAT[i]["gain"] * current - FLAT[i]["car.mass"])
    assert set(record.arrays) == {"current", "F"}
    with pytest.raises(ModelError, match=r"no column or single value 'car\.lost' in the"):
        read_recordings(path, derive={"F": "car.lost * current"})
