"""From what a user calls a model to the model."""

import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from riecjax.equations.equation import Equation
from riecjax.errors import ModelError, require, users_code
from riecjax.estimation.procedure import Procedure
from riecjax.models.catalogue import built_in_model
from riecjax.models.model import Model, Quantity


def find_model(reference: str) -> Model:
    """A built-in model by name, or `path/to/file.py:object` of the user's own.

    The object may be a `Model`, an `Equation`, a `Procedure`, or a function without arguments
    that returns one of these. It need not be named where the file holds one such object: one
    `Model`, or else one `Equation` or `Procedure` that is no part of another.

    **Raises:** `ModelError` if there is no such model, file or object.
    """
    require("the model's name", reference, str, "such as rx.find_model('quarter-car')")
    path, separator, attribute = reference.rpartition(":")
    if reference.endswith(".py"):
        path = reference
        module = _load(Path(path))
        attribute = _only_model(path, vars(module))
    elif not separator or not path.endswith(".py"):
        return built_in_model(reference)
    else:
        module = _load(Path(path))
    if not hasattr(module, attribute):
        raise ModelError(f"{path} has no object '{attribute}'.")
    found = getattr(module, attribute)
    if not isinstance(found, Model | Equation | Procedure) and callable(found):
        with users_code(path):
            found = found()
    if isinstance(found, Model):
        return found
    if isinstance(found, Equation | Procedure):
        return _model_of(attribute, found)
    raise ModelError(
        f"'{attribute}' in {path} is not a Model, an Equation or a Procedure, nor a function that "
        f"returns one."
    )


def _model_of(name: str, found: Equation | Procedure) -> Model:
    units = found.units
    parameters = tuple(Quantity(p, units.get(p, ""), "") for p in found.parameters)
    return Model(name, "your own equation", procedure=lambda: found, parameters=parameters)


def _only_model(path: str, objects: Mapping[str, object]) -> str:
    """The name of the one model in a file."""
    public = {name: thing for name, thing in objects.items() if not name.startswith("_")}
    procedures = [thing for thing in public.values() if isinstance(thing, Procedure)]
    parts = {id(e) for procedure in procedures for stage in procedure.stages for e in stage}
    models = [thing for thing in public.values() if isinstance(thing, Model)]
    whole = models or [
        thing
        for thing in public.values()
        if isinstance(thing, Equation | Procedure) and id(thing) not in parts
    ]
    # One object may have two names.
    names = {id(thing): name for name, thing in public.items()}
    found = list(dict.fromkeys(names[id(thing)] for thing in whole))
    if len(found) == 1:
        return found[0]
    if not found:
        raise ModelError(
            f"{path} holds no Model, Equation or Procedure. Give one a name there, or name the "
            f"function that returns one: {path}:NAME."
        )
    raise ModelError(
        f"{path} holds {len(found)} models: {', '.join(found)}. Say which: {path}:{found[0]}."
    )


def _load(path: Path) -> ModuleType:
    if not path.is_file():
        raise ModelError(f"there is no file '{path}'.")
    spec = importlib.util.spec_from_file_location(f"riecjax_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ModelError(f"'{path}' is not a Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    with users_code(path):
        spec.loader.exec_module(module)
    return module
