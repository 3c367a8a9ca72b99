import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from command_line import call, quarter_car_columns, rejected, write_csv

from nightly import nightly, nightly_among

Columns = dict[str, np.ndarray]
SIGNALS = ("x1", "x2", "x3", "x4", "F_t", "dx3", "dx4")


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_csv(Path("good.csv"), quarter_car_columns())
    return tmp_path


def refused(capsys, status: int, file: object, *options: object, model="quarter-car") -> str:
    """The message for a record or an option, with a folder asked for that must not appear."""
    arguments = ("identify", file, "--model", model, "--refine", "none", *options)
    return rejected(capsys, status, *arguments, "--out", "results")


def changed(**replaced: object) -> Callable[[Columns], Columns]:
    def change(columns: Columns) -> Columns:
        return {**columns, **replaced}  # pyright: ignore[reportReturnType]

    return change


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


RECORDS = {
    "missing column": (without("F_t"), ("no signal 'F_t'", "x1, x2", "--map F_t=COLUMN")),
    "no time": (without("t"), ("no time column", "--map t=COLUMN")),
    "only time": (lambda columns: {"t": columns["t"]}, ("at least one signal",)),
    "no number": (spoil("x2", slice(None), np.nan), ("x2",)),
    "infinite": (spoil("x4", 9, -np.inf), ("'x4'", "infinite", "sample 9")),
    "NaN in time": (spoil("t", 3, np.nan), ("time is missing", "sample 3")),
    "time falls": (spoil("t", 7, 0.0), ("time must increase", "sample 7")),
    "time repeats": (spoil("t", 8, 7 / 200), ("time must increase", "sample 8")),
    "gaps in every window": (spoil("x2", slice(None, None, 3), np.nan), ("every window touches",)),
    "uneven": (jittered, ("evenly spaced", "--resample HZ")),
    "one sample": (part(slice(1)), ("at least two samples",)),
    "fewer samples than a window": (part(slice(40)), ("beta = 0.5 s", "0.195 s")),
}


@pytest.mark.parametrize("case", nightly_among(RECORDS, ["gaps in every window"]))
def test_records_that_allow_no_answer(capsys, case):
    change, words = RECORDS[case]
    write_csv(Path("bad.csv"), change(quarter_car_columns()))
    message = refused(capsys, 1, "bad.csv", "--outliers", "keep")
    for word in words:
        assert word in message


def axis_columns(columns: Columns) -> Columns:
    """What the model `emps` reads: one equation, quick to compile."""
    return {"t": columns["t"], "q": columns["x2"], "dq": columns["x3"], "force": columns["F_t"]}


def test_collinear_regressors_are_named(capsys):
    columns = axis_columns(quarter_car_columns())
    columns["dq"] = np.abs(columns["dq"])
    # sign(dq) is 1 throughout, as is the regressor of the offset.
    write_csv(Path("bad.csv"), columns)
    message = refused(capsys, 1, "bad.csv", "--criterion", "dols", model="emps")
    for word in ("cannot tell these apart", "Fc", "offset", "--set"):
        assert word in message
    assert "Fv" not in message


@pytest.mark.slow
def test_silent_regressors_are_named(capsys):
    columns = axis_columns(quarter_car_columns())
    write_csv(Path("bad.csv"), {**columns, "q": np.zeros(400)})
    message = refused(capsys, 1, "bad.csv", model="emps")
    assert "nothing in the record tells of Fv" in message


@pytest.mark.slow
def test_fewer_windows_than_parameters(capsys):
    write_csv(Path("bad.csv"), axis_columns(quarter_car_columns()))
    assert "cannot tell" in refused(capsys, 1, "bad.csv", "--windows", 3, model="emps")


def test_a_message_about_one_of_several_records_names_it(capsys):
    write_csv(Path("bad.csv"), part(slice(40))(quarter_car_columns()))
    message = rejected(capsys, 1, "identify", "good.csv", "bad.csv", "--model", "quarter-car")
    assert "bad.csv" in message or "record 2" in message


def test_a_message_about_a_missing_signal_names_the_record(capsys):
    write_csv(Path("bad.csv"), without("F_t")(quarter_car_columns()))
    message = rejected(capsys, 1, "identify", "good.csv", "bad.csv", "--model", "quarter-car")
    assert "bad.csv" in message or "record 2" in message


HEADER = "t,x1\n"
TEXTS = {
    "empty": (b"", ("first row must name the columns",)),
    "blank": (b"\n\n\n", ("first row must name the columns",)),
    "header only": (HEADER.encode(), ("no", "samples")),
    "no header": (b"0,1\n1,2\n2,3\n", ("no time column", "column 1, column 2", "--columns")),
    "binary": (bytes(range(256)) * 20, ("UTF-8",)),
    "text among the numbers": (b"t,x1\n0,1\n1,abc\n2,3\n", ("'abc'",)),
    "text column": (b"t,x1\n0,on\n1,off\n", ("'on'",)),
    "ragged": (b"t,x1\n0,1\n1\n2,3\n", ("columns",)),
    "too many values": (b"t,x1\n0,1,5\n1,2,5\n", ("2 column names", "3 columns")),
    "null bytes": (b"t,x1\n0,\x00\n1,2\n", ("byte 7 is 0", "binary")),
    "two times of one name": (b"t,a,t\n0,1,1\n1,1,1\n", ("two columns are called 't'",)),
}


@pytest.mark.parametrize("case", TEXTS)
def test_unreadable_text_files(capsys, case):
    content, words = TEXTS[case]
    Path("bad.csv").write_bytes(content)
    message = refused(capsys, 1, "bad.csv")
    assert "bad.csv: " in message
    for word in words:
        assert word in message


def test_a_bad_number_is_found_on_the_line_that_the_message_names(capsys):
    # Line 5 of the file as an editor counts it, the header being line 1.
    Path("bad.csv").write_text("t,x1\n0,1\n1,2\n2,3\n3,abc\n4,5\n")
    assert "line 5" in refused(capsys, 1, "bad.csv")


def test_a_ragged_row_is_found_on_the_line_that_the_message_names(capsys):
    Path("bad.csv").write_text("t,x1\n0,1\n1,2\n2\n3,4\n")
    message = refused(capsys, 1, "bad.csv")
    assert "line 4" in message
    # Advice for callers of NumPy is none for a user of this program.
    assert "usecols" not in message


def npz(columns: Columns) -> bytes:
    np.savez("whole.npz", **columns)  # pyright: ignore[reportArgumentType]
    return Path("whole.npz").read_bytes()


def mat(columns: Columns) -> bytes:
    scipy.io.savemat("whole.mat", columns)
    return Path("whole.mat").read_bytes()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.99])
@pytest.mark.parametrize("make", [npz, mat])
def test_truncated_binary_files(capsys, make, share):
    whole = make(quarter_car_columns())
    name = f"bad.{make.__name__}"
    Path(name).write_bytes(whole[: int(share * len(whole))])
    assert f"{name}: not a readable {make.__name__.upper()} file" in refused(capsys, 1, name)


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_binary_garbage(capsys, ending):
    Path(f"bad.{ending}").write_bytes(np.random.default_rng(0).bytes(4000))
    assert f"bad.{ending}: not a readable" in refused(capsys, 1, f"bad.{ending}")


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_binary_file_without_numbers(capsys, ending):
    columns = {"a": np.array("text"), "b": np.zeros((3, 3))}
    make = {"npz": npz, "mat": mat}[ending]
    Path(f"bad.{ending}").write_bytes(make(columns))
    assert "no columns of numbers" in refused(capsys, 1, f"bad.{ending}")


class Payload:
    def __reduce__(self):
        return (os.mkdir, ("executed",))


def test_pickled_objects_are_refused_and_not_executed(capsys):
    objects = np.array([Payload()] * 400, dtype=object)
    Path("bad.npz").write_bytes(npz({**quarter_car_columns(), "x3": objects}))
    assert "'x3' was left out: it holds Python objects" in refused(capsys, 1, "bad.npz")
    Path("disguised.npz").write_bytes(pickle.dumps(Payload()))
    assert "disguised.npz: not a readable NPZ file" in refused(capsys, 1, "disguised.npz")
    assert not Path("executed").exists()


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
    assert FILES[name] in refused(capsys, 1, name)


OPTIONS = {
    "--alpha 0.4 --beta 0.3": (1, "0 < alpha < beta"),
    "--alpha 0.3 --beta 0.3": (1, "0 < alpha < beta"),
    "--alpha 0.6": (1, "0 < alpha < beta"),
    "--beta 100": (1, "longer than the record, 1.995 s"),
    "--alpha 1e-4 --beta 1e-3": (1, "shorter than one sample"),
    "--alpha -1": (2, "'--alpha'"),
    "--alpha 0": (2, "'--alpha'"),
    "--alpha nan": (2, "'--alpha'"),
    "--beta inf": (2, "'--beta'"),
    "--beta one": (2, "'--beta': 'one' is not a number"),
    "--windows 0": (2, "'--windows'"),
    "--windows -5": (2, "'--windows'"),
    "--windows 2.5": (2, "'--windows'"),
    "--windows most": (2, "neither a whole number nor 'all'"),
    "--criterion foo": (2, "'riec', 'dols'"),
    "--criterion dols --alpha 0.1": (2, "belong to --criterion riec"),
    "--criterion dols --band 1 10": (2, "belong to --criterion riec"),
    "--criterion dols --windows all": (2, "belong to --criterion riec"),
    "--band 1 10 --alpha 0.05 --beta 0.5": (
        2,
        "--band sets the same lengths as --alpha and --beta",
    ),
    "--band 10 1": (1, "0 < low < high"),
    "--band 5 5": (1, "0 < low < high"),
    "--band 0 10": (2, "'--band'"),
    "--band 1 nan": (2, "'--band'"),
    "--band 1": (2, "--band"),
    "--band 2 5 --alpha 0.3": (1, "0 < alpha < beta"),
    "--intervals jackknife": (2, "'--intervals'"),
    "--criterion dols --windows 100": (2, "belong to --criterion riec"),
    "--horizon 1": (2, "--horizon goes with --refine auto or output-error"),
    "--refine integral --channel x2": (2, "--channel goes with --refine output-error"),
    "--bound K_t=0:": (2, "--bound goes with --refine"),
    "--refine output-error --horizon 0": (2, "'--horizon'"),
    "--prior K_t=1+-2": (2, "--prior goes with --refine integral"),
    "--refine integral --prior K_t=1": (2, "not of the form NAME=MEAN±SD"),
    "--refine integral --prior K_t=1+-0": (2, "must be a finite number greater than zero"),
    "--refine integral --prior K_t=1±2 --prior K_t=1±3": (2, "'K_t' is given twice"),
    "--refine output-error --bound K_t": (2, "not of the form NAME=LOW:HIGH"),
    "--refine output-error --bound K_t=a:b": (2, "are not numbers"),
    "--refine output-error --bound K=0:1": (1, "bounds are given for 'K'"),
    "--refine output-error --channel z": (1, "no signal 'z' to compare"),
    "--refine foo": (2, "'--refine'"),
    "--test-function foo": (2, "'--test-function'"),
    "--quadrature 3": (2, "'--quadrature'"),
    "--test-function bump --quadrature 4": (2, "--quadrature belongs to the boxcar and the hat"),
    "--criterion dols --test-function hat": (2, "belong to --criterion riec"),
    "--hold-out 1": (2, "must lie between 0 and 1"),
    "--per-record foo": (1, "unknown parameter 'foo'"),
    "--from 5": (1, "the record lasts from 0 to 1.995 s, counted from its first sample"),
    "--derive x9=import(os)": (1, "import"),
    "--upsample 0": (2, "'--upsample'"),
    "--resample 1e9": (1, "to identify from them takes about"),
    "--remove-offset foo": (1, "'foo'"),
    "--validate none.csv": (1, "there is no file 'none.csv'"),
    "--time-step 0": (2, "greater than zero"),
    "--set foo=1": (1, "unknown parameter 'foo'; the model has: K_t, M_us, M_s"),
    "--set foo": (2, "not of the form NAME=VALUE"),
    "--set M_s": (2, "not of the form NAME=VALUE"),
    "--set M_s=": (2, "not of the form NAME=VALUE"),
    "--set =3": (2, "not of the form NAME=VALUE"),
    "--set M_s=abc": (2, "'abc' in 'M_s=abc' is not a number"),
    "--set M_s=1=2": (2, "is not a number"),
    "--set M_s=nan": (2, "not a finite number"),
    "--set M_s=1 --set M_s=2": (2, "'M_s' is given twice"),
    "--map foo": (2, "not of the form SIGNAL=COLUMN"),
    "--map x1=": (2, "not of the form SIGNAL=COLUMN"),
    "--map x1=zz": (1, "no column 'zz'; there are: t, x1"),
    "--map x1=x2 --map x1=x3": (2, "'x1' is given twice"),
    "--scale x1": (2, "not of the form COLUMN=FACTOR"),
    "--scale x1=k": (2, "'k' in 'x1=k' is not a number"),
    "--scale zz=2": (1, "no column 'zz'"),
    "--scale t=-1": (1, "time must increase"),
    "--low-pass x1=100": (1, "half the sampling rate, 100 Hz"),
    "--low-pass x1=0": (1, "between 0 and half the sampling rate"),
    "--low-pass x1=-1": (1, "between 0 and half the sampling rate"),
    "--low-pass x1=1": (1, "too short to be filtered"),
    "--low-pass zz=10": (1, "no signal 'zz'"),
    "--every 0": (2, "'--every'"),
    "--every 1000": (1, "too few would remain"),
    "--seed -1": (2, "'--seed'"),
    "--seed 1.5": (2, "'--seed'"),
    "--seed 99999999999999999999": (2, "'--seed'"),
    "--foo": (2, "--foo"),
}


REFINED = [o for o in OPTIONS if o.startswith("--refine") and OPTIONS[o][0] == 1]


@pytest.mark.parametrize("options", nightly_among(OPTIONS, REFINED))
def test_options(capsys, options):
    status, words = OPTIONS[options]
    message = refused(capsys, status, "good.csv", *options.split())
    assert words in message
    if status == 2:
        assert "See 'riecjax identify --help'." in message


def test_every_parameter_known(capsys):
    names = ("K_t", "M_us", "M_s", "K_s", "F_1", "F_2", "F_3", "F_4")
    options = [word for name in names for word in ("--set", f"{name}=1")]
    assert "nothing is left to identify" in refused(capsys, 1, "good.csv", *options)


@pytest.mark.parametrize("sample_count", [2, 8, 15])
def test_filter_on_a_few_samples(capsys, sample_count):
    write_csv(Path("bad.csv"), part(slice(sample_count))(quarter_car_columns()))
    message = refused(capsys, 1, "bad.csv", "--low-pass", "x1=50", "--criterion", "dols")
    assert "too short to be filtered" in message


def test_dols_without_the_accelerations(capsys):
    write_csv(Path("bad.csv"), without("dx4")(quarter_car_columns()))
    message = refused(capsys, 1, "bad.csv", "--criterion", "dols")
    for word in ("'dx4'", "derivative", "--map dx4=COLUMN"):
        assert word in message


def test_a_column_that_was_renamed_away_is_gone(capsys):
    assert "no signal 'x1'" in refused(capsys, 1, "good.csv", "--map", "x2=x1")


LEFT_OUT = {
    "text": (np.full(400, "on"), "column 'x2' was left out: it holds "),
    "nothing": (np.full(400, np.nan), "column 'x2' was left out: it holds no number at all"),
    "other length": (np.zeros(399), "column 'x2' was left out: its length differs from the time's"),
}


@pytest.mark.parametrize("case", LEFT_OUT)
def test_a_signal_whose_column_was_left_out_says_why(capsys, case):
    values, words = LEFT_OUT[case]
    Path("bad.npz").write_bytes(npz({**quarter_car_columns(), "x2": values}))
    Path("whole.npz").unlink()
    message = refused(capsys, 1, "bad.npz")
    assert words in message
    assert "so that the record has no signal 'x2'; it has: x1, x3" in message
    assert "--map" not in message


@pytest.mark.slow
@pytest.mark.raises_finding("column_left_out")
def test_a_signal_that_is_computed_because_its_column_was_left_out(capsys):
    columns = axis_columns(quarter_car_columns())
    time = columns["t"]
    columns |= {"q": np.sin(9 * time) + np.sin(23 * time), "dq": np.full(400, "on")}
    Path("axis.npz").write_bytes(npz(columns))
    result = call(capsys, "identify", "axis.npz", "--model", "emps", "--no-sweep", "--json")
    (said,) = [w["message"] for w in result.document["warnings"] if w["code"] == "column_left_out"]
    assert "axis.npz: column 'dq' was left out: it holds no real numbers" in said
    assert "dq is computed from other signals instead" in said


def test_a_filter_on_a_column_s_old_name_says_which_name_to_use(capsys):
    write_csv(
        Path("raw.csv"), {"load" if k == "F_t" else k: v for k, v in quarter_car_columns().items()}
    )
    options = ("--map", "F_t=load", "--low-pass", "load=50")
    message = refused(capsys, 1, "raw.csv", *options)
    assert "--map load=COLUMN" not in message


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("foo", "unknown model 'foo'; built in are: quarter-car, "),
        ("quarter-car-source", "can be simulated but not identified"),
        ("none.py:f", "there is no file 'none.py'"),
        ("good.csv", "unknown model 'good.csv'"),
        ("good.csv:x1", "unknown model 'good.csv:x1'"),
    ],
)
def test_models(capsys, model, words):
    assert words in refused(capsys, 1, "good.csv", model=model)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["foo"], "No such command 'foo'"),
        (["--foo"], "--foo"),
        (["identify"], "RECORD..."),
        (["identify", "good.csv"], "'--model'"),
        (["models", "emps", "more"], "more"),
        (["simulate"], "MODEL"),
        (["simulate", "duffing", "--out", "s.csv"], "'--input'"),
        (["simulate", "duffing", "--input", "pothole"], "'--out'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_wrong_usage(capsys, arguments, words):
    message = rejected(capsys, 2, *arguments)
    assert words in message
    assert "--help'" in message


def test_out_that_is_a_file(capsys):
    write_csv(Path("axis.csv"), axis_columns(quarter_car_columns()))
    arguments = ("identify", "axis.csv", "--model", "emps", "--out")
    assert "is a file" in rejected(capsys, 2, *arguments, "good.csv")
    assert "cannot write" in rejected(capsys, 1, *arguments, "good.csv/results")


SIMULATIONS = {
    "duffing --input foo": (1, "unknown input 'foo'; give white-noise, robson, pothole"),
    "duffing --input none.csv": (1, "there is no file 'none.csv'"),
    "duffing --input good.csv": (1, "no signal 'u'"),
    "duffing --input white-noise --rate 10": (1, "60"),
    "duffing --input white-noise --rate 0": (2, "'--rate'"),
    "duffing --input white-noise --duration -1": (2, "'--duration'"),
    "duffing --input white-noise --duration 1e-9": (1, "at least 4 samples"),
    "duffing --input white-noise --duration 0.02": (1, "zero throughout"),
    "duffing --input white-noise --rate 1e9": (1, "too many"),
    "duffing --input white-noise --rate 1e300": (1, "too many"),
    "duffing --input white-noise --rate 1e308": (1, "too many"),
    "duffing --input white-noise --set zz=3": (1, "unknown parameter 'zz'; duffing has: m, d"),
    "duffing --input white-noise --set k3": (2, "NAME=VALUE"),
    "duffing --input white-noise --set k3=-1e9": (1, "lost its solution"),
    "duffing --input white-noise --set m=0": (1, "lost its solution"),
    "foo --input white-noise": (1, "unknown model 'foo'"),
    "quarter-car --input good.csv": (1, "no signal 'v_r'"),
    "two-mass --input force.csv --duration 50": (1, "force.csv lasts 1.995 s, not 50 s"),
    "two-mass --input force.csv --duration 1e308": (1, "force.csv lasts"),
    "two-mass --input force.csv --rate 50": (1, "200 Hz"),
}


@pytest.mark.parametrize("arguments", SIMULATIONS)
def test_simulate(capsys, arguments):
    status, words = SIMULATIONS[arguments]
    columns = quarter_car_columns()
    write_csv(Path("force.csv"), {"t": columns["t"], "F": columns["F_t"]})
    message = rejected(capsys, status, "simulate", *arguments.split(), "--out", "s.csv")
    assert words in message
    # A message is read by a person.
    assert len(message) < 400


def test_simulate_does_not_advise_an_option_that_it_lacks(capsys):
    message = rejected(capsys, 1, "simulate", "duffing", "--input", "good.csv", "--out", "s.csv")
    if "--map" in message:
        assert "--map" in call(capsys, "simulate", "--help").out


@pytest.mark.parametrize(
    ("out", "status", "words"),
    [
        ("s.txt", 1, ".csv, .npz, .mat"),
        ("s", 1, ".csv, .npz, .mat"),
        ("none/s.csv", 1, "no folder 'none'"),
        ("good.csv/s.csv", 1, "good.csv"),
        (".", 2, "is a directory"),
    ],
)
def test_simulate_to_nowhere(capsys, out, status, words):
    arguments = ("simulate", "duffing", "--input", "white-noise", "--out", out)
    assert words in rejected(capsys, status, *arguments)


def test_a_lost_simulation_leaves_the_older_file(capsys):
    arguments = ("simulate", "duffing", "--input", "white-noise", "--set", "k3=-1e9")
    rejected(capsys, 1, *arguments, "--out", "good.csv")


def test_numbers_too_large_to_square_are_refused_with_their_cause(capsys):
    # 1e200 squared is beyond what a double holds: no answer, and none must be made up.
    columns = axis_columns(quarter_car_columns())
    write_csv(Path("bad.csv"), {k: v if k == "t" else 1e200 * v for k, v in columns.items()})
    message = refused(capsys, 1, "bad.csv", model="emps")
    assert "collinear" not in message


def run_process(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from riecjax.cli.main import main; main()", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.portable
@pytest.mark.parametrize(
    ("status", "arguments"),
    [
        (1, ["identify", "head.csv", "--model", "quarter-car", "--json"]),
        *nightly([(1, ["identify", "none.csv", "--model", "quarter-car", "--json"])]),
        (2, ["identify", "good.csv", "--model", "quarter-car", "--refine", "foo"]),
    ],
)
def test_process_exits_with_the_status_and_one_line(status, arguments):
    Path("head.csv").write_text("t,x1\n")
    done = run_process(*arguments)
    assert done.returncode == status
    assert done.stderr.startswith("riecjax: ")
    assert done.stderr.count("\n") == 1
    if status == 2:
        assert done.stdout == ""
        return
    document = json.loads(done.stdout)
    assert document["schema"] == 2
    assert f"riecjax: {document['error']['message']}\n" == done.stderr
    assert document["error"]["code"] == "data"
