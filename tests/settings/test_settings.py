"""A setting is said once: one field is a keyword, an option, a line of a job, and documented."""

import inspect
import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.cli.command import Given, SettingsCommand, settings_command
from riecjax.cli.main import COMMANDS, cli, run
from riecjax.models.catalogue import with_asked
from riecjax.settings import Contradiction, Job, Read, Settings, many, taking
from riecjax.settings.kinds import TEXT, choice
from riecjax.settings.option import Option
from riecjax.settings.toml import form

VERBS = {
    rx.read_recording: rx.settings.Reading,
    rx.check: rx.settings.Check,
    rx.identify: rx.settings.Identify,
    rx.assess: rx.settings.Assess,
    rx.discover: rx.settings.Discover,
    rx.fleet: rx.fleets.Fleets,
}


@dataclass(frozen=True, kw_only=True)
class ReadMore(Read):
    """How a file is read."""

    skipped: Sequence[str] = many("--skip COLUMN", TEXT)
    """Columns that are not read."""
    colours: Sequence[str] = many("--colour", choice("red", "blue"))


@taking(ReadMore)
def read(path: str, settings: ReadMore) -> ReadMore:
    """What a verb gets."""
    return settings


@settings_command("read", ReadMore, Job, short_help="Read.")
def command(given: Given) -> None:
    """Read."""


def given_to(of: SettingsCommand, *words: str) -> Given:
    ctx = click.Context(of)
    of.parse_args(ctx, list(words))
    return ctx.params["given"]


def test_a_field_is_a_keyword():
    assert read("a.csv", skipped=["x", "y"]).skipped == ("x", "y")
    assert "skipped" in inspect.signature(read).parameters
    with pytest.raises(rx.DataError, match=r"skipped is the text 'x'. Write skipped=\('x',\)"):
        read("a.csv", skipped="x")


def test_a_field_is_an_option_with_its_help():
    given = given_to(command, "--skip", "x", "--skip", "y")
    assert given.take(ReadMore) == read("a.csv", skipped=("x", "y"))
    assert given_to(command, "--colour", "red", "--colour", "blue").colours == ("red", "blue")
    help = " ".join(command.get_help(click.Context(command)).split())
    assert "--skip COLUMN Columns that are not read. Repeatable." in help


def test_a_field_is_a_line_of_a_job_and_in_provenance(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert '# Columns that are not read. Repeatable.\n# skip = ["COLUMN"]' in "\n".join(
        form(command.settings, {})
    )
    given = given_to(command, "--skip", "x")
    assert given.as_job()["skip"] == ["x"]
    text = "\n".join(form(command.settings, given.shown()))
    assert tomllib.loads(text)["skip"] == ["x"]
    Path("job.toml").write_text(text)
    assert given_to(command, "--job", "job.toml").skipped == ("x",)
    # A further one stands beside what a job says.
    assert given_to(command, "--job", "job.toml").with_options(["--skip", "y"]) == [
        *("read", "--job", "job.toml", "--skip", "x", "--skip", "y")
    ]


def test_documentation_shows_fields_as_they_stand():
    """A reference page shows a class of settings whole: each field, its option and its text."""
    page = Path(__file__).parents[2] / "docs" / "reference" / "settings.md"
    shown = page.read_text(encoding="utf-8")
    for kind in Settings.__subclasses__():
        if kind.__module__.startswith(rx.settings.__name__):
            assert f"::: riecjax.settings.{kind.__name__}\n" in shown


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_keywords_of_a_verb_are_fields(verb):
    fields = {name: option.default for name, option in VERBS[verb].options().items()}
    parameters = inspect.signature(verb).parameters
    assert {name: parameters[name].default for name in fields} == fields


def commands() -> dict[str, SettingsCommand]:
    ctx = click.Context(cli)
    named = {name: cli.get_command(ctx, name) for name in cli.list_commands(ctx)}
    return {name: one for name, one in named.items() if isinstance(one, SettingsCommand)}


EXAMPLES = {
    "number": "0.25",
    "share": "0.25",
    "integer": "3",
    "N|all": "40",
    "HZ|auto": "50",
    "SIGNAL[=HZ]": "x=12",
    "KIND:SIGNAL[=HZ]": "mode:x=12.5",
    "LOW:HIGH": "0:2.5",
    "MEAN±SD": "1.5±0.25",
    "A,B,...": "t,x",
}
OPTIONS = {option.said: option for each in commands().values() for option in each.options.values()}


def value_of(option: Option) -> object:
    """Some value that it takes."""
    if option.shape == "flag":
        return not option.default
    text = (option.kind.choices or (EXAMPLES.get(option.kind.name, "hat"),))[-1]
    texts = (f"x={text}", f"y={text}") if option.shape == "named" else (text,) * option.count
    return option.parsed(*texts)


@pytest.mark.parametrize("said", OPTIONS)
def test_a_value_is_the_same_as_words_in_a_job_and_in_python(said):
    option = OPTIONS[said]
    value = value_of(option)
    assert option.of_plain(option.plain(value)) == value
    words = option.words(value)
    if option.flag:
        assert words[0] in option.flag.split("/")
    if option.shape in ("many", "named"):
        texts = [text for (text,) in option.texts(value)]
        assert option.parsed(*texts) == value


def test_every_command_says_what_each_option_is_for():
    assert {*commands()} == {*COMMANDS, "fleet", "reproduce"}
    for name, one in commands().items():
        for field, kind in one.settings.items():
            assert kind.help(field) or not one.options[field].flag, f"{name} --{field}"


APPROVED = sorted((Path(__file__).parents[1] / "approved" / "outputs").glob("*.json"))


def test_jobs_of_results_that_are_kept_say_the_same_again():
    """Approved results, which earlier versions wrote too."""
    jobs = [json.loads(file.read_text(encoding="utf-8")).get("document") for file in APPROVED]
    jobs = [document["job"] for document in jobs if document and "job" in document]
    assert len(jobs) > 50
    both = (commands()[name].options.values() for name in ("discover", "identify"))
    options = {option.key: option for each in both for option in each}
    for job in jobs:
        for key, written in job.items():
            value = options[key].of_plain(written)
            assert options[key].of_plain(options[key].plain(value)) == value, (key, written)


@pytest.mark.parametrize(
    ("settings", "keywords", "typed"),
    [
        (
            lambda: rx.settings.Fit(band=(1.0, 2.0), alpha=0.1, beta=0.2),
            "band sets the same lengths as alpha and beta: leave out one of them.",
            "--band sets the same lengths as --alpha and --beta: leave out one of them.",
        ),
        (
            lambda: rx.settings.Refine(loss="huber"),
            "loss goes with refine='output-error'.",
            "--loss goes with --refine output-error.",
        ),
        (
            lambda: rx.settings.Assess(per_record=("k",), validate_on=[Path("b.csv")]),
            "per_record gives a parameter no value on the recordings of validate_on: use one of",
            "--per-record gives a parameter no value on the recordings of --validate: use one of",
        ),
    ],
)
def test_settings_that_contradict_are_named_as_they_were_given(settings, keywords, typed):
    with pytest.raises(Contradiction) as error:
        settings()
    assert str(error.value).startswith(keywords)
    assert error.value.typed().startswith(typed)


def test_a_keyword_that_is_none_is_answered_with_those_there_are():
    with pytest.raises(TypeError, match=r"^read_record\(\) has no keyword 'names'.*rename, scale"):
        rx.read_record("a.csv", names=("x",))  # pyright: ignore[reportCallIssue]
    with pytest.raises(TypeError, match=r"no keyword 'per_recrod'; the nearest is 'per_record'"):
        rx.identify(None, (), per_recrod=("k",))  # pyright: ignore
    with pytest.raises(TypeError, match=r"no keyword 'map'; the nearest is 'rename'"):
        rx.read_recording("a.csv", map={"x": "y"})  # pyright: ignore


@pytest.mark.parametrize("name", ["bootstrap", "sandwich", "naive"])
def test_names_stand_for_objects(name):
    from riecjax.uncertainty.intervals import intervals_of

    objects = {"bootstrap": rx.BlockBootstrap, "sandwich": rx.Sandwich, "naive": rx.Naive}
    assert isinstance(intervals_of(name), objects[name])


@pytest.mark.parametrize(
    ("kind", "settings", "words"),
    [
        (rx.settings.Fit, {"windows": 1.5}, "Write a whole number or 'all'"),
        (rx.settings.Fit, {"windows": "most"}, "windows is the text 'most'"),
        (rx.settings.Fit, {"alpha": np.ones(2)}, "alpha is a ndarray. Write a number"),
        (rx.settings.Fit, {"quadrature": 3}, None),
        (rx.settings.Read, {"columns": ("a", 1)}, "a name in columns is an int"),
        (rx.settings.Read, {"columns": "a,b"}, r"Write columns=\('a', 'b'\), a tuple"),
        (rx.settings.Read, {"delimiter": 3}, "delimiter is an int. Write it as text"),
        (rx.settings.Prepare, {"align": np.array(["x", "y"])}, "align is a ndarray"),
        (rx.settings.Prepare, {"notches": ("50",)}, "Write a number or 'auto'"),
        (rx.settings.Prepare, {"notches": (50, 0)}, "^a value of notches: 0 must be .* than zero"),
        (rx.settings.Prepare, {"every": 0}, "^every: 0 must be from 1 on"),
        (rx.settings.Refine, {"horizon": jnp.array(-1.0)}, "^horizon: -1 must be a finite number"),
        (rx.settings.Select, {"scale": {"x": np.nan}}, "^scale of 'x': nan is not a finite number"),
        (rx.settings.Select, {"time_step": np.float32(-0.5)}, "^time_step: -0.5 must be"),
        (rx.settings.Fit, {"windows": 0}, "^windows: 0 must be from 1 to 100000000"),
        (rx.settings.Validate, {"hold_out": 1.0}, "^hold_out: 1 must lie between 0 and 1"),
        (rx.settings.Discover, {"least": 0.0}, "^least: 0 must lie between 0 and 1"),
        (rx.settings.Validate, {"sweep": 1}, "Write sweep=False"),
        (
            rx.settings.Fit,
            {"band": (1.0, 2.0, 3.0)},
            r"^band has 3 values. Write band=\(1.0, 10.0\)",
        ),
        (
            rx.settings.Constrained,
            {"bounds": {"k": 3}},
            r"^bounds of 'k' is an int. Write \(0.0, None\)",
        ),
        (rx.settings.Elements, {"modes": ["dy"]}, r"the text 'dy'. Write \('x', None\)"),
        (rx.settings.Seed, {"seed": np.int64(2**62)}, None),
        (rx.settings.Fit, {"windows": np.int64(100), "band": np.array([1.0, 9.0])}, None),
        (rx.settings.Validate, {"sweep": np.bool_(True)}, None),
    ],
)
def test_values_of_python_are_checked_where_they_are_given(kind, settings, words):
    if words is None:
        kind(**settings)
        return
    with pytest.raises(rx.RiecjaxError, match=words):
        kind(**settings)


def test_a_traced_number_has_no_size():
    traced = jax.jit(lambda value: rx.settings.Known(known={"m": value}).known["m"] / value)
    assert traced(jnp.array(2.0)) == 1.0


def of_job(text: str, *typed: str, folder: str = "") -> Given:
    file = Path(folder, "job.toml")
    file.write_text(f"model = 'emps'\nrecords = ['a.csv']\n{text}")
    return given_to(commands()["identify"], "--job", str(file), *typed)


def test_a_job_of_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("jobs").mkdir()
    Path("out").write_text("in the way, but not of the job's folder")
    given = of_job("per-record = ['offset']\nout = 'out'\ncolumns = []\n", folder="jobs")
    assert (given.per_record, given.columns) == (("offset",), ())
    assert given.out == Path("jobs/out")


def test_what_stands_for_settings_of_a_job_takes_their_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = of_job("band = [1, 10]", "--alpha", "0.1")
    assert (given.band, given.alpha) == ((1.0, 10.0), 0.1)
    given = of_job("band = [1, 10]", "--alpha", "0.1", "--beta", "0.5")
    assert (given.band, given.alpha, given.beta) == (None, 0.1, 0.5)
    given = of_job("alpha = 0.1\nbeta = 0.2", "--band", "1", "10")
    assert (given.band, given.alpha, given.beta) == ((1.0, 10.0), None, None)


def test_names_of_a_job_are_taken_whole(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = of_job("unit = {'a=b' = 'mm'}\ncolumns = ['a', 'b,c']")
    assert (given.units, given.columns) == ({"a=b": "mm"}, ("a", "b,c"))
    assert given.shown()["unit"] == {"a=b": "mm"}


def test_arguments_that_look_like_options_stand_last():
    given = given_to(commands()["identify"], "--model", "emps", "--", "-d.csv")
    proposed = given.with_options(["--seed", "3"])
    assert proposed == ["identify", "--model", "emps", "--seed", "3", "--", "-d.csv"]
    assert given_to(commands()["identify"], *proposed[1:]).files == (Path("-d.csv"),)


def test_what_says_nothing():
    assert rx.settings.Prepare(offsets=None, every=None) == rx.settings.Prepare()  # pyright: ignore
    assert rx.settings.Fit(criterion=None).criterion is None
    with pytest.raises(ValueError, match="'nan' is no end of a range"):
        OPTIONS["--bound NAME=LOW:HIGH"].parsed("k=nan:2")


def test_a_job_may_ask_for_one_document(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("job.toml").write_text("model = 'emps'\nrecords = ['a.csv']\njson = true\n")
    assert run(["identify", "--job", "job.toml"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "data"
    assert run(["identify", "--job", "gone.toml"]) == 2
    assert capsys.readouterr().err.endswith("See 'riecjax identify --help'.\n")


def test_elements_by_their_kind():
    model, elements = rx.find_model("drag-oscillator"), rx.settings.Elements
    zero = with_asked(model, elements(added=[("zero", "u", None)]))
    assert zero.parameters == model.with_elements(rx.elements.SensorZero("u")).parameters
    with pytest.raises(
        rx.ModelError, match="no element 'absent'; there are: mode, spring, backlash"
    ):
        with_asked(model, elements(added=[("absent", "u", None)]))
    with pytest.raises(rx.ModelError, match="zero:u is near nothing: leave out =3"):
        with_asked(model, elements(added=[("zero", "u", 3.0)]))
