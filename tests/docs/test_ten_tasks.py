"""The ten tasks' code runs as it stands, and prints what it says."""

import re
import shlex
from pathlib import Path

import pytest

from riecjax.cli.main import run

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "ten_tasks.md"
BLOCKS = re.findall(r"```(console|python)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
def test_the_code_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    names = {}
    for kind, code in BLOCKS:
        if kind == "console":
            assert run(shlex.split(code)[1:]) == 0
        else:
            capsys.readouterr()
            exec(compile(code, PAGE.name, "exec"), names)
            printed = capsys.readouterr().out
            for promised in re.findall(r"^print\(.*\)  # (.*)$", code, flags=re.MULTILINE):
                assert promised in printed
