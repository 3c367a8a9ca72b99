"""The ten tasks' code runs as it stands, and its table counts the lines that it has."""

import re
import shlex

import pytest
from benchmarks.speed.ten_tasks import PAGE, tasks

from riecjax.cli.main import run

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_table_counts_the_lines_of_each_task():
    rows = re.findall(r"^\| \[([^]]+)\]\([^)]*\) \| (\d+) \| ", TEXT, flags=re.MULTILINE)
    assert rows == [(task.title, str(task.lines)) for task in tasks()][1:]
    assert len(rows) == 10


@pytest.mark.slow
def test_the_code_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    names = {}
    for task in tasks():
        for kind, code in task.blocks:
            if kind == "console":
                assert run(shlex.split(code)[1:]) == 0
            else:
                capsys.readouterr()
                exec(compile(code, task.title, "exec"), names)
                printed = capsys.readouterr().out
                for promised in re.findall(r"^print\(.*\)  # (.*)$", code, flags=re.MULTILINE):
                    assert promised in printed
