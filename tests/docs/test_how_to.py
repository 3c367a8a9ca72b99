"""The how-to's commands run as they stand, and print what it says they print."""

import re
import shlex
from pathlib import Path

import pytest

from riecjax.cli.main import run

PAGE = (Path(__file__).parents[2] / "docs" / "your_recording.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", PAGE, flags=re.DOTALL)


def words(text: str) -> list[str]:
    """What a table says, without its layout: numbers rounded to three digits."""
    found = []
    for word in text.split():
        try:
            found.append(f"{float(word):.3g}")
        except ValueError:
            found.append(word)
    return found


@pytest.mark.slow
def test_commands_print_what_the_page_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    model = next(text for kind, text in BLOCKS if kind == "python")
    Path("rig.py").write_text(model)
    printed = ""
    shown = 0
    for kind, text in BLOCKS:
        if kind == "console":
            command, _, file = text.partition(" > ")
            arguments = shlex.split(command)
            assert arguments[0] == "riecjax"
            assert run(arguments[1:]) == 0
            printed = capsys.readouterr().out
            if file:
                Path(file.strip()).write_text(printed, encoding="utf-8")
        elif not kind and printed:
            kept = [line for line in printed.splitlines() if not line.startswith("wrote ")]
            assert words("\n".join(kept)) == words(text)
            shown += 1
    assert shown == 3
    assert Path("result/report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_the_python_version_says_the_same(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    python = [text for kind, text in BLOCKS if kind == "python"]
    Path("rig.py").write_text(python[0])
    first = next(text for kind, text in BLOCKS if kind == "console")
    assert run(shlex.split(first)[1:]) == 0
    capsys.readouterr()
    exec(compile(python[-1], "your_recording.md", "exec"), {})
    out = capsys.readouterr().out
    assert re.search(r"^m +1\.496", out, flags=re.MULTILINE)
    assert "predicted well (fit 89.2, 90.2 %)" in out


@pytest.mark.parametrize("name", re.findall(r"rx\.(\w+)", PAGE))
def test_every_name_on_the_page_exists(name):
    import riecjax as rx

    assert hasattr(rx, name)
