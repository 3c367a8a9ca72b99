"""Wrong usage, and options that this recording cannot bear: the status, and one line that helps."""

from pathlib import Path

import pytest
from command_line import quarter_car_columns, rejected, write_csv

from nightly import nightly

BODY = """
import riecjax as rx
from tests.machines import BODY as body

mapped = rx.Equation(
    rx.Term("m", "v", derivative=1, unit="kg"),
    rx.Terms("F", rx.roof([-1.0, 0.0, 1.0]), "v", unit="N"),
    -rx.Term(1.0, "F"),
    name="mapped",
)
statics = rx.Equation(rx.Term("k", "x"), -rx.Term(1.0, "F"), name="statics")
"""
CAR = "identify good.csv --model quarter-car --refine none --out results "
WRONG = {
    CAR: {
        "--alpha 0.4 --beta 0.3": (1, "0 < alpha < beta"),
        "--beta 100": (1, "longer than the record, 1.995 s"),
        "--alpha 1e-4 --beta 1e-3": (1, "shorter than one sample"),
        "--alpha -1": (2, "'--alpha'"),
        "--beta inf": (2, "'--beta'"),
        "--windows most": (2, "'most' is not a whole number (or 'all')"),
        "--criterion foo": (2, "'riec', 'dols'"),
        "--criterion dols --band 1 10": (2, "belong to --criterion riec"),
        "--band 1 10 --alpha 0.05 --beta 0.5": (2, "--band sets the same lengths as --alpha and"),
        "--band 10 1": (1, "0 < low < high"),
        "--horizon 1": (2, "--horizon goes with --refine auto or --refine output-error"),
        "--refine integral --channel x2": (2, "--channel goes with --refine output-error"),
        "--prior K_t=1": (2, "not of the form MEAN±SD"),
        "--refine output-error --bound K_t": (2, "not of the form NAME=LOW:HIGH"),
        "--refine output-error --bound K=0:1": (1, "bounds are given for 'K'"),
        "--refine output-error --channel z": (1, "no signal 'z' to compare"),
        "--quadrature 3": (2, "'--quadrature'"),
        "--test-function bump --quadrature 4": (2, "--quadrature belongs to the boxcar and the"),
        "--per-record foo": (1, "unknown parameter 'foo'"),
        "--from 1.5 --to 1": (2, "--from must lie before --to."),
        "--from 5": (1, "the record lasts from 0 to 1.995 s, counted from its first sample"),
        "--resample 1e9": (1, "to identify from them takes about"),
        "--set foo=1": (1, "unknown parameter 'foo'; the model has: K_t, M_us, M_s"),
        "--set M_s=abc": (2, "'abc' in 'M_s=abc' is not a number"),
        "--set M_s=nan": (2, "not a finite number"),
        "--set M_s=1 --set M_s=2": (2, "'M_s' is given twice"),
        "--map x1=zz": (1, "no column 'zz'; there are: t, x1"),
        "--map x2=x1": (1, "no signal 'x1'"),
        "--scale t=-1": (1, "time must increase"),
        "--low-pass x1=100": (1, "half the sampling rate, 100 Hz"),
        "--low-pass x1=1": (1, "long enough for a step"),
        "--every 1000": (1, "too few would remain"),
        "--seed 99999999999999999999": (2, "'--seed'"),
        "--noise z=1": (1, "there is no such signal; there are: "),
        "--noise none --noise x1=2": (2, "'none' is for all signals"),
        "--add-mode x4=fast": (2, "--add-mode"),
    },
    "identify good.csv --model ": {
        "foo": (1, "unknown model 'foo'; built in are: quarter-car, "),
        "quarter-car-source": (1, "can be simulated but not identified"),
        "body.py:": (1, "body.py"),
        "quarter-car --out good.csv": (2, "is a file"),
        "quarter-car --out good.csv/sub": (1, "'good.csv' is no folder"),
    },
    "identify body.csv --refine none --model ": {
        "body.py:body --add-spring m": (1, "'m' is of an acceleration, a mass"),
        "body.py:body --add-spring k": (1, "only a softer spring"),
        "body.py:body --add-spring b": (1, "no equation has a coefficient 'b'"),
        "body.py:mapped --add-spring F_1": (1, "without --add-spring), and refine it from there"),
        "body.py:body --add-mode v --quadrature 6": (1, "leave out --test-function, --quadrature"),
        "body.py:body --add-mode v --test-function hat": (1, "--band, --alpha and --beta may stay"),
    },
    "": {
        "foo": (2, "No such command 'foo'"),
        "identify good.csv": (2, "'--model'"),
        "simulate": (2, "MODEL"),
        "simulate duffing --out s.csv": (2, "'--input'"),
        "identify --job none.toml": (2, "cannot be read"),
        "reproduce --roads 0": (2, "--roads"),
        "reproduce --out good.csv": (2, "'good.csv' is a file"),
        "reproduce --full --roads 2": (2, "--roads"),
    },
    "simulate duffing --out s.csv --input ": {
        "foo": (1, "unknown input 'foo'; give white-noise, robson, pothole"),
        "white-noise --duration 1e-9": (1, "at least 4 samples"),
        "white-noise --duration 0.02": (1, "zero throughout"),
        "white-noise --rate 1e9": (1, "too many"),
        "white-noise --set zz=3": (1, "unknown parameter 'zz'; duffing has: m, d"),
        "white-noise --set k3=-1e9": (1, "lost its solution"),
    },
    "simulate --out s.csv ": {
        "foo --input white-noise": (1, "unknown model 'foo'"),
        "body.py:statics --input white-noise --set k=1": (1, "cannot be simulated"),
        "two-mass --input force.csv --duration 50": (1, "force.csv lasts 1.995 s, not 50 s"),
        "two-mass --input force.csv --rate 50": (1, "200 Hz"),
    },
    "simulate duffing --input white-noise --out ": {
        "s": (1, ".csv, .npz, .mat"),
        "none/s.csv": (1, "cannot write 'none/s.csv'"),
        ".": (2, "is a directory"),
        # An older file stays as it is.
        "good.csv --set k3=-1e9": (1, "lost its solution"),
    },
    "discover body.csv --model body.py:body --out out ": {
        "--candidates few.py:LAWS": (1, "a candidate is the text 'x'"),
        "--candidates few.py:NONE": (1, "no object 'NONE'"),
        "--to 0.4 --beta 0.5 --alpha 0.1": (1, "is longer than the record"),
    },
}
LATE = ("--refine output-error --bound K=0:1", "--refine output-error --channel z")
ROWS = [(start, rest, *said) for start, rows in WRONG.items() for rest, said in rows.items()]


@pytest.mark.parametrize(
    ("start", "rest", "status", "words"),
    [nightly([row])[0] if row[1] in LATE else row for row in ROWS],
    ids=lambda value: value.strip() if isinstance(value, str) else None,
)
def test_it_is_told_in_one_line(capsys, start, rest, status, words):
    car = quarter_car_columns()
    write_csv(Path("good.csv"), car)
    write_csv(Path("force.csv"), {"t": car["t"], "F": car["F_t"]})
    write_csv(Path("body.csv"), {"t": car["t"], "x": car["x2"], "v": car["x4"], "F": car["F_t"]})
    Path("body.py").write_text(BODY)
    Path("few.py").write_text("LAWS = ['x']\n")
    message = rejected(capsys, status, *f"{start}{rest}".split())
    assert words in message
    # A message is read by a person.
    assert len(message) < 600
    assert ("--help'" in message) == (status == 2)
