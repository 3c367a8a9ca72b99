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
from tests import machines

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


def late_drag() -> Columns:
    """The velocity comes three samples late."""
    columns = drag(count=3003)
    late = {name: x[3:] for name, x in columns.items()} | {"dx": columns["dx"][:-3]}
    late["t"] = columns["t"][:-3]
    return noisy(late, 0.005, 3)


def faulty_drag() -> Columns:
    """A spike, a stuck second of the velocity, a gap, hum, a clipped force."""
    columns = noisy(drag(), 0.005, 4)
    columns["x"][700] += 2.0
    columns["dx"][1200:1300] = columns["dx"][1200]
    columns["u"] += 0.4 * np.sin(2 * np.pi * 49.0 * columns["t"])
    columns["u"] = np.clip(columns["u"], -0.9 * columns["u"].max(), 0.75 * columns["u"].max())
    columns["x"][2000:2005] = np.nan
    return columns


def biased_drag() -> Columns:
    """The force's sensor has a zero of 2 N, and the position's reads 0.8 of what is."""
    columns = noisy(drag(), 0.005, 5)
    return columns | {"u": columns["u"] + 2.0, "x": 0.8 * columns["x"]}


def filtered_drag() -> Columns:
    """The velocity behind a low-pass of 0.03 s, the force's clock 300 millionths slow."""
    columns = noisy(drag(), 0.002, 6)
    pole = np.exp(-0.01 / 0.03)
    columns["dx"] = np.asarray(scipy.signal.lfilter([1 - pole], [1, -pole], columns["dx"]))
    columns["u"] = np.interp(columns["t"] * (1 - 3e-4), columns["t"], columns["u"])
    return columns


def run(number: int) -> Columns:
    return noisy(drag(10 + number, 2000, k=23.0 if number == 3 else 20.0), 0.005, 10 + number)


def duffing() -> Columns:
    t, y, dy, ddy = sines(31, 3000, 0.005, 0.5, 8.0, 0.4)
    u = 0.02 * ddy + 0.3 * dy + 30 * y + 4 * y**2 + 50 * y**3
    return noisy({"t": t, "y": y, "dy": dy, "u": u}, 0.003, 31)


def axis() -> Columns:
    t, q, dq, ddq = sines(41, 4000, 0.005, 0.1, 3.0, 0.1)
    force = 95 * ddq + 200 * dq + 20 * np.sign(dq) - 3
    return noisy({"t": t, "q": q, "dq": dq, "force": force}, 0.002, 41)


def swing() -> Columns:
    """A pendulum that swings freely."""
    t = 0.005 * np.arange(4000)
    motion = scipy.integrate.solve_ivp(
        lambda _, s: [s[1], 40 * np.sin(s[0]) - 0.15 * s[1]],
        (0, t[-1]),
        [np.pi - 2.0, 0.0],
        "DOP853",
        t,
        rtol=1e-10,
        atol=1e-12,
    )
    return noisy({"t": t, "theta": motion.y[0], "dtheta": motion.y[1]}, 0.002, 51)


def timed(signals: Mapping[str, np.ndarray]) -> Columns:
    """Signals of `tests.machines`, at 200 Hz."""
    return {"t": np.arange(signals["x"].size * 8)[::8] * 0.005 / 8, **signals}


def two_mass() -> Columns:
    heavy, light, rate, damping = 10.0, 1.0, 40.0, 0.2
    mean = heavy * light / (heavy + light)
    stiff, loss = mean * rate**2, 2 * damping * mean * rate
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1
    a[1] = np.array([-stiff, -loss, stiff, loss]) / heavy
    a[3] = np.array([stiff, loss, -stiff, -loss]) / light
    columns = timed(machines.body(a, 4000, 61, mass=heavy, force=100))
    renamed = {"t": columns["t"], "z": columns["x"], "dz": columns["v"], "F": columns["F"]}
    return noisy(renamed, 0.001, 61)


def cart() -> Columns:
    t, p, v, a = sines(81, 3000, 0.005, 0.2, 3.0, 0.5)
    columns = {"t": t, "p": p, "v": v, "a": a, "f": 2.5 * a + 0.75 * v + 40 * p**3}
    return noisy(columns, 0.003, 81)


def rig() -> Columns:
    t, x, dx, ddx = sines(91, 3000, 0.01, 0.2, 3.0, 0.5)
    u = 2 * ddx + 1.2 * dx + 30 * x + 25 * x**3 + 1.5 * np.sign(dx)
    return noisy({"t": t, "x": x, "dx": dx, "u": u}, 0.003, 91)


def of(columns: Columns, *names: str) -> Columns:
    return {name: columns[name] for name in names}


RECORDINGS: dict[str, Callable[[], Columns]] = {
    "drag.csv": lambda: noisy(drag(), 0.005, 1),
    "drag_exact.csv": drag,
    "drag_acceleration.csv": lambda: noisy(drag() | {"ddx": sines(1, 3000, 0.01)[3]}, 0.005, 1),
    "drag_position.csv": lambda: of(noisy(drag(), 0.002, 2), "t", "x", "u"),
    "drag_late.csv": late_drag,
    "drag_faults.csv": faulty_drag,
    "drag_bias.csv": biased_drag,
    "drag_filtered.csv": filtered_drag,
    # A force acts and nothing moves.
    "still.csv": lambda: drag(count=500) | {"x": np.zeros(500), "dx": np.zeros(500)},
    "run1.csv": lambda: run(1),
    "run2.csv": lambda: run(2),
    "run3.csv": lambda: run(3),
    "duffing.csv": duffing,
    "emps.csv": axis,
    "axis.csv": lambda: of(axis(), "t", "q", "force"),
    "swing.csv": swing,
    "two_mass.csv": two_mass,
    # A body with an oscillator of 9.4 Hz on it, without it, and with a spring behind its damper.
    "mode.csv": lambda: noisy(timed(machines.body_with_mode()), 1e-4, 71),
    "body.csv": lambda: noisy(timed(machines.body_with_mode(False)), 3e-3, 73),
    "spring.csv": lambda: noisy(timed(machines.body_with_lag()), 1e-4, 72),
    "cart.csv": cart,
    "rig.csv": rig,
}
TEXTS = {
    "broken.csv": "t,x,u\n0,1,2\n0.01,1\n0.02,nonsense,3\n",
    "empty.csv": "",
    "wrong.py": "import no_such_module\n",
    "drag.toml": """model = "drag-oscillator"
records = ["drag.csv"]
band = [0.3, 4.0]
set = {k = 20.0}
refine = "none"
""",
    "body.py": "from tests.machines import BODY as body",
    "cart.py": """import riecjax as rx

cart = rx.Equation(
    rx.Term("m", "v", derivative=1, measured=("a",), unit="kg"),
    rx.Term("c", "v", unit="N s/m"),
    rx.Term("k", lambda s: s["p"] ** 3, unit="N/m^3"),
    -rx.Term(1.0, "f", unit="N"),
    name="cart",
)
""",
    "arm.py": """import jax.numpy as jnp
import riecjax as rx

arm = rx.Equation(
    rx.Term(1.0, "theta", derivative=2),
    -rx.Term("c1", lambda s: jnp.sin(s["theta"]), unit="1/s^2"),
    -rx.Term("c2", lambda s: s["u"] ** 2, unit="rad/s^2"),
    -rx.Term("c3", "theta", derivative=1, unit="1/s"),
    name="arm",
)
""",
    "damper.py": """import riecjax as rx

damper = rx.Equation(
    rx.Term("c", "x", derivative=1, unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    rx.Term("f0", rx.constant, unit="N"),
    -rx.Term(1.0, "f"),
    name="damper",
    unit="N",
)
""",
    "rig.py": """import riecjax as rx

RIG = rx.Model(
    "rig",
    "a mass that is pushed",
    stages=rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg"),
        -rx.Term(1.0, "u"),
        name="rig",
        unit="N",
    ),
    derived={"dx": "x"},
)
LAWS = [rx.Term("spring", "x"), rx.Term("cubic", rx.odd("x", 3)), rx.Term("dry", rx.odd("dx", 0))]
""",
}


@made(*RECORDINGS, *TEXTS)
def _(folder: Path) -> None:
    for name, motion in RECORDINGS.items():
        write_csv(folder / name, motion(), "%.15g" if name == "drag_exact.csv" else "%.9g")
    for name, text in TEXTS.items():
        (folder / name).write_text(text)


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


@made("drive.csv")
def _(folder: Path) -> None:
    """The source model of the paper on a road, as the README has it but shorter."""
    from riecjax.cli.main import run

    options = ["--input", "white-noise", "--seed", "4", "--duration", "20"]
    with contextlib.redirect_stdout(None):
        status = run(["simulate", "quarter-car-source", *options, "--out", f"{folder}/drive.csv"])
    if status:
        raise RuntimeError("drive.csv could not be simulated")


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
