"""The command lines whose outputs are approved, as a table."""

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


def near(kept: Kept, **truth: float) -> bool:
    """Whether all values are right to 3 %."""
    found = (kept.get("document") or {}).get("parameters", {})
    values = {name: float(found.get(name, {}).get("value", "nan")) for name in truth}
    return all(abs(values[name] / right - 1) < 0.03 for name, right in truth.items())


def good(kept: Kept, *names: str) -> bool:
    """Whether any of these parameters is judged to be good."""
    verdict = (kept.get("document") or {}).get("verdict", {}).get("parameters", {})
    return any(verdict.get(name, {}).get("level") == "good" for name in names)


def says(kept: Kept, pattern: str) -> bool:
    """Whether the words, wrapped anyhow, match."""
    words = " ".join(f"{kept['out']} {kept['err']}".split())
    return re.search(pattern, words) is not None


PLAIN = "--refine none --no-sweep --out out"
BODY = "--model body.py:body"
COAST = "--model coast.py:car --columns v --unit v=km/h --time-step 1 --band 0.02 0.1"
STICKING = "--model model.py --map q=position --map dq=speed --set G=0.48"
FORCE_OF_EMPS = "--map q=qm --map force=vir --scale vir=35.1507"
LINES: dict[str, dict[str, str]] = {
    "": {
        "no-command": "identfy drag.csv",
        "models": "models",
        "models-quarter-car": "models quarter-car",
        "models-own": "models cart.py:cart",
        "version": "--version",
        "reproduce": "reproduce --roads 2 --out out",
        "reproduce-quick": "reproduce --quick --out out",
    },
    "simulate": {
        "simulate-quarter-car": "quarter-car-source --input white-noise --seed 1 --duration 5 "
        "--out s.csv",
        "simulate-drag": "drag-oscillator --input white-noise --bandwidth 8 --rms 5 --duration 10 "
        "--set r2=2 --out s.npz",
        "simulate-file": "duffing --input duffing.csv --out s.csv",
        "simulate-no-values": "body.py:body --input white-noise --out s.csv",
    },
    "identify": {
        "no-file": "none.csv --model emps",
        "no-model": "drag.csv --model nothing",
        "no-signal": "drag.csv --model duffing",
        "broken-file": "broken.csv --model drag-oscillator",
        "empty-file": "empty.csv --model drag-oscillator",
        "still": "still.csv --model drag-oscillator",
        "broken-model": "drag.csv --model wrong.py:thing",
        "twice": "drag.csv drag.csv --model drag-oscillator",
        "mode-refused": f"mode.csv {BODY} --add-mode v --criterion dols",
        "drag-exact": f"drag_exact.csv --model drag-oscillator {PLAIN}",
        "drag-job": "--job drag.toml drag.csv --out out",
        "drag-position": "drag_position.csv --model drag-oscillator --refine none --out out",
        "drag-dols": "drag_acceleration.csv --model drag-oscillator --criterion dols " + PLAIN,
        "drag-late": f"drag_late.csv --model drag-oscillator {PLAIN}",
        "drag-late-kept": f"drag_late.csv --model drag-oscillator --align none {PLAIN}",
        "drag-shift": f"drag_late.csv --model drag-oscillator --shift dx=0.03 {PLAIN}",
        "drag-filtered": f"drag_filtered.csv --model drag-oscillator {PLAIN}",
        "drag-unfilter": "drag_filtered.csv --model drag-oscillator --unfilter dx=0.03 "
        f"--clock u=300 {PLAIN}",
        "drag-faults": f"drag_faults.csv --model drag-oscillator {PLAIN} --verbose",
        "drag-faults-mended": "drag_faults.csv --model drag-oscillator --leave-out dx "
        f"--leave-out u --outliers missing --notch auto {PLAIN}",
        "drag-spikes-kept": f"drag_faults.csv --model drag-oscillator --outliers keep {PLAIN}",
        "drag-bias": f"drag_bias.csv --model drag-oscillator {PLAIN}",
        "drag-bias-unknown": "drag_bias.csv --model drag-oscillator --unknown-offset u "
        f"--unknown-gain x --set k=20 {PLAIN}",
        "drag-validate": f"run1.csv --model drag-oscillator --validate run2.csv {PLAIN}",
        "three-runs": f"run1.csv run2.csv run3.csv --model drag-oscillator {PLAIN}",
        "three-runs-own": "run1.csv run2.csv run3.csv --model drag-oscillator --per-record k "
        + PLAIN,
        "duffing": "duffing.csv --model duffing --out out",
        "quarter-car-wheel": f"drive.csv --model quarter-car-wheel {PLAIN}",
        "emps": f"emps.csv --model emps {PLAIN}",
        "emps-position": "axis.csv --model emps --refine none --out out",
        "emps-asymmetric": f"emps.csv --model emps-asymmetric --at-rest keep {PLAIN}",
        "pendulum": "swing.csv --model pendulum --out out",
        "two-mass": f"two_mass.csv --model two-mass {PLAIN}",
        "hidden-mode": f"mode.csv {BODY} {PLAIN} --verbose",
        "hidden-mode-added": f"mode.csv {BODY} --add-mode v {PLAIN}",
        "hidden-mode-elsewhere": f"mode.csv {BODY} --add-mode v=25 {PLAIN}",
        "hidden-spring-added": f"spring.csv {BODY} --add-spring c {PLAIN}",
        "own-model": f"cart.csv --model cart.py:cart {PLAIN}",
        "own-model-mapped": "cart.csv --model cart.py --derive f2=2*f --map f=f2 --set m=5 "
        + PLAIN,
    },
    "identify drive.csv --model quarter-car": {
        "quarter-car": "--out out --verbose",
        "quarter-car-files": "--refine none --out out",
        "quarter-car-dols": f"--criterion dols {PLAIN}",
        "quarter-car-set": f"--set M_s=300 {PLAIN}",
        "quarter-car-random": f"--windows 4000 --seed 7 {PLAIN}",
        "quarter-car-mode": f"--add-mode x4 {PLAIN}",
        "quarter-car-0.1": "--test-function boxcar --quadrature 2 --noise none " + PLAIN,
    },
    "identify drag.csv --model drag-oscillator": {
        "no-option": "--bnad 1 2",
        "bad-value": "--alpha -1",
        "too-long": "--beta 100",
        "unknown-set": "--set q=1",
        "no-map": "--map x=zz",
        "bad-unit": "--unit x=furlongs",
        "drag": "--out out --verbose",
        "drag-terse": "--refine none",
        "drag-band": f"--band 0.5 3 {PLAIN}",
        "drag-lengths": f"--alpha 0.2 --beta 0.8 --intervals sandwich {PLAIN}",
        "drag-random": f"--windows 2000 --seed 3 --intervals naive {PLAIN}",
        "drag-hat": f"--test-function hat --quadrature 6 {PLAIN}",
        "drag-bump": f"--test-function bump {PLAIN}",
        "drag-noise-given": f"--noise x=5e-4 --noise dx=4e-3 --noise u=0.02 {PLAIN}",
        "drag-noise-none": f"--noise none {PLAIN}",
        "drag-prepared": "--low-pass u=20 --low-pass x=20 --low-pass dx=20 --remove-offset x "
        f"--remove-drift u --from 2 --to 25 --every 2 {PLAIN}",
        "drag-resampled": f"--resample 80 --upsample 2 --scale u=1 {PLAIN}",
        "drag-integral": "--refine integral --no-sweep --out out",
        "drag-output-error": "--refine output-error --horizon 2 --bound r=0: --prior k=20±0.1 "
        "--no-sweep --out out",
        "drag-huber": "--refine output-error --loss huber --channel x --no-sweep --out out",
        "drag-hold-out": f"--hold-out 0.3 {PLAIN}",
    },
    "check": {
        "quarter-car-check": "drive.csv --model quarter-car",
        "drag-check": "drag.csv --model drag-oscillator",
        "drag-faults-check": "drag_faults.csv --model drag-oscillator",
        "hidden-mode-absent": f"body.csv {BODY} --add-mode v",
    }
    | {
        f"file-{name.replace('.', '-')}": f"{name} --model drag-oscillator {options}"
        for name, options in FILES.items()
    },
    "init": {"drag-init": "drag.csv --model drag-oscillator --test-function hat"},
    "discover": {
        "discover": "rig.csv --model rig.py:RIG --out out",
        "discover-laws": "rig.csv --model rig.py:RIG --candidates rig.py:LAWS --hold-out 0.3 "
        "--out out",
    },
    "fleet drives --model drag-oscillator --by vehicle": {
        "fleet": "--workers 0 --out out",
        "fleet-spans": "--span 5 --workers 0 --out out",
    },
}
SLOW = {
    *("quarter-car-files", "quarter-car-mode", "quarter-car-wheel", "quarter-car-dols"),
    *("quarter-car-set", "quarter-car-0.1", "reproduce", "reproduce-quick", "fleet-spans"),
    *("drag-terse", "drag-huber", "drag-late-kept", "drag-unfilter", "drag-faults-mended"),
    *("drag-spikes-kept", "drag-bias-unknown", "drag-validate", "drag-position", "drag-bump"),
    *("drag-noise-given", "drag-noise-none", "drag-resampled", "three-runs-own", "pendulum"),
    *("emps-position", "emps-asymmetric", "own-model-mapped", "discover-laws", "one-way-many"),
    *("hidden-mode-elsewhere", "hidden-mode-absent", "stiction-servo", "lever-arm"),
    *("duffing", "drag-filtered", "quarter-car-random", "drag-prepared", "drag-output-error"),
    *("lever-arm-together", "file-pause-csv", "hammer-pulses"),
}
"""What `make nightly` compares besides: long, or an option beside one that the day compares."""
BESIDE: dict[str, dict[str, str]] = {
    "cases/accel_in_g": {
        "accel-in-g": f"identify shaker.csv --model shaker.py:shaker --unit a=g {PLAIN}",
    },
    "cases/headerless_tail": {
        "headerless-tail": f"check coast.csv {COAST}",
        "headerless-one": f"check one.csv {COAST}",
        "headerless-mixed": f"check mixed.csv {COAST}",
    },
    "cases/trailing_tab": {
        "trailing-tab": "identify tab.txt --model emps --columns q,dq,force --time-step 0.01 "
        + PLAIN,
    },
    "cases/derived_input": {
        "derived-input": "identify log.csv --model car.py:bike --derive F=3*current --band 0.1 1 "
        f"--shift current=0.15 {PLAIN} --verbose",
    },
    "cases/sibling_import": {"sibling-import": "check shaker.csv --model model.py:eq"},
    "cases/wrapped": {"wrapped": "check wrapped.csv --model model.py --map i=current_mA"},
    "cases/one_way": {
        "one-way": f"identify one.csv --model model.py {PLAIN}",
        "one-way-many": f"identify many.csv --model model.py {PLAIN}",
    },
    "cases/lever_arm": {
        "lever-arm": f"identify track.csv --model track.py:car {PLAIN}",
        "lever-arm-together": f"identify track.csv --model track.py:both {PLAIN}",
    },
    "cases/hammer_pulses": {
        "hammer-pulses": f"identify hammer.csv --model osc.py:osc {PLAIN}",
    },
    "cases/stiction": {
        "stiction": f"identify crash.csv {STICKING} {PLAIN}",
        "stiction-servo": f"identify servo.csv {STICKING} {PLAIN}",
    },
    "cases/late_velocity_step": {
        "late-velocity-step": "check lag_step_down.csv --model model2.py --beta 0.3",
    },
    "data/emps": {
        "measured-emps": f"identify DATA_EMPS.mat --model emps {FORCE_OF_EMPS} --out out",
        "measured-emps-boxcar": "identify DATA_EMPS.mat --model emps-asymmetric "
        f"{FORCE_OF_EMPS} --test-function boxcar {PLAIN}",
    },
    "data/silverbox": {
        "measured-silverbox": "identify SNLS80mV.mat --model duffing --map u=V1 --map y=V2 "
        f"--time-step 0.0016384 --to 15 --test-function hat --quadrature 8 {PLAIN}",
    },
    "data/pendulum_single": {
        "measured-pendulum": "check SinglePendulumDataForParameterEstimation.mat "
        "--model pendulum --map theta=Y_id --map t=Time_id",
    },
    "data/quarter_drone": {
        "measured-arm": "identify sinal2_degraus_malha_fechada.csv --model arm.py:arm "
        "--map t=Tempo_s --map theta=Saida_y --map u=Controle_u --unit Saida_y=deg "
        f"--from 20 --to 80 --test-function hat --band 0.3 1 {PLAIN}",
    },
    "data/mr_damper_labcontrol": {
        "measured-damper": "identify data_simulation_4.1_MRdamper.mat --model damper.py:damper "
        f"--map t=tout --map x=dist --map f=forc --test-function hat {PLAIN}",
    },
}
"""By the folder beside the project; measured ones are slow."""
KNOWN_WRONG: dict[str, KnownWrong] = {}


def in_windows(low: float, high: float, *weight: Any) -> Callable[[], Any]:
    return lambda: rx.RIEC(rx.AllWindows(low, high), *weight)


MOMENTS = [
    Moments("moments-quarter-car", "drive.csv", "quarter-car", in_windows(0.05, 0.5)),
    Moments(
        "moments-quarter-car-random",
        "drive.csv",
        "quarter-car",
        lambda: rx.RIEC(rx.RandomWindows(0.05, 0.5, 3000)),
    ),
    Moments("moments-quarter-car-dols", "drive.csv", "quarter-car", lambda: rx.DOLS()),
    Moments("moments-drag", "drag.csv", "drag-oscillator", in_windows(0.05, 0.5)),
    Moments("moments-drag-hat", "drag.csv", "drag-oscillator", in_windows(0.1, 0.6, rx.Hat())),
    Moments("moments-drag-bump", "drag.csv", "drag-oscillator", in_windows(0.3, 1.0, rx.Bump(3))),
    Moments("moments-emps", "emps.csv", "emps", in_windows(0.05, 0.5)),
    Moments("moments-pendulum", "swing.csv", "pendulum", in_windows(0.05, 0.5)),
]
NEEDED = {f"file-{name.replace('.', '-')}": package for name, package in NEEDS.items()}


def case(name: str, line: str, folder: str = "") -> Case:
    return Case(
        name,
        line,
        slow=name in SLOW or folder.startswith("data"),
        draws=name == "quarter-car-files",
        document=name not in ("drag-init", "version"),
        needs=NEEDED.get(name, ""),
        folder=folder,
        known_wrong=KNOWN_WRONG.get(name),
    )


CASES: dict[str, Case | Moments] = {
    **{
        name: case(name, f"{start} {rest}")
        for start, cases in LINES.items()
        for name, rest in cases.items()
    },
    **{
        name: case(name, line, folder)
        for folder, cases in BESIDE.items()
        for name, line in cases.items()
    },
    **{each.name: each for each in MOMENTS},
}
