"""The command lines whose outputs are approved, as data."""

import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tests.approved.files import FILES, NEEDS

import riecjax as rx

Kept = Mapping[str, Any]
"""What is kept of an output, as in its file."""


@dataclass(frozen=True)
class KnownWrong:
    """What should be said in place of what is approved.

    **Fields:** `right`, in words; `holds`, whether an output is right: then the mark must go.
    """

    right: str
    holds: Callable[[Kept], bool]


@dataclass(frozen=True)
class Case:
    """A command line, run in an empty folder that holds the inputs it names.

    **Fields:** `name`; `line`, after `riecjax`; `slow`, as of tests; `draws`, that pictures are
    drawn and the names of all files kept; `document`, that it is run again with `--json` where it
    writes no `results.json`; `needs`, a package without which it is skipped;
    `folder` beside the project, whose files it reads; `known_wrong`.
    """

    name: str
    line: str
    slow: bool = False
    draws: bool = False
    document: bool = True
    needs: str = ""
    folder: str = ""
    known_wrong: KnownWrong | None = None

    @property
    def words(self) -> list[str]:
        return shlex.split(self.line)


@dataclass(frozen=True)
class Moments:
    """Gram matrices of a recording under a criterion."""

    name: str
    record: str
    model: str
    criterion: Callable[[], Any]
    slow: bool = False
    folder: str = ""
    known_wrong: KnownWrong | None = None

    @property
    def words(self) -> list[str]:
        return [self.record]


def value(kept: Kept, name: str) -> float:
    return float(
        (kept.get("document") or {}).get("parameters", {}).get(name, {}).get("value", "nan")
    )


def near(kept: Kept, **truth: float) -> bool:
    """Whether all values are right to 3 %."""
    return all(abs(value(kept, name) / right - 1) < 0.03 for name, right in truth.items())


def level(kept: Kept, name: str) -> str:
    verdict = (kept.get("document") or {}).get("verdict", {}).get("parameters", {})
    return verdict.get(name, {}).get("level", "")


def says(kept: Kept, pattern: str) -> bool:
    """Whether the words, wrapped anyhow, match."""
    words = " ".join(f"{kept['out']} {kept['err']}".split())
    return re.search(pattern, words) is not None


def answered(kept: Kept) -> bool:
    return kept["status"] == 0


PLAIN = "--refine none --no-sweep"
DRAG = "identify drag.csv --model drag-oscillator"
BODY = "--model body.py:body"

QUARTER_CAR = [
    Case("quarter-car", "identify drive.csv --model quarter-car --out out --verbose"),
    Case(
        "quarter-car-files",
        "identify drive.csv --model quarter-car --refine none --out out",
        draws=True,
        slow=True,
    ),
    Case("quarter-car-check", "check drive.csv --model quarter-car"),
    Case("quarter-car-wheel", f"identify drive.csv --model quarter-car-wheel {PLAIN} --out out"),
    Case(
        "quarter-car-dols",
        f"identify drive.csv --model quarter-car --criterion dols {PLAIN} --out out",
    ),
    Case(
        "quarter-car-set", f"identify drive.csv --model quarter-car --set M_s=300 {PLAIN} --out out"
    ),
    Case(
        "quarter-car-random",
        f"identify drive.csv --model quarter-car --windows 4000 --seed 7 {PLAIN} --out out",
    ),
    Case(
        "quarter-car-mode",
        f"identify drive.csv --model quarter-car --add-mode x4 {PLAIN} --out out",
        slow=True,
    ),
    Case(
        "quarter-car-0.1",
        "identify drive.csv --model quarter-car --test-function boxcar "
        "--quadrature 2 --noise none --refine none --no-sweep --out out",
    ),
]
OSCILLATOR = [
    Case("drag", f"{DRAG} --out out --verbose"),
    Case("drag-terse", f"{DRAG} --refine none", slow=True),
    Case("drag-exact", f"identify drag_exact.csv --model drag-oscillator {PLAIN} --out out"),
    Case("drag-check", "check drag.csv --model drag-oscillator"),
    Case("drag-init", "init drag.csv --model drag-oscillator --test-function hat", document=False),
    Case("drag-job", "identify --job drag.toml drag.csv --out out"),
    Case("drag-band", f"{DRAG} --band 0.5 3 {PLAIN} --out out"),
    Case("drag-lengths", f"{DRAG} --alpha 0.2 --beta 0.8 --intervals sandwich {PLAIN} --out out"),
    Case("drag-random", f"{DRAG} --windows 2000 --seed 3 --intervals naive {PLAIN} --out out"),
    Case("drag-hat", f"{DRAG} --test-function hat --quadrature 6 {PLAIN} --out out"),
    Case("drag-bump", f"{DRAG} --test-function bump {PLAIN} --out out"),
    Case(
        "drag-position",
        "identify drag_position.csv --model drag-oscillator --refine none --out out",
    ),
    Case(
        "drag-dols",
        "identify drag_acceleration.csv --model drag-oscillator --criterion dols "
        f"{PLAIN} --out out",
    ),
    Case(
        "drag-noise-given",
        f"{DRAG} --noise x=5e-4 --noise dx=4e-3 --noise u=0.02 {PLAIN} --out out",
    ),
    Case("drag-noise-none", f"{DRAG} --noise none {PLAIN} --out out"),
    Case("drag-late", f"identify drag_late.csv --model drag-oscillator {PLAIN} --out out"),
    Case(
        "drag-late-kept",
        f"identify drag_late.csv --model drag-oscillator --align none {PLAIN} --out out",
    ),
    Case(
        "drag-shift",
        f"identify drag_late.csv --model drag-oscillator --shift dx=0.03 {PLAIN} --out out",
    ),
    Case("drag-filtered", f"identify drag_filtered.csv --model drag-oscillator {PLAIN} --out out"),
    Case(
        "drag-unfilter",
        "identify drag_filtered.csv --model drag-oscillator --unfilter dx=0.03 "
        f"--clock u=300 {PLAIN} --out out",
    ),
    Case(
        "drag-faults",
        f"identify drag_faults.csv --model drag-oscillator {PLAIN} --out out --verbose",
    ),
    Case("drag-faults-check", "check drag_faults.csv --model drag-oscillator"),
    Case(
        "drag-faults-mended",
        "identify drag_faults.csv --model drag-oscillator --leave-out dx "
        f"--leave-out u --outliers missing --notch auto {PLAIN} --out out",
    ),
    Case(
        "drag-spikes-kept",
        f"identify drag_faults.csv --model drag-oscillator --outliers keep {PLAIN} --out out",
    ),
    Case("drag-bias", f"identify drag_bias.csv --model drag-oscillator {PLAIN} --out out"),
    Case(
        "drag-bias-unknown",
        "identify drag_bias.csv --model drag-oscillator --unknown-offset u "
        f"--unknown-gain x --set k=20 {PLAIN} --out out",
    ),
    Case(
        "drag-prepared",
        f"{DRAG} --low-pass u=20 --low-pass x=20 --low-pass dx=20 "
        f"--remove-offset x --remove-drift u --from 2 --to 25 --every 2 {PLAIN} --out out",
    ),
    Case("drag-resampled", f"{DRAG} --resample 80 --upsample 2 --scale u=1 {PLAIN} --out out"),
    Case("drag-integral", f"{DRAG} --refine integral --no-sweep --out out"),
    Case(
        "drag-output-error",
        f"{DRAG} --refine output-error --horizon 2 --bound r=0: "
        "--prior k=20±0.1 --no-sweep --out out",
    ),
    Case(
        "drag-huber",
        f"{DRAG} --refine output-error --loss huber --channel x --no-sweep --out out",
        slow=True,
    ),
    Case("drag-hold-out", f"{DRAG} --hold-out 0.3 {PLAIN} --out out"),
    Case(
        "drag-validate",
        f"identify run1.csv --model drag-oscillator --validate run2.csv {PLAIN} --out out",
    ),
    Case(
        "three-runs",
        f"identify run1.csv run2.csv run3.csv --model drag-oscillator {PLAIN} --out out",
    ),
    Case(
        "three-runs-own",
        "identify run1.csv run2.csv run3.csv --model drag-oscillator "
        f"--per-record k {PLAIN} --out out",
    ),
]
MACHINES = [
    Case("duffing", "identify duffing.csv --model duffing --out out"),
    Case("emps", f"identify emps.csv --model emps {PLAIN} --out out"),
    Case("emps-position", "identify axis.csv --model emps --refine none --out out"),
    Case(
        "emps-asymmetric",
        f"identify emps.csv --model emps-asymmetric --at-rest keep {PLAIN} --out out",
    ),
    Case("pendulum", "identify swing.csv --model pendulum --out out"),
    Case("two-mass", f"identify two_mass.csv --model two-mass {PLAIN} --out out"),
    Case("hidden-mode", f"identify mode.csv {BODY} {PLAIN} --out out --verbose"),
    Case("hidden-mode-added", f"identify mode.csv {BODY} --add-mode v {PLAIN} --out out"),
    Case(
        "hidden-mode-elsewhere",
        f"identify mode.csv {BODY} --add-mode v=25 {PLAIN} --out out",
        slow=True,
    ),
    Case("hidden-mode-absent", f"check body.csv {BODY} --add-mode v", slow=True),
    Case("hidden-spring-added", f"identify spring.csv {BODY} --add-spring c {PLAIN} --out out"),
    Case("own-model", f"identify cart.csv --model cart.py:cart {PLAIN} --out out"),
    Case(
        "own-model-mapped",
        f"identify cart.csv --model cart.py --derive f2=2*f --map f=f2 --set m=5 {PLAIN} --out out",
    ),
    Case("discover", "discover rig.csv --model rig.py:RIG --out out"),
    Case(
        "discover-laws",
        "discover rig.csv --model rig.py:RIG --candidates rig.py:LAWS --hold-out 0.3 --out out",
    ),
    Case("fleet", "fleet drives --model drag-oscillator --by vehicle --workers 0 --out out"),
    Case(
        "fleet-spans",
        "fleet drives --model drag-oscillator --by vehicle --span 5 --workers 0 --out out",
        slow=True,
    ),
    Case("reproduce", "reproduce --roads 2 --out out", slow=True),
    Case("reproduce-quick", "reproduce --quick --out out", slow=True),
]
OTHER_COMMANDS = [
    Case("models", "models"),
    Case("models-quarter-car", "models quarter-car"),
    Case("models-own", "models cart.py:cart"),
    Case(
        "simulate-quarter-car",
        "simulate quarter-car-source --input white-noise --seed 1 --duration 5 --out s.csv",
    ),
    Case(
        "simulate-drag",
        "simulate drag-oscillator --input white-noise --bandwidth 8 --rms 5 "
        "--duration 10 --set r2=2 --out s.npz",
    ),
    Case("simulate-file", "simulate duffing --input duffing.csv --out s.csv"),
    Case("version", "--version", document=False),
]
FAILURES = [
    Case("no-file", "identify none.csv --model emps"),
    Case("no-model", "identify drag.csv --model nothing"),
    Case("no-option", "identify drag.csv --model drag-oscillator --bnad 1 2"),
    Case("bad-value", "identify drag.csv --model drag-oscillator --alpha -1"),
    Case("no-command", "identfy drag.csv"),
    Case("no-signal", "identify drag.csv --model duffing"),
    Case("broken-file", "identify broken.csv --model drag-oscillator"),
    Case("empty-file", "identify empty.csv --model drag-oscillator"),
    Case("still", "identify still.csv --model drag-oscillator"),
    Case("broken-model", "identify drag.csv --model wrong.py:thing"),
    Case("too-long", "identify drag.csv --model drag-oscillator --beta 100"),
    Case("twice", "identify drag.csv drag.csv --model drag-oscillator"),
    Case("unknown-set", "identify drag.csv --model drag-oscillator --set q=1"),
    Case("no-map", "identify drag.csv --model drag-oscillator --map x=zz"),
    Case("bad-unit", "identify drag.csv --model drag-oscillator --unit x=furlongs"),
    Case("mode-refused", f"identify mode.csv {BODY} --add-mode v --criterion dols"),
    Case("simulate-no-values", "simulate body.py:body --input white-noise --out s.csv"),
]
WRONG_TODAY = [
    Case(
        "accel-in-g",
        f"identify shaker.csv --model shaker.py:shaker --unit a=g {PLAIN} --out out",
        folder="cases/accel_in_g",
    ),
    Case(
        "headerless-tail",
        "check coast.csv --model coast.py:car "
        "--columns v --unit v=km/h --time-step 1 --band 0.02 0.1",
        folder="cases/headerless_tail",
    ),
    Case(
        "headerless-one",
        "check one.csv --model coast.py:car "
        "--columns v --unit v=km/h --time-step 1 --band 0.02 0.1",
        folder="cases/headerless_tail",
    ),
    Case(
        "headerless-mixed",
        "check mixed.csv --model coast.py:car "
        "--columns v --unit v=km/h --time-step 1 --band 0.02 0.1",
        folder="cases/headerless_tail",
    ),
    Case(
        "trailing-tab",
        f"identify tab.txt --model emps --columns q,dq,force --time-step 0.01 {PLAIN} --out out",
        folder="cases/trailing_tab",
    ),
    Case(
        "derived-input",
        "identify log.csv --model car.py:bike "
        f"--derive F=3*current --band 0.1 1 --shift current=0.15 {PLAIN} --out out --verbose",
        folder="cases/derived_input",
        known_wrong=KnownWrong(
            "m 120, f0 9, f2 0.25, or that the shift reaches nothing",
            lambda k: (
                near(k, m=120.0, f0=9.0, f2=0.25) and not says(k, "the model does not use it")
            ),
        ),
    ),
    Case(
        "sibling-import",
        "check shaker.csv --model model.py:eq",
        folder="cases/sibling_import",
    ),
    Case(
        "wrapped",
        "check wrapped.csv --model model.py --map i=current_mA",
        folder="cases/wrapped",
    ),
    Case(
        "one-way",
        f"identify one.csv --model model.py {PLAIN} --out out",
        folder="cases/one_way",
        known_wrong=KnownWrong(
            "B is 6.0e-5, or not good: a constant is missing",
            lambda k: near(k, B=6e-5) or level(k, "B") != "good",
        ),
    ),
    Case(
        "one-way-many",
        f"identify many.csv --model model.py {PLAIN} --out out",
        folder="cases/one_way",
        known_wrong=KnownWrong(
            "B is 6.0e-5, or not good: a constant is missing",
            lambda k: near(k, B=6e-5) or level(k, "B") != "good",
        ),
    ),
    Case(
        "lever-arm",
        f"identify track.csv --model track.py:car {PLAIN} --out out",
        folder="cases/lever_arm",
        known_wrong=KnownWrong(
            "Cf 80000 and Cr 95000, or neither is good",
            lambda k: near(k, Cf=80e3, Cr=95e3) or "good" not in (level(k, "Cf"), level(k, "Cr")),
        ),
    ),
    Case(
        "lever-arm-together",
        f"identify track.csv --model track.py:both {PLAIN} --out out",
        folder="cases/lever_arm",
    ),
    Case(
        "hammer-pulses",
        f"identify hammer.csv --model osc.py:osc {PLAIN} --out out",
        folder="cases/hammer_pulses",
        known_wrong=KnownWrong(
            "m 2, k 3000, or neither is good: pulses are too short for the sampling",
            lambda k: near(k, m=2.0, k=3000.0) or "good" not in (level(k, "m"), level(k, "k")),
        ),
    ),
    Case(
        "stiction",
        "identify crash.csv --model model.py --map q=position "
        f"--map dq=speed --set G=0.48 {PLAIN} --out out",
        folder="cases/stiction",
        known_wrong=KnownWrong("an answer and no traceback", answered),
    ),
    Case(
        "stiction-servo",
        "identify servo.csv --model model.py --map q=position --map dq=speed --set G=0.48 "
        f"{PLAIN} --out out",
        folder="cases/stiction",
        known_wrong=KnownWrong(
            "an answer: the axis sticks, the sensor is sound",
            lambda k: answered(k) and not says(k, "stuck"),
        ),
    ),
    Case(
        "late-velocity-step",
        "check lag_step_down.csv --model model2.py --beta 0.3",
        folder="cases/late_velocity_step",
        known_wrong=KnownWrong(
            "the velocity is late; position changes by 1.018 times its integral",
            lambda k: not says(k, r"changes by 0\.7"),
        ),
    ),
]
FILES_AS_THEY_COME = [
    Case(
        f"file-{name.replace('.', '-')}",
        f"check {name} --model drag-oscillator {options}",
        needs=NEEDS.get(name, ""),
    )
    for name, options in FILES.items()
]
MEASURED = [
    Case(
        "measured-emps",
        "identify DATA_EMPS.mat --model emps --map q=qm --map force=vir "
        "--scale vir=35.1507 --out out",
        folder="data/emps",
        slow=True,
    ),
    Case(
        "measured-emps-boxcar",
        "identify DATA_EMPS.mat --model emps-asymmetric --map q=qm "
        f"--map force=vir --scale vir=35.1507 --test-function boxcar {PLAIN} --out out",
        folder="data/emps",
        slow=True,
    ),
    Case(
        "measured-silverbox",
        "identify SNLS80mV.mat --model duffing --map u=V1 --map y=V2 "
        f"--time-step 0.0016384 --to 15 --test-function hat --quadrature 8 {PLAIN} --out out",
        folder="data/silverbox",
        slow=True,
    ),
    Case(
        "measured-pendulum",
        "check SinglePendulumDataForParameterEstimation.mat "
        "--model pendulum --map theta=Y_id --map t=Time_id",
        folder="data/pendulum_single",
        slow=True,
    ),
    Case(
        "measured-arm",
        "identify sinal2_degraus_malha_fechada.csv --model arm.py:arm "
        "--map t=Tempo_s --map theta=Saida_y --map u=Controle_u --unit Saida_y=deg "
        f"--from 20 --to 80 --test-function hat --band 0.3 1 {PLAIN} --out out",
        folder="data/quarter_drone",
        slow=True,
    ),
    Case(
        "measured-damper",
        "identify data_simulation_4.1_MRdamper.mat "
        "--model damper.py:damper --map t=tout --map x=dist --map f=forc --test-function hat "
        f"{PLAIN} --out out",
        folder="data/mr_damper_labcontrol",
        slow=True,
    ),
]
MOMENTS = [
    Moments(
        "moments-quarter-car", "drive.csv", "quarter-car", lambda: rx.RIEC(rx.AllWindows(0.05, 0.5))
    ),
    Moments(
        "moments-quarter-car-random",
        "drive.csv",
        "quarter-car",
        lambda: rx.RIEC(rx.RandomWindows(0.05, 0.5, 3000)),
    ),
    Moments("moments-quarter-car-dols", "drive.csv", "quarter-car", lambda: rx.DOLS()),
    Moments(
        "moments-drag", "drag.csv", "drag-oscillator", lambda: rx.RIEC(rx.AllWindows(0.05, 0.5))
    ),
    Moments(
        "moments-drag-hat",
        "drag.csv",
        "drag-oscillator",
        lambda: rx.RIEC(rx.AllWindows(0.1, 0.6), rx.Hat()),
    ),
    Moments(
        "moments-drag-bump",
        "drag.csv",
        "drag-oscillator",
        lambda: rx.RIEC(rx.AllWindows(0.3, 1.0), rx.Bump(3)),
    ),
    Moments("moments-emps", "emps.csv", "emps", lambda: rx.RIEC(rx.AllWindows(0.05, 0.5))),
    Moments("moments-pendulum", "swing.csv", "pendulum", lambda: rx.RIEC(rx.AllWindows(0.05, 0.5))),
]
CASES: dict[str, Case | Moments] = {
    case.name: case
    for case in [
        *FAILURES,
        *OTHER_COMMANDS,
        *OSCILLATOR,
        *QUARTER_CAR,
        *MACHINES,
        *WRONG_TODAY,
        *FILES_AS_THEY_COME,
        *MEASURED,
        *MOMENTS,
    ]
}
