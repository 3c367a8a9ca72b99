"""The built-in models by name, in plain data: listing them imports no JAX."""

import contextlib
import functools
import importlib.util
import pkgutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

from riecjax.equations.quantity import BY_EQUATIONS, FrozenDict, Machine, Quantity
from riecjax.errors import ModelError, require, users_code
from riecjax.whole_files import no_file

if TYPE_CHECKING:
    from riecjax.equations.model import Model
    from riecjax.settings import Elements

_ROAD = (Quantity("v_r", "m/s", "road velocity, downwards positive"),)
_QUARTER_CAR_COLUMNS = ("v_r", "x1", "x2", "x3", "x4", "dx3", "dx4", "F_t")
_AXIS: dict[str, Any] = {
    "signals": (
        Quantity("q", "m", "position"),
        Quantity("force", "N", "driving force"),
        Quantity("dq", "m/s", "velocity (central differences of q if absent)"),
        Quantity("ddq", "m/s^2", "acceleration (DOLS only; central differences of dq if absent)"),
    ),
    "derived": {"dq": "q", "ddq": "dq"},
    "inputs": (Quantity("force", "N", "driving force"),),
}
"""What is recorded of a driven axis."""


class Listing(SimpleNamespace):
    """A built-in model before it is built: the fields of a [`Model`][riecjax.Model].

    Where that has a function, this has its name, `module:function`.
    """

    stages = ""
    signals = parameters = inputs = ()
    rates = FrozenDict()
    system = BY_EQUATIONS


def _named(reference: Any) -> Any:
    """What `module:function` names, of no name nothing."""
    return pkgutil.resolve_name(reference) if reference else None


def _quarter_car(name: str, equation: str, builder: str) -> Listing:
    return Listing(
        name=name,
        summary=f"two masses with a damper map; K_s and F_i from the motion of the {equation}",
        signals=(
            Quantity("x1", "m", "tyre extension: road minus wheel, downwards positive"),
            Quantity("x2", "m", "suspension deflection: wheel minus body"),
            Quantity("x3", "m/s", "wheel velocity"),
            Quantity("x4", "m/s", "body velocity"),
            Quantity("F_t", "N", "tyre force"),
            Quantity("dx3", "m/s^2", "wheel acceleration (DOLS only)"),
            Quantity("dx4", "m/s^2", "body acceleration (DOLS only)"),
        ),
        stages=f"riecjax.models.quarter_car.identification:{builder}",
        parameters=(
            Quantity("K_t", "N/m", "tyre stiffness", 177.8e3),
            Quantity("M_us", "kg", "unsprung mass", 23.3),
            Quantity("M_s", "kg", "sprung mass", 302.7),
            Quantity("K_s", "N/m", "suspension stiffness", 20.9e3),
            Quantity("F_1", "N", "damper force at -0.8 m/s", -1200.0),
            Quantity("F_2", "N", "damper force at -0.3 m/s", -750.0),
            Quantity("F_3", "N", "damper force at 0.3 m/s", 750.0),
            Quantity("F_4", "N", "damper force at 0.8 m/s", 1100.0),
        ),
        inputs=_ROAD,
        rates={
            "x1": "riecjax.models.quarter_car.identification:tyre_velocity",
            "x2": "riecjax.models.quarter_car.identification:suspension_velocity",
        },
        # The body moves at 1.3 Hz and the wheel at 13 Hz (Table 1); Table 2 has this.
        band=(1.0, 10.0),
        written=_QUARTER_CAR_COLUMNS,
    )


def _mass(x: str, force: str, of: str = "", on: str = "") -> dict[str, Any]:
    """What is recorded of a mass under a force, which drives it."""
    driving = Quantity(force, "N", f"force{on}")
    return {
        "signals": (
            Quantity(x, "m", f"displacement{of}"),
            driving,
            Quantity(f"d{x}", "m/s", f"velocity (central differences of {x} if absent)"),
            Quantity(f"dd{x}", "m/s^2", f"acceleration (DOLS; differences of d{x} if absent)"),
        ),
        "derived": {f"d{x}": x, f"dd{x}": f"d{x}"},
        "inputs": (driving,),
    }


LISTED = {
    listing.name: listing
    for listing in (
        _quarter_car("quarter-car", "body", "quarter_car_by_body"),
        _quarter_car("quarter-car-wheel", "wheel", "quarter_car_by_wheel"),
        Listing(
            name="quarter-car-source",
            summary="seven-state source model of the paper, eqs (19)-(20); simulation only",
            system=Machine(
                "riecjax.models.quarter_car.reconstruction:quarter_car_source",
                (
                    Quantity("M_w", "kg", "wheel mass", 30.0),
                    Quantity("M_b", "kg", "body mass", 200.0),
                    Quantity("M_e", "kg", "engine mass", 100.0),
                    Quantity("K_t", "N/m", "tyre stiffness", 180e3),
                    Quantity("K_c", "N/m", "damper compliance", 500e3),
                    Quantity("K_m", "N/m", "engine mount stiffness", 400e3),
                    Quantity("B_m", "N s/m", "engine mount damping", 4000.0),
                ),
            ),
            inputs=_ROAD,
            written=_QUARTER_CAR_COLUMNS,
        ),
        Listing(
            name="two-mass",
            summary="M z'' = F, while a second mass on a spring and damper moves unmodelled",
            **_mass("z", "F", " of the first mass", " on the first mass"),
            stages="riecjax.models.oscillators:two_mass_equation",
            parameters=(Quantity("M", "kg", "total mass"),),
            system=Machine(
                "riecjax.models.oscillators:two_mass_system",
                (
                    Quantity("m1", "kg", "first mass", 10.0),
                    Quantity("m2", "kg", "second mass", 1.0),
                    Quantity("omega_n", "rad/s", "natural frequency of the coupling", 100.0),
                    Quantity("zeta", "", "damping ratio of the coupling", 0.5),
                ),
            ),
        ),
        Listing(
            name="emps",
            summary="M q'' + Fv q' + Fc sign(q') + offset = force",
            **_AXIS,
            stages="riecjax.models.oscillators:emps_equation",
            parameters=(
                Quantity("M", "kg", "mass", 95.1),
                Quantity("Fv", "N s/m", "viscous friction", 203.5),
                Quantity("Fc", "N", "Coulomb friction", 20.4),
                Quantity("offset", "N", "force offset", -3.16),
            ),
        ),
        Listing(
            name="emps-asymmetric",
            summary="M q'' + friction = force, with separate friction for each direction",
            **_AXIS,
            stages="riecjax.models.oscillators:emps_asymmetric_equation",
            parameters=(
                Quantity("M", "kg", "mass", 95.15),
                Quantity("Fv_pos", "N s/m", "viscous friction, q' > 0", 166.7),
                Quantity("Fc_pos", "N", "Coulomb friction, q' > 0", 20.14),
                Quantity("Fv_neg", "N s/m", "viscous friction, q' < 0", 240.4),
                Quantity("Fc_neg", "N", "Coulomb friction, q' < 0", 20.63),
            ),
        ),
        Listing(
            name="duffing",
            summary="m y'' + d y' + k1 y + k2 y^2 + k3 y^3 = u",
            **_mass("y", "u"),
            stages="riecjax.models.oscillators:duffing_equation",
            parameters=(
                Quantity("m", "kg", "mass", 1.0),
                Quantity("d", "N s/m", "damping", 0.5),
                Quantity("k1", "N/m", "linear stiffness", 100.0),
                Quantity("k2", "N/m^2", "quadratic stiffness", 0.0),
                Quantity("k3", "N/m^3", "cubic stiffness", 1000.0),
            ),
        ),
        Listing(
            name="drag-oscillator",
            summary="m x'' + r x' + r2 x'|x'| + k x = u",
            **_mass("x", "u"),
            stages="riecjax.models.oscillators:drag_oscillator_equation",
            parameters=(
                Quantity("m", "kg", "mass", 1.5),
                Quantity("r", "N s/m", "viscous drag", 0.8),
                Quantity("r2", "N s^2/m^2", "quadratic drag", 0.5),
                Quantity("k", "N/m", "stiffness", 20.0),
            ),
        ),
        Listing(
            name="pendulum",
            summary="theta'' = p1 sin(theta) - p2 theta', theta zero upright, no input",
            signals=(
                Quantity("theta", "rad", "angle, zero upright, pi hanging"),
                Quantity("dtheta", "rad/s", "angular velocity (central differences if absent)"),
                Quantity("ddtheta", "rad/s^2", "angular acceleration (DOLS; likewise)"),
            ),
            derived={"dtheta": "theta", "ddtheta": "dtheta"},
            stages="riecjax.models.oscillators:pendulum_equation",
            parameters=(
                Quantity("p1", "1/s^2", "m g a / J", 64.22),
                Quantity("p2", "1/s", "k / J", 0.0672),
            ),
            system=Machine("riecjax.models.oscillators:pendulum_system"),
            inputs=(Quantity("torque", "1/s^2", "torque over inertia"),),
        ),
    )
}


@functools.cache
def built_in_model(name: str) -> "Model":
    """The built-in model of this name, built when it is first asked for.

    **Raises:** `ModelError` for a name that is not built in.
    """
    from riecjax.equations.model import Model

    if name not in LISTED:
        raise ModelError(
            f"unknown model '{name}'; built in are: {', '.join(LISTED)}. Name a model of your own "
            f"by its file: path/to/file.py:object, or path/to/file.py where that holds one."
        )
    listing = LISTED[name]
    functions = {
        "stages": build() if (build := _named(listing.stages)) else (),
        "rates": {signal: _named(rate) for signal, rate in listing.rates.items()},
        "system": listing.system._replace(build=_named(listing.system.build)),
    }
    return Model(**vars(listing) | functions)


def find_model(reference: str) -> "Model":
    """A built-in model by name, or `path/to/file.py:object` of the user's own.

    The object may be a `Model`, an `Equation`, or a function without arguments that returns one of
    these. It need not be named where the file holds one such object: one `Model` that is described,
    or else one model or `Equation` that is no part of another. The file is run: name only one that
    you would run yourself.

    **Raises:** `ModelError` if there is no such model, file or object.
    """
    from riecjax.equations.equation import Equation
    from riecjax.equations.model import OWN, Model, names_of, staged

    require("the model's name", reference, str, "such as rx.find_model('quarter-car')")
    path, _, attribute = reference.rpartition(":")
    if reference.endswith(".py"):
        path, objects = reference, vars(_load(Path(reference))).items()
        # One object may have two names, of which the last counts.
        public = {id(thing): (name, thing) for name, thing in objects if not name.startswith("_")}
        models = {key: thing for key, (_, thing) in public.items() if isinstance(thing, Model)}
        parts = {id(equation) for model in models.values() for equation in model.equations}
        equations = [key for key, (_, thing) in public.items() if isinstance(thing, Equation)]
        described = [key for key, model in models.items() if model.summary != OWN]
        whole = described or [*models, *(key for key in equations if key not in parts)]
        names = [public[key][0] for key in whole]
        if not whole:
            raise ModelError(
                f"{path} holds no Model or Equation. Give one a name there, or name the "
                f"function that returns one: {path}:NAME."
            )
        if len(whole) > 1:
            raise ModelError(
                f"{path} holds {len(whole)} models: {', '.join(names)}. Say which: "
                f"{path}:{names[0]}."
            )
        attribute, found = public[whole[0]]
    elif path.endswith(".py"):
        found = object_of_file(reference)
    else:
        return built_in_model(reference)
    if not isinstance(found, Model | Equation) and callable(found):
        with users_code(path), _neighbours(Path(path)):
            found = found()
    found = staged(found) if isinstance(found, Equation) else found
    if not isinstance(found, Model):
        raise ModelError(
            f"'{attribute}' in {path} is not a Model or an Equation, nor a function that returns "
            f"one."
        )
    is_named = found.summary != OWN or found.name not in ("", names_of(found.equations))
    return found if is_named else replace(found, name=attribute)


def object_of_file(reference: str) -> object:
    """The object that `path/to/file.py:object` names.

    **Raises:** `ModelError` if there is no such file or object.
    """
    path, _, attribute = reference.rpartition(":")
    if not path.endswith(".py"):
        raise ModelError(f"name a file and an object of it, FILE.py:OBJECT; got '{reference}'.")
    module = _load(Path(path))
    if not hasattr(module, attribute):
        raise ModelError(f"{path} has no object '{attribute}'.")
    return getattr(module, attribute)


_loaded: list[ModuleType] = []
"""What users' files define, whose classes saved criteria name, stays defined."""


def _load(path: Path) -> ModuleType:
    if not path.is_file():
        raise ModelError(no_file(path))
    spec = importlib.util.spec_from_file_location(f"riecjax_user_{path.stem}", path)
    assert spec is not None, "its name ends in .py"
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # A file that loads another of the same name, as discover writes one, has it within its own.
    around = {name: other for name, other in sys.modules.items() if name == spec.name}
    sys.modules[spec.name] = module
    try:
        with users_code(path), _neighbours(path):
            spec.loader.exec_module(module)
    finally:
        # Another process cannot import it: to that its functions and classes go as they are.
        del sys.modules[spec.name]
        sys.modules |= around
    _loaded.append(module)
    return module


@contextlib.contextmanager
def _neighbours(path: Path) -> Iterator[None]:
    """Meanwhile the file can import what lies beside it, as when `python path/to/file.py` runs it.

    Another model's file has other neighbours, which may have the same names: afterwards nothing is
    left of them among the modules.
    """
    folder = path.parent.resolve()
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # the file may have removed it
            sys.path.remove(str(folder))
        new = {name: module for name, module in sys.modules.items() if name not in before}
        # A module's file, or the folder of a package, lies directly in this folder.
        beside = {
            name
            for name, module in new.items()
            for place in (*getattr(module, "__path__", ()), getattr(module, "__file__", None))
            if place and Path(place).parent == folder
        }
        for name in new:
            if name.partition(".")[0] in beside:
                del sys.modules[name]


# What is added to a model on the command line.


def with_asked(model: "Model", elements: "Elements") -> "Model":
    """The model with the elements that settings add to it.

    **Raises:** `ModelError` as each element does, and for an unknown kind.
    """
    from riecjax.elements.catalogue import as_element_class, element_class

    asked: list[tuple[str, str, float | None]] = [("zero", of, None) for of in elements.offsets_of]
    asked += [("gain", signal, None) for signal in elements.gains_of]
    asked += [("mode", signal, hertz) for signal, hertz in elements.modes]
    asked += [("spring", coefficient, None) for coefficient in elements.springs]
    asked += elements.added
    added = []
    for kind, place, near in asked:
        of = as_element_class(kind, object_of_file(kind)) if ".py" in kind else element_class(kind)
        with users_code(f"the element {of.__name__}"):
            added.append(of.at(place, near))
    # A sensor has one zero and one gain, however often it is asked for.
    once = dict.fromkeys(one for one in added if not one.coordinates)
    model = model.with_elements(*once, *(one for one in added if one.coordinates))
    return model.solved_together() if elements.together else model
