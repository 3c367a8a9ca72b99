"""The README prints what the program prints, and its code runs."""

import re
import shlex
from pathlib import Path

import pytest

from riecjax.cli.main import run

TEXT = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", TEXT, flags=re.DOTALL)


def lines(text: str) -> list[str]:
    return [line.rstrip() for line in text.strip().splitlines()]


@pytest.mark.slow
def test_commands_print_what_the_readme_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    printed = None
    compared = 0
    for kind, block in BLOCKS:
        if kind == "python":
            exec(compile(block, "README.md", "exec"), {})
            assert re.search(r"^K_s +207\d\d\.?\d* ", capsys.readouterr().out, flags=re.MULTILINE)
        elif "riecjax" in block.split()[0]:
            for command in block.splitlines():
                capsys.readouterr()
                assert run(shlex.split(command)[1:]) == 0
            printed = capsys.readouterr().out
        elif printed:
            assert lines(printed) == lines(block)
            compared += 1
    assert compared == 2
