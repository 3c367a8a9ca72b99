"""Measured files that their authors published, against SciPy and NumPy as independent readers.

They are not part of the repository: the folder is `RIECJAX_DATA`.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import scipy.io

from benchmarks.zoo.case import Case, Truth

ROOT = Path(os.environ.get("RIECJAX_DATA", Path(__file__).parents[3] / "shared" / "data"))


def measured() -> Iterator[tuple[Path, Case]]:
    """Every file that is there, with how it is read."""
    drone = {"t": "Tempo_s", "x": "Saida_y", "u": "Controle_u"}
    for file in sorted(ROOT.glob("quarter_drone/*.csv")):
        yield file, _case(file, _table(drone), drone, step=0.01)
    damper = {"t": "tout", "x": "x_F[0]", "u": "x_F[2]"}
    # Its matrix is in mm, mm/s and N, which no file says.
    for file in sorted(ROOT.glob("mr_damper_labcontrol/*.mat")):
        yield (
            file,
            _case(file, lambda f: _columns(f, 0, 2), damper, "--scale", "x=0.001", step=0.01),
        )
    for file in sorted(ROOT.glob("silverbox/*.mat")):
        rename = {"u": "V1", "x": "V2"}
        yield (
            file,
            _case(file, _vectors(rename), rename, "--time-step", "0.0016384", step=0.0016384),
        )
    for file in sorted(ROOT.glob("emps/*.mat")):
        rename = {"x": "qm", "u": "vir"}
        yield file, _case(file, _vectors(rename), rename, step=0.001)
    for file in sorted(ROOT.glob("pendulum_single/*.mat")):
        yield file, _pendulum(file)


def _case(
    file: Path,
    truth: Callable[[Path], Truth],
    rename: dict[str, str],
    *options: str,
    step: float = 1.0,
    refused: str = "",
) -> Case:
    name, source = file.stem, file.parent.name
    return Case(name, source, truth, file.suffix, rename, options, step, 1e-6, refused, "")


def _table(rename: dict[str, str]) -> Callable[[Path], Truth]:
    def truth(file: Path) -> Truth:
        table = np.genfromtxt(file, delimiter=",", names=True)
        return {name: table[column] for name, column in rename.items() if name != "t"}

    return truth


def _vectors(rename: dict[str, str]) -> Callable[[Path], Truth]:
    def truth(file: Path) -> Truth:
        content = scipy.io.loadmat(file)
        return {name: content[column].ravel() for name, column in rename.items()}

    return truth


def _columns(file: Path, x: int, u: int) -> Truth:
    matrix = scipy.io.loadmat(file)["x_F"]
    return {"x": 1e-3 * matrix[:, x], "u": matrix[:, u]}


def _pendulum(file: Path) -> Case:
    if "Estimated" in file.name:
        return _case(file, lambda _: {}, {}, refused="no time column")
    if "ForParameterEstimation" in file.name:
        rename = {"t": "Time_id{1}", "x": "Y_id{1}[0]"}
        first: Callable[[Path], Truth] = lambda f: {"x": scipy.io.loadmat(f)["Y_id"][0, 0][0]}  # noqa: E731
        return _case(file, first, rename, step=0.001)
    swing: Callable[[Path], Truth] = lambda f: {  # noqa: E731
        "x": scipy.io.loadmat(f)["Theta1"]["signals"][0, 0]["values"][0, 0].ravel()
    }
    return _case(file, swing, {"x": "Theta1.signals.values"}, step=0.0001)
