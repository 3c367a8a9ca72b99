"""The command line, called in this process."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from tests.approved import inputs

from riecjax.cli.main import run


class Result(NamedTuple):
    status: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        return json.loads(self.out)


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> Result:
    capsys.readouterr()
    status = run([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return Result(status, captured.out, captured.err)


def snapshot(folder: Path) -> dict[str, bytes | None]:
    """Everything in a folder, hidden files too; Python's own byte code does not count."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
        if "__pycache__" not in path.parts
    }


def rejected(capsys: pytest.CaptureFixture[str], status: int, *arguments: object) -> str:
    """The one line that a wrong call prints, run in the working folder, which must not change."""
    before = snapshot(Path.cwd())
    result = call(capsys, *arguments)
    assert result.status == status, result.err
    assert result.out == ""
    assert result.err.startswith("riecjax: ")
    assert result.err.endswith("\n")
    assert result.err.count("\n") == 1
    assert snapshot(Path.cwd()) == before
    return result.err


def write_csv(path: Path, columns: Mapping[str, np.ndarray]) -> Path:
    """To the last bit."""
    inputs.write_csv(path, columns, "%.17g")
    return path


def quarter_car_columns(sample_count: int = 400) -> dict[str, np.ndarray]:
    """Random motion at 200 Hz that a quarter car of simple numbers obeys, as columns of a file."""
    rng = np.random.default_rng(5)
    time = np.arange(sample_count) / 200

    def smooth(amplitude: float) -> np.ndarray:
        waves = [np.sin(f * time + rng.uniform(0, 6)) for f in rng.uniform(2, 60, 12)]
        return amplitude * np.sum(waves, axis=0)

    signals = {"x1": smooth(1e-3), "x2": smooth(1e-2), "x3": smooth(0.3), "x4": smooth(0.1)}
    force = 180e3 * signals["x1"]
    return {"t": time, **signals, "F_t": force, "dx3": smooth(10), "dx4": smooth(3)}
