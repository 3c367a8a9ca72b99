"""A wheel in an empty environment, with the oldest versions that it asks for, and the newest."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DEVELOPERS = ("pytest", "ruff", "pyright", "mkdocs", "hypothesis", "beartype", "nbclient")


def called(*command: object) -> str:
    """What a command prints; its errors are shown where it fails."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def oldest() -> str:
    """Constraints that take of each dependency the oldest release that is allowed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found = [re.fullmatch(r"([\w-]+)>=([\d.]+)", one) for one in project["dependencies"]]
    assert all(found), "a dependency is not of the form name>=version"
    return "".join(f"{one[1]}=={one[2]}.*\n" for one in found if one is not None)


@pytest.mark.slow
@pytest.mark.parametrize("versions", ["oldest", "newest"])
def test_a_wheel_identifies_in_an_empty_environment(tmp_path, versions):
    called(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", tmp_path, ROOT)
    (wheel,) = tmp_path.glob("riecjax-*.whl")
    called(sys.executable, "-m", "venv", tmp_path / "env")
    python, riecjax = (tmp_path / "env" / "bin" / name for name in ("python", "riecjax"))
    constraints = tmp_path / "constraints.txt"
    constraints.write_text(oldest() if versions == "oldest" else "")
    called(python, "-m", "pip", "install", "-q", "-c", constraints, wheel)
    installed = called(python, "-m", "pip", "list").lower()
    assert not [name for name in DEVELOPERS if name in installed]
    drive = tmp_path / "drive.csv"
    source = ("quarter-car-source", "--input", "white-noise", "--seed", "1", "--duration", "20")
    called(riecjax, "simulate", *source, "--out", drive)
    found = called(riecjax, "identify", drive, "--model", "quarter-car")
    assert re.search(r"^M_s +30[0-5]", found, flags=re.MULTILINE)
    assert "do not use" in found
