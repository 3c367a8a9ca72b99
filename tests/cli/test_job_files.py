"""Job files: options in TOML or in results.json do what they do when typed."""

import json
import tomllib
from pathlib import Path

import click
import numpy as np
import pytest
from command_line import call, rejected, write_csv
from test_own_recordings import MODEL, motion
from tests.settings.test_settings import value_of

import riecjax as rx
from riecjax.cli.command import Given
from riecjax.cli.identify import command as identify
from riecjax.reporting.document import sealed
from riecjax.settings.toml import assigned, form

PLAIN = ("--test-function", "hat", "--no-sweep", "--refine", "none")
ODD = ('q "raw" [m]', "Längs-Kraft # 1 \\ N", "C:\\new\\x.py:y", "tab\tand\x7f", "a=b", "01", "1e3")


def context(arguments: list[str]) -> Given:
    ctx = click.Context(identify)
    identify.parse_args(ctx, arguments)
    return ctx.params["given"]


def form_of(given: Given) -> str:
    return "\n".join(form(identify.settings, given.shown()))


def rerun(toml: str, folder: Path) -> Given:
    file = folder / "job.toml"
    file.write_text(toml, encoding="utf-8")
    return context(["--job", file.name])


@pytest.mark.parametrize("key", [o.key for o in identify.options.values() if o.key != "job"])
def test_every_option_has_its_line_and_comes_back(tmp_path, key):
    option = next(option for option in identify.options.values() if option.key == key)
    arguments = ["r.csv", "--model", "emps"]
    plain = context(arguments)
    assert f"\n# {key} = " in form_of(plain) or key in plain.shown()
    first = context([*arguments, *option.words(value_of(option))])
    text = form_of(first)
    assert first.shown()[key] == tomllib.loads(text)[key]
    assert rerun(text, tmp_path).values == {**first.values, "job": Path("job.toml")}


@pytest.mark.portable
@pytest.mark.parametrize("name", ODD)
def test_any_name_is_kept(tmp_path, name):
    first = context(["r.csv", "--model", "emps", "--map", f"q={name}", "--scale", "x 'y\"=-2e-3"])
    for text in (
        form_of(first),
        "\n".join(line for key, value in first.shown().items() for line in assigned(key, value)),
    ):
        assert tomllib.loads(text)["map"] == {"q": name}
        assert rerun(text, tmp_path).values == {**first.values, "job": Path("job.toml")}


@pytest.mark.portable
def test_what_is_typed_wins(tmp_path):
    (tmp_path / "jobs").mkdir()
    job = tmp_path / "jobs" / "job.toml"
    job.write_text(
        'records = ["a.csv", "../b.csv"]\nmodel = "own/rig.py:axis"\nseed = 3\nsweep = true\n'
        'set = {k = 2, c = 1}\nremove-offset = ["x"]\nband = [1, 5]\nnoise = "none"\n'
    )
    assert context(["--job", "jobs/job.toml"]).known == {"k": 2.0, "c": 1.0}
    typed = "--job jobs/job.toml --set k=4 --no-sweep --remove-offset y --noise q=0.1"
    given = context([*typed.split()])
    assert given.known == {"c": 1.0, "k": 4.0}
    assert given.noise == {"q": 0.1}
    assert given.offsets == ("y",)
    assert given.sweep is False
    assert given.seed == 3
    assert given.band == (1.0, 5.0)
    assert given.files == (Path("jobs/a.csv"), Path("b.csv"))
    assert given.model_name.replace("\\", "/") == "jobs/own/rig.py:axis"
    assert context(["c.csv", "--job", str(job)]).files == (Path("c.csv"),)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tset-function = 'hat'", ("'tset-function'", "'test-function'")),
        ("alpha = true", ("'alpha'", "number")),
        ("sweep = 'no'", ("'sweep'", "true or false")),
        ("records = 3", ("'records'", "names")),
        ('records = ["a\\u0000.csv"]', ("'records'", "as can be typed")),
        ("map = {q = [1]}", ("'map.q'", "quotes")),
        ("remove-offset = {x = 1}", ("'remove-offset'", "list of names")),
        ("quite_else = 1", ("'quite_else'", "riecjax init")),
        ("alpha = ", ("job.toml", "not understood")),
        ("refine = 'x'", ("'refine': 'x' is not one of 'auto', 'none'",)),
        ("refine = ['none', 'auto']", ("'refine' must be a number, or a name in quotes",)),
        ("quadrature = 3", ("'quadrature': '3' is not one of '2'",)),
        ("time-step = [0.005]", ("'time-step' must be a number",)),
        ("band = [nan, 1]", ("'band': 'nan' must be",)),
        ("job = 'x.toml'", ("there is no option 'job'",)),
        ("", ("RECORD",)),
    ],
)
def test_a_wrong_job_is_wrong_usage(capsys, text, words):
    Path("job.toml").write_text(text)
    said = rejected(capsys, 2, "identify", "--job", "job.toml")
    assert all(word in said for word in words)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'# Pr\xfcfstand\nmodel = "emps"', ("byte 4", "save the file as UTF-8")),
        (b'{"job": {}, "provenance": {"files": [{"x": 1}]}}', ("no results.json",)),
        (b'{"job": [], "provenance": {}}', ("no results.json",)),
        pytest.param(b'{"job":' + 100_000 * b"[", ("no results.json",), id="deep"),
        (b'{"job": {"records": ["\\ud800.csv"]}, "provenance": {}}', ("as can be typed",)),
        (b'{"schema": 99, "job": {}, "provenance": {}}', ("schema 99",)),
    ],
)
def test_a_damaged_job(capsys, tmp_path, content, words):
    Path("job.json" if content.startswith(b"{") else "job.toml").write_bytes(content)
    said = rejected(capsys, 2, "identify", "--job", next(tmp_path.iterdir()))
    assert all(word in said for word in words)


@pytest.fixture
def machine():
    Path("machine.py").write_text(MODEL)
    write_csv(Path("run.csv"), motion(offset=4.0, count=1500))


def without_command(document: dict) -> dict:
    del document["provenance"]["command"], document["checksum"]
    for step in document["verdict"]["next"]:
        step.pop("command")
    return document


@pytest.mark.raises_finding("file_changed")
@pytest.mark.portable
def test_a_result_runs_again_to_the_same_numbers(capsys, machine):
    name, out = "Prüfstand Ω, 1.csv", Path("Läufe 7") / "µ 2"
    Path("run.csv").rename(name)
    arguments = (name, "--model", "machine.py:axis", *PLAIN, "--seed", "5")
    assert call(capsys, "identify", *arguments, "--out", out).status == 0
    file = out / "results.json"
    first = json.loads(file.read_text())
    assert first["job"]["records"] == [f"../../{name}"]
    assert call(capsys, "identify", "--job", file, "--out", out).status == 0
    assert without_command(json.loads(file.read_text())) == without_command(first)
    # A folder with results is its results.
    assert call(capsys, "check", "--job", out).status == 0

    # Results of the first schema, which held the scatter over seeds beside, run as well.
    old = {**json.loads(file.read_text()), "schema": 1, "seed_scatter": None}
    earlier = out / "earlier.json"
    earlier.write_text(json.dumps(sealed(old)))
    assert call(capsys, "check", "--job", earlier).status == 0
    assert rx.load(earlier).schema == 1

    with Path(name).open("a") as stream:
        stream.write("\n")
    changed = call(capsys, "identify", "--job", file, "--json")
    assert changed.err.count("file_changed") == 1
    assert changed.document["warnings"][-1]["code"] == "file_changed"
    assert name in changed.document["warnings"][-1]["message"]


@pytest.mark.portable
def test_init_guesses_and_says_so(capsys, machine):
    _, q, force, *_ = motion(count=300).values()
    write_csv(Path("odd.csv"), {"Q [m]": q, "Load [N]": force})
    made = call(capsys, "init", "odd.csv", "--model", "emps")
    assert made.status == 0, made.err
    job = tomllib.loads(made.out)
    assert job["map"] == {"q": "Q [m]", "force": "Load [N]"}
    assert "a guess, by its unit" in made.out
    assert "there is no time column" in made.out


def test_init_reads_units_as_the_model_does(capsys, machine):
    time = np.arange(300) / 100
    signals = {name: np.sin(9 * time + i) for i, name in enumerate(("x1", "x2", "x3", "x4", "F_t"))}
    write_csv(Path("acc.csv"), {"t": time, **signals, "dx3 [g]": np.cos(9 * time)})
    made = call(capsys, "init", "acc.csv", "--model", "quarter-car")
    assert made.status == 0, made.err
    assert "is in g, as the file says" in made.out
    assert "as it stands" not in made.out


def test_the_files_of_a_bag_in_a_folder_are_input_files():
    Path("bag").mkdir()
    for name in ("metadata.yaml", "bag_0.mcap"):
        Path("bag", name).write_text("")
    files = context(["bag", "run.csv", "--model", "machine.py:axis"]).inputs()
    inside = [str(Path("bag", name)) for name in ("bag_0.mcap", "metadata.yaml")]
    assert sorted(files) == sorted([*inside, "run.csv", "machine.py"])
