"""Recordings and models that the cases read, made alike on every machine.

Motion is a sum of sines and the force follows from the equation of motion, so that nothing but
NumPy's own arithmetic decides a sample; what no closed form has is left to SciPy.
"""

import contextlib
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.signal

SHARED = Path(__file__).parents[3] / "shared"
DATA = Path(os.environ.get("RIECJAX_DATA", SHARED / "data"))
Columns = dict[str, np.ndarray]
INPUTS: dict[str, Callable[[Path], None]] = {}
"""What writes each file into a folder, by its name."""


def made(*names: str) -> Callable[[Callable[[Path], None]], Callable[[Path], None]]:
    """Register what writes these files."""

    def register(write: Callable[[Path], None]) -> Callable[[Path], None]:
        INPUTS.update(dict.fromkeys(names, write))
        return write

    return register


def write_csv(path: Path, columns: Mapping[str, np.ndarray], form: str = "%.9g") -> None:
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt=form,
    )


def sines(
    seed: int, count: int, step: float, low: float = 0.2, high: float = 4.0, rms: float = 0.1
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, and a motion of nine sines with its exact velocity and acceleration."""
    rng = np.random.default_rng(seed)
    t = step * np.arange(count)
    rates = 2 * np.pi * np.geomspace(low, high, 9)[:, None] * rng.uniform(0.9, 1.1, (9, 1))
    angles = rates * t + rng.uniform(0, 2 * np.pi, (9, 1))
    size = rms * np.sqrt(2 / 9)
    x, dx = size * np.sin(angles).sum(0), size * (rates * np.cos(angles)).sum(0)
    return t, x, dx, -size * (rates**2 * np.sin(angles)).sum(0)


def noisy(columns: Columns, share: float, seed: int) -> Columns:
    """White noise of a share of each signal's deviation, but for the time."""
    rng = np.random.default_rng(seed)
    return {
        name: x if name == "t" else x + share * x.std() * rng.standard_normal(x.size)
        for name, x in columns.items()
    }


def drag(seed: int = 1, count: int = 3000, step: float = 0.01, **other: float) -> Columns:
    """m x'' + r x' + r2 x'|x'| + k x = u."""
    value = {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0} | other
    t, x, dx, ddx = sines(seed, count, step)
    u = value["m"] * ddx + value["r"] * dx + value["r2"] * dx * abs(dx) + value["k"] * x
    return {"t": t, "x": x, "dx": dx, "u": u}


@made("drag.csv")
def _(folder: Path) -> None:
    write_csv(folder / "drag.csv", noisy(drag(), 0.005, 1))


@made("drag_exact.csv")
def _(folder: Path) -> None:
    write_csv(folder / "drag_exact.csv", drag(), "%.15g")


@made("drag_acceleration.csv")
def _(folder: Path) -> None:
    columns = drag()
    columns["ddx"] = sines(1, 3000, 0.01)[3]
    write_csv(folder / "drag_acceleration.csv", noisy(columns, 0.005, 1))


@made("drag_position.csv")
def _(folder: Path) -> None:
    columns = noisy(drag(), 0.002, 2)
    write_csv(folder / "drag_position.csv", {name: columns[name] for name in ("t", "x", "u")})


@made("drag_late.csv")
def _(folder: Path) -> None:
    """The velocity comes three samples late."""
    columns = drag(count=3003)
    late = {name: x[3:] for name, x in columns.items()} | {"dx": columns["dx"][:-3]}
    late["t"] = columns["t"][:-3]
    write_csv(folder / "drag_late.csv", noisy(late, 0.005, 3))


@made("drag_faults.csv")
def _(folder: Path) -> None:
    """A spike, a stuck second of the velocity, a gap, hum, a clipped force."""
    columns = noisy(drag(), 0.005, 4)
    columns["x"][700] += 2.0
    columns["dx"][1200:1300] = columns["dx"][1200]
    columns["u"] += 0.4 * np.sin(2 * np.pi * 49.0 * columns["t"])
    columns["u"] = np.clip(columns["u"], -0.9 * columns["u"].max(), 0.75 * columns["u"].max())
    columns["x"][2000:2005] = np.nan
    write_csv(folder / "drag_faults.csv", columns)


@made("drag_bias.csv")
def _(folder: Path) -> None:
    """The force's sensor has a zero of 2 N, and the position's reads 0.8 of what is."""
    columns = noisy(drag(), 0.005, 5)
    write_csv(
        folder / "drag_bias.csv", columns | {"u": columns["u"] + 2.0, "x": 0.8 * columns["x"]}
    )


@made("drag_filtered.csv")
def _(folder: Path) -> None:
    """The velocity behind a low-pass of 0.03 s, the force's clock 300 millionths slow."""
    columns = noisy(drag(), 0.002, 6)
    pole = np.exp(-0.01 / 0.03)
    columns["dx"] = scipy.signal.lfilter([1 - pole], [1, -pole], columns["dx"])
    columns["u"] = np.interp(columns["t"] * (1 - 3e-4), columns["t"], columns["u"])
    write_csv(folder / "drag_filtered.csv", columns)


@made("run1.csv", "run2.csv", "run3.csv")
def _(folder: Path) -> None:
    for i, stiffness in enumerate((20.0, 20.0, 23.0)):
        columns = noisy(drag(seed=11 + i, count=2000, k=stiffness), 0.005, 11 + i)
        write_csv(folder / f"run{i + 1}.csv", columns)


@made("drives")
def _(folder: Path) -> None:
    """Recordings of four vehicles, one of which has a worn damper, and a broken one."""
    for vehicle in range(4):
        place = folder / "drives" / f"vehicle={vehicle}"
        place.mkdir(parents=True)
        worn = {"r": 0.4, "r2": 0.25} if vehicle == 3 else {}
        for i in range(2):
            seed = 20 + 2 * vehicle + i
            write_csv(place / f"{i}.csv", noisy(drag(seed, 1500, **worn), 0.005, seed))
    (folder / "drives" / "vehicle=0" / "broken.csv").write_text("t,x\n")


@made("drag.toml")
def _(folder: Path) -> None:
    (folder / "drag.toml").write_text(
        'model = "drag-oscillator"\nrecords = ["drag.csv"]\nband = [0.3, 4.0]\nset = {k = 20.0}\n'
        'refine = "none"\n'
    )


@made("duffing.csv")
def _(folder: Path) -> None:
    t, y, dy, ddy = sines(31, 3000, 0.005, 0.5, 8.0, 0.4)
    u = 0.02 * ddy + 0.3 * dy + 30 * y + 4 * y**2 + 50 * y**3
    write_csv(folder / "duffing.csv", noisy({"t": t, "y": y, "dy": dy, "u": u}, 0.003, 31))


@made("emps.csv")
def _(folder: Path) -> None:
    t, q, dq, ddq = sines(41, 4000, 0.005, 0.1, 3.0, 0.1)
    force = 95 * ddq + 200 * dq + 20 * np.sign(dq) - 3
    columns = noisy({"t": t, "q": q, "dq": dq, "force": force}, 0.002, 41)
    write_csv(folder / "emps.csv", columns)
    write_csv(folder / "axis.csv", {name: columns[name] for name in ("t", "q", "force")})


INPUTS["axis.csv"] = INPUTS["emps.csv"]


@made("swing.csv")
def _(folder: Path) -> None:
    """A pendulum that swings freely."""
    t = 0.005 * np.arange(4000)
    run = scipy.integrate.solve_ivp(
        lambda _, s: [s[1], 40 * np.sin(s[0]) - 0.15 * s[1]],
        (0, t[-1]),
        [np.pi - 2.0, 0.0],
        "DOP853",
        t,
        rtol=1e-10,
        atol=1e-12,
    )
    columns = {"t": t, "theta": run.y[0], "dtheta": run.y[1]}
    write_csv(folder / "swing.csv", noisy(columns, 0.002, 51))


def _driven(a: np.ndarray, mass: float, count: int, seed: int, size: float) -> Columns:
    """Position, velocity and force of the first body of a linear machine, at 200 Hz."""
    b = np.zeros((len(a), 1))
    b[1] = 1 / mass
    finer, step = 8, 0.005
    sharp = scipy.signal.butter(6, 40.0, fs=finer / step, output="sos")
    draws = np.random.default_rng(seed).standard_normal(count * finer)
    force = size * np.asarray(scipy.signal.sosfilt(sharp, draws))
    t = np.arange(force.size) * step / finer
    _, states, _ = scipy.signal.lsim((a, b, np.eye(len(a)), np.zeros_like(b)), force, t)
    x, v = states[::finer, :2].T
    return {"t": t[::finer], "x": x, "v": v, "F": force[::finer]}


@made("two_mass.csv")
def _(folder: Path) -> None:
    heavy, light, rate, damping = 10.0, 1.0, 40.0, 0.2
    mean = heavy * light / (heavy + light)
    stiff, loss = mean * rate**2, 2 * damping * mean * rate
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1
    a[1] = np.array([-stiff, -loss, stiff, loss]) / heavy
    a[3] = np.array([stiff, loss, -stiff, -loss]) / light
    columns = _driven(a, heavy, 4000, 61, 100)
    renamed = {"t": columns["t"], "z": columns["x"], "dz": columns["v"], "F": columns["F"]}
    write_csv(folder / "two_mass.csv", noisy(renamed, 0.001, 61))


@made("mode.csv")
def _(folder: Path) -> None:
    """A body on a spring and a damper, with an oscillator of 9.4 Hz on it."""
    m, c, k, heavy, stiff, loss = 20.0, 60.0, 4000.0, 6.0, 21000.0, 120.0
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1
    a[1] = np.array([-(k + stiff), -(c + loss), stiff, loss]) / m
    a[3] = np.array([stiff, loss, -stiff, -loss]) / heavy
    write_csv(folder / "mode.csv", noisy(_driven(a, m, 6000, 3, 300), 1e-4, 71))


@made("body.csv")
def _(folder: Path) -> None:
    """A body on a spring and a damper, of which the model leaves out nothing."""
    a = np.array([[0, 1], [-4000.0 / 20.0, -60.0 / 20.0]])
    write_csv(folder / "body.csv", noisy(_driven(a, 20.0, 6000, 3, 300), 3e-3, 73))


@made("spring.csv")
def _(folder: Path) -> None:
    """A body whose damper pulls through a spring."""
    m, c, k, series = 20.0, 200.0, 4000.0, 10000.0
    a = np.array([[0, 1, 0], [-k / m, 0, -1 / m], [0, series, -series / c]])
    write_csv(folder / "spring.csv", noisy(_driven(a, m, 6000, 3, 300), 1e-4, 72))


@made("body.py")
def _(folder: Path) -> None:
    (folder / "body.py").write_text(
        """import riecjax as rx

body = rx.Equation(
    rx.Term("m", "v", derivative=1, unit="kg"),
    rx.Term("c", "v", unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "F"),
    name="body",
    unit="N",
)
"""
    )


@made("cart.csv")
def _(folder: Path) -> None:
    t, p, v, a = sines(81, 3000, 0.005, 0.2, 3.0, 0.5)
    columns = {"t": t, "p": p, "v": v, "a": a, "f": 2.5 * a + 0.75 * v + 40 * p**3}
    write_csv(folder / "cart.csv", noisy(columns, 0.003, 81))


@made("cart.py")
def _(folder: Path) -> None:
    (folder / "cart.py").write_text(
        """import riecjax as rx

cart = rx.Equation(
    rx.Term("m", "v", derivative=1, measured=("a",), unit="kg"),
    rx.Term("c", "v", unit="N s/m"),
    rx.Term("k", lambda s: s["p"] ** 3, unit="N/m^3"),
    -rx.Term(1.0, "f", unit="N"),
    name="cart",
)
"""
    )


@made("arm.py")
def _(folder: Path) -> None:
    """Of the measured propeller arm."""
    (folder / "arm.py").write_text(
        """import jax.numpy as jnp
import riecjax as rx

arm = rx.Equation(
    rx.Term(1.0, "theta", derivative=2),
    -rx.Term("c1", lambda s: jnp.sin(s["theta"]), unit="1/s^2"),
    -rx.Term("c2", lambda s: s["u"] ** 2, unit="rad/s^2"),
    -rx.Term("c3", "theta", derivative=1, unit="1/s"),
    name="arm",
)
"""
    )


@made("damper.py")
def _(folder: Path) -> None:
    """Of the measured magneto-rheological damper."""
    (folder / "damper.py").write_text(
        """import riecjax as rx

damper = rx.Equation(
    rx.Term("c", "x", derivative=1, unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    rx.Term("f0", rx.constant, unit="N"),
    -rx.Term(1.0, "f"),
    name="damper",
    unit="N",
)
"""
    )


@made("rig.py")
def _(folder: Path) -> None:
    (folder / "rig.py").write_text(
        """import riecjax as rx

RIG = rx.Model(
    "rig",
    "a mass that is pushed",
    procedure=lambda: rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg"),
        -rx.Term(1.0, "u"),
        name="rig",
        unit="N",
    ),
    derived={"dx": "x"},
)
LAWS = [rx.Term("spring", "x"), rx.Term("cubic", rx.odd("x", 3)), rx.Term("dry", rx.odd("dx", 0))]
"""
    )


@made("rig.csv")
def _(folder: Path) -> None:
    t, x, dx, ddx = sines(91, 3000, 0.01, 0.2, 3.0, 0.5)
    u = 2 * ddx + 1.2 * dx + 30 * x + 25 * x**3 + 1.5 * np.sign(dx)
    write_csv(folder / "rig.csv", noisy({"t": t, "x": x, "dx": dx, "u": u}, 0.003, 91))


@made("drive.csv")
def _(folder: Path) -> None:
    """The source model of the paper on a road, as the README has it but shorter."""
    simulate(folder / "drive.csv", "--seed 4 --duration 20")


def simulate(path: Path, options: str) -> None:
    from riecjax.cli.main import run

    model = "simulate quarter-car-source --input white-noise"
    with contextlib.redirect_stdout(None):
        status = run([*model.split(), *options.split(), "--out", str(path)])
    if status:
        raise RuntimeError(f"{path.name} could not be simulated")


@made("broken.csv")
def _(folder: Path) -> None:
    (folder / "broken.csv").write_text("t,x,u\n0,1,2\n0.01,1\n0.02,nonsense,3\n")


@made("empty.csv")
def _(folder: Path) -> None:
    (folder / "empty.csv").write_text("")


@made("still.csv")
def _(folder: Path) -> None:
    """A force acts and nothing moves."""
    columns = drag(count=500)
    rest = np.zeros(500)
    write_csv(folder / "still.csv", columns | {"x": rest, "dx": rest})


@made("wrong.py")
def _(folder: Path) -> None:
    (folder / "wrong.py").write_text("import no_such_module\n")


def place(words: list[str], beside: str, folder: Path, store: Path) -> None:
    """Put the files that a command line names into its folder; each is made once, in the store.

    Of `cases/NAME` or `data/NAME`, folders beside the project, all files; the test is skipped, with
    the reason, where they are absent.
    """
    if beside:
        kind, _, name = beside.partition("/")
        source = (SHARED / kind if kind == "cases" else DATA) / name
        if not source.is_dir():
            pytest.skip(f"'{beside}' is not beside the project (RIECJAX_DATA: measured data)")
        for file in filter(Path.is_file, source.iterdir()):
            (folder / file.name).write_bytes(file.read_bytes())
    for word in words:
        name = word.split("=")[-1].split(":")[0]
        if name not in INPUTS or (folder / name).exists():
            continue
        if not (store / name).exists():
            INPUTS[name](store)
        (shutil.copytree if (store / name).is_dir() else shutil.copy)(store / name, folder / name)
