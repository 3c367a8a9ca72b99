"""From what a user calls a model to the model."""

import importlib.util
import sys
from pathlib import Path

from riecjax.equations.equation import Equation
from riecjax.errors import ModelError, users_code
from riecjax.estimation.procedure import Procedure
from riecjax.models.catalogue import built_in_model
from riecjax.models.model import Model, Quantity


def find_model(reference: str) -> Model:
    """A built-in model by name, or `path/to/file.py:object` of the user's own.

    The object may be a `Model`, an `Equation`, a `Procedure`, or a function without arguments
    that returns one of these.

    **Raises:** `ModelError` if there is no such model, file or object.
    """
    path, separator, attribute = reference.rpartition(":")
    if not separator or not path.endswith(".py"):
        return built_in_model(reference)
    found = _load(Path(path), attribute)
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


def _load(path: Path, attribute: str) -> object:
    if not path.is_file():
        raise ModelError(f"there is no file '{path}'.")
    spec = importlib.util.spec_from_file_location(f"riecjax_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ModelError(f"'{path}' is not a Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    with users_code(path):
        spec.loader.exec_module(module)
    if not hasattr(module, attribute):
        raise ModelError(f"{path} has no object '{attribute}'.")
    return getattr(module, attribute)
