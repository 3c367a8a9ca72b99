"""What other distributions add takes part without a change here, and the core loads none of it."""

import importlib
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import numpy as np
import pytest
from tests.machines import DRAG

import riecjax as rx
from nightly import nightly
from riecjax.cli.main import ORDER, run
from riecjax.elements.catalogue import element_class
from riecjax.errors import DataError, ModelError
from riecjax.extensions import NEEDS, ExtensionError, extension, require_packages
from riecjax.records.reading import endings, read_channels

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]

FOREIGN = """
import click
import numpy as np
from riecjax.records.reading import Channels, apart

@apart("XYZ")
def read(file, decimal=None):
    text = file.read_text().replace(decimal or ".", ".")
    rows = np.array([line.split() for line in text.splitlines()], float)
    return Channels({"t": rows[:, 0], "x": rows[:, 1]}, {"x": "mm"})

@click.command("greet", short_help="Greet somebody.")
@click.argument("name")
def greet(name):
    click.echo(f"Hello {name}")

def backlash():
    pass

NUMBER = 3

def read_rows(file):
    return [[1.0, 2.0]]

def read_wrongly(file):
    raise KeyError("two\\nlines")

def read_lists(file):
    return Channels({"t": [0.0, 1.0]})

def read_and_exit(file):
    raise SystemExit(3)
"""
READERS = {"xyz": "read", "rows": "read_rows", "wrong": "read_wrongly", "npz": "read", "h5": "read",
           "lost": "nobody", "lists": "read_lists", "exit": "read_and_exit"}  # fmt: skip
COMMANDS_TOO = {"greet": "greet", "number": "backlash", "models": "greet", "fleet": "greet"}


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a distribution of one module with entry points, for this process."""

    def installed(module: str, code: str, **groups: dict[str, str]) -> None:
        place = tmp_path / module
        about = place / f"{module}-1.0.dist-info"
        about.mkdir(parents=True)
        (place / f"{module}.py").write_text(code)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        lines = []
        for group, names in groups.items():
            lines.append(f"[riecjax.{group}]")
            lines += [f"{name} = {module}:{target}" for name, target in names.items()]
        (about / "entry_points.txt").write_text("\n".join(lines))
        monkeypatch.syspath_prepend(place)
        monkeypatch.delitem(sys.modules, module, raising=False)

    return installed


@pytest.fixture
def foreign(install):
    install("foreign", FOREIGN, readers=READERS, commands=COMMANDS_TOO)


def test_a_foreign_reader_takes_part(foreign, tmp_path):
    time = 0.1 * np.arange(50)
    rows = "\n".join(f"{t:.1f} {x:.17g}" for t, x in zip(time, np.sin(time)))
    (tmp_path / "a.xyz").write_text(rows.replace(".", ","))
    record = rx.read_recording(tmp_path / "a.xyz", decimal=",").record
    np.testing.assert_allclose(record["x"], 1e-3 * np.sin(time), rtol=1e-15)
    assert endings()[-1] == ".xyz"
    with pytest.raises(DataError, match=r"^a\.xyz: 'delimiter' is for text files\.$"):
        read_channels(tmp_path / "a.xyz", delimiter=";")
    (tmp_path / "a.xyz").write_text("1 2\n3")
    with pytest.raises(DataError, match=r"^a\.xyz: not a readable XYZ file: "):
        read_channels(tmp_path / "a.xyz")


def test_foreign_commands_take_part(foreign, capfd):
    assert run(["greet", "Ada"]) == 0
    assert capfd.readouterr() == ("Hello Ada\n", "")
    assert run(["--help"]) == 0
    listed = re.findall(r"^  ([a-z]+)  ", capfd.readouterr().out, flags=re.MULTILINE)
    assert listed == [*ORDER, "greet", "number"]


def test_the_core_and_its_own_distribution_come_before_foreign_ones(foreign, tmp_path, capfd):
    np.savez(tmp_path / "a.npz", t=0.1 * np.arange(9), x=np.arange(9.0))
    assert {*read_channels(tmp_path / "a.npz").columns} == {"t", "x"}
    assert run(["models", "duffing"]) == 0
    assert "Hello" not in capfd.readouterr().out
    reader, command = extension("readers", "h5"), extension("commands", "fleet")
    assert reader is not None
    assert reader.__module__ == "riecjax.readers.hdf5"
    assert isinstance(command, click.Command)
    assert command.name == "fleet"


def test_the_example_of_the_documentation_takes_part(install, tmp_path, capfd):
    page = (Path(__file__).parents[1] / "docs/reference/extensions.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert '[project.entry-points."riecjax.readers"]\nrig = "bench_rig:read_rig"\n' in page
    install("bench_rig", code, readers={"rig": "read_rig"}, commands={"noise": "noise"})
    record = DRAG.record(0.0, 1)
    rows = np.column_stack([record.time, 1e3 * record["x"], record["u"]])
    np.savetxt(tmp_path / "a.rig", rows)
    rig = (str(tmp_path / "a.rig"), "--model", "drag-oscillator")
    assert run(["identify", *rig, "--refine", "none", "--no-sweep", "--json"]) == 0
    stiffness = json.loads(capfd.readouterr().out)["parameters"]["k"]
    assert stiffness["value"] == pytest.approx(DRAG.truth["k"], rel=0.01)
    assert run(["noise", *rig]) == 0
    assert capfd.readouterr().out.startswith("a.rig  x  ")


def test_what_two_foreign_distributions_offer_is_refused_with_both_names(foreign, install):
    install("second", FOREIGN, readers={"xyz": "read"})
    with pytest.raises(ExtensionError, match=r"'xyz' .* by foreign and by second: uninstall all "):
        extension("readers", "xyz")


BROKEN = {
    "a.lost": r"'lost' of riecjax\.readers cannot be loaded from foreign:nobody: .*\. Update or "
    r"uninstall foreign\.",
    "a.rows": r"a\.rows: what its reader returned is a list\. Write a reader that returns "
    r"Channels\.",
    "a.wrong": r"a\.wrong: its reader failed: KeyError 'two\\nlines'",
    "a.lists": r"a\.lists: its reader gave column 't' as list, not as a vector of 64-bit floats\.",
    "a.exit": r"a\.exit: its reader failed: SystemExit 3",
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_reader_is_one_line(foreign, tmp_path, name):
    (tmp_path / name).write_text("1 2\n")
    with pytest.raises(rx.RiecjaxError, match=f"^{BROKEN[name]}$"):
        read_channels(tmp_path / name)


def test_a_broken_command_is_one_line_and_leaves_the_others_alone(foreign, install, capfd):
    install("broken", "raise SystemExit('no\\nlicence')", commands={"crash": "command"})
    for arguments in (["crash", "--help"], ["crash", "a", "--json"], ["number"]):
        assert run(arguments) == 1
        out, err = capfd.readouterr()
        assert re.fullmatch(r"riecjax: .*'(crash|number)'.*\.\n", err)
        if "--json" in arguments:
            assert json.loads(out)["error"]["code"] == "extension"
    assert run(["--help"]) == 0
    shown = " ".join(capfd.readouterr().out.split())
    assert "cannot be loaded from broken:command: SystemExit: no licence. Update or" in shown


def test_a_list_of_installed_packages_that_is_damaged_is_one_line(install, tmp_path):
    install("damaged", "", readers={"abc": "read"})
    (tmp_path / "damaged" / "damaged-1.0.dist-info" / "entry_points.txt").write_text("[a]\nb\n")
    with pytest.raises(ExtensionError, match=r"what is installed beside riecjax cannot be listed"):
        extension("readers", "abc")


@pytest.mark.parametrize("group", ["commands", "readers"])
def test_what_this_distribution_declares_is_there(group):
    for declared in PROJECT["entry-points"][f"riecjax.{group}"].values():
        module, _, target = declared.partition(":")
        found = getattr(importlib.import_module(module), target)
        assert isinstance(found, click.Command) if group == "commands" else callable(found)


@pytest.mark.parametrize("use", NEEDS)
def test_a_missing_package_is_named_with_the_extra_that_installs_it(use, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(DataError) as refused:
        require_packages(use)
    said = re.fullmatch(
        r"\S.* needs? ([\w, ]+); install (?:it|them) by pip install \"riecjax\[(\w+)\]\"\.",
        str(refused.value),
    )
    assert said is not None
    extra = {re.split(">=", one)[0] for one in PROJECT["optional-dependencies"][said[2]]}
    assert {name.replace("_", "-") for name in said[1].split(", ")} <= extra


ELSEWHERE = {"dask", "distributed", "h5py", "jinja2", "matplotlib", "pandas", "plotly", "ruptures",
             "statsmodels", "xarray"}  # fmt: skip
LOADED = """
import sys
from riecjax.cli.main import run
import riecjax
assert run({arguments!r}) == 0
print(*sys.modules, file=sys.stderr)
"""
MOST_MODULES = [
    (("--version",), 11),
    *nightly([(("identify", "a.csv", "--model", "duffing"), 152)]),
]
"""Command lines, and how many modules of this package they load at the most."""


LIGHT = [("models",), ("models", "--json"), ("--version",), *((c, "--help") for c in ORDER)]


def loaded_by(folder: Path, *arguments: str) -> list[str]:
    """Modules that a command line loads."""
    command = [sys.executable, "-c", LOADED.format(arguments=arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (line,) = done.stderr.splitlines()
    assert done.stdout
    return line.split()


@pytest.mark.parametrize("arguments", LIGHT, ids=" ".join)
def test_listing_and_help_load_no_jax(tmp_path, arguments):
    assert not {"jax", "equinox", "scipy", "matplotlib"} & {*loaded_by(tmp_path, *arguments)}


@pytest.mark.parametrize(("arguments", "most"), MOST_MODULES)
def test_the_core_loads_neither_what_is_around_it_nor_what_that_needs(tmp_path, arguments, most):
    time = 0.01 * np.arange(2000)
    y, ddy = (a * np.sin(3 * time) + b * np.sin(7 * time) for a, b in ((1, 1), (-9, -49)))
    signals = {"t": time, "y": y, "ddy": ddy, "u": ddy + 20 * y + 5 * y**3}
    rows = np.column_stack(list(signals.values()))
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=",".join(signals), comments="")
    loaded = loaded_by(tmp_path, *arguments)
    ours = [name.split(".") for name in loaded if name.split(".")[0] == "riecjax"]
    around = {"fleets", "paper", "readers", "studies"}
    assert not [name for name in ours if around & {*name[1:2]}]
    assert not ELSEWHERE & {name.split(".")[0] for name in loaded}
    assert len(ours) <= most


def test_a_foreign_element_takes_part(install):
    source = (Path(__file__).parent / "elements" / "inerter.py").read_text()
    install("inerters", source + "\nNUMBER = 3\n", elements={"inerter": "Inerter", "n": "NUMBER"})
    found = element_class("inerter")
    assert found.at("v1-v2").described == "an inerter between v1 and v2"
    with pytest.raises(ExtensionError, match="cannot be loaded"):
        element_class("n")
    with pytest.raises(ModelError, match="mode, spring, backlash, zero, gain, inerter"):
        element_class("nowhere")
