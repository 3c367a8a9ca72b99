"""Results in files: an estimate with its Summary, and what `riecjax identify --out` wrote."""

import contextlib
import dataclasses
import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from riecjax import shows
from riecjax.criteria.criterion import AbstractCriterion, criterion_from_plain_data, to_plain_data
from riecjax.errors import DataError, ModelError, printable
from riecjax.estimation.estimate import Estimate, RefinementStatus, Search
from riecjax.estimation.parameters import TABLE_KINDS, table_of_names
from riecjax.estimation.stages import EquationFit, Solution, StageSolution
from riecjax.findings import Finding
from riecjax.leaves import is_concrete
from riecjax.refinement.objective import AbstractResiduals
from riecjax.reporting.answer import Answer, read
from riecjax.reporting.document import Document, is_intact, unread_schema
from riecjax.summaries import summary as summaries
from riecjax.summaries.summary import Summary
from riecjax.summaries.summary_files import naming, packed, read_checked, unpacked, write_checked
from riecjax.uncertainty.intervals import Uncertainty
from riecjax.whole_files import no_file, read_plain

NAME = "estimate"
"""Name of the JSON document among the arrays."""
FORMAT = "riecjax.Estimate"
SCHEMA = 2
"""Of what the file of an estimate holds; another one is refused."""
OF_FITS = Estimate, Search, Uncertainty, StageSolution, Solution, EquationFit, Finding
KINDS = (*OF_FITS, *TABLE_KINDS)
"""What an estimate is made of, beside arrays, names, a criterion and a Summary."""
RESULTS = "results.json"


def load(path: str | os.PathLike[str]) -> Any:
    """Read what was saved: an estimate, a Summary, or results.json of the command line.

    An estimate has the same values, intervals of any level and findings as the one that was saved;
    a Summary is equal to the bit. Of `riecjax identify --out DIR`, DIR or its results.json gives
    [`Answer`][riecjax.reporting.Answer]. A test function, or another part of a criterion, that is
    not this library's must be defined before: import its module.

    **Raises:** `DataError`, in one line, for a file that is not there, is none of these, is
    damaged, was written with another schema, or names a class that is not defined.
    """
    if isinstance(path, str | os.PathLike):
        file = Path(path)
        with _unreadable(file):
            if not (file.is_dir() or file.is_file()) and file.exists():
                raise OSError(0, "it is no plain file")
        if file.is_dir() or file.suffix == ".json":
            return _results(file / RESULTS if file.is_dir() else file)
        holds_an_estimate = False
        # Whatever a damaged archive leads to, its reader says what is wrong.
        with contextlib.suppress(Exception), zipfile.ZipFile(file) as archive:
            holds_an_estimate = f"{NAME}.npy" in archive.namelist()
        if holds_an_estimate:
            document, arrays = read_checked(file, NAME, FORMAT, SCHEMA)
            with naming(file, NAME):
                estimate = _unpack(document["estimate"], arrays)
                place = "summary/"
                if document["summary"] is None:
                    return estimate
                kept = {n.removeprefix(place): a for n, a in arrays.items() if n.startswith(place)}
                summary = Summary(**unpacked(document["summary"], kept))
                return dataclasses.replace(estimate, summary=summary)
    return summaries.load(path)


@contextlib.contextmanager
def _unreadable(file: Path) -> Iterator[None]:
    """Errors of the system, and of text that is none, as `DataError` of one line."""
    try:
        yield
    except OSError as error:
        raise DataError(f"cannot read '{printable(str(file))}': {error.strerror}.") from None
    except UnicodeDecodeError as error:
        raise DataError(f"cannot read '{file}': byte {error.start} is not UTF-8.") from None


def _results(file: Path) -> Answer:
    if not os.path.isfile(file):
        raise DataError(no_file(file))
    with _unreadable(file):
        text = read_plain(file).decode()
    with naming(file, "results"):
        try:
            document = json.loads(text)
        except json.JSONDecodeError as error:
            raise DataError(f"it is damaged, or no JSON: {error}.") from None
        if not isinstance(document, dict) or "schema" not in document:
            raise DataError("it is no results.json, which riecjax identify --out DIR writes.")
        if why := unread_schema(document["schema"]):
            raise DataError(f"{why}: use the version of riecjax that wrote it.")
        if not is_intact(document):
            raise DataError("it is damaged or was changed: its checksum differs. Make it anew.")
        if "error" in document:
            raise DataError(f"it holds no answer: {document['error']['message']}")
        if lacking := {"model", "criterion", "parameters", "known", "warnings"} - {*document}:
            raise DataError(
                f"it lacks {', '.join(sorted(lacking))}: it is not what riecjax identify writes."
            )
        try:
            return read(Answer, document)
        except msgspec.ValidationError as error:
            raise DataError(f"it is not what riecjax identify writes: {error}.") from None


@shows.save.register
def save(estimate: Estimate, path: str | os.PathLike[str]) -> None:
    """Write an estimate to a file; see [`Saved.save`][riecjax.shows.Saved.save]."""
    if not is_concrete(estimate):
        raise ModelError("an estimate that jax.jit is making is saved outside of it.")
    if estimate.batch_shape:
        raise ModelError("estimates of a batch are saved one by one: batch.member(0).save(path).")
    document: Document = {"format": FORMAT, "schema": SCHEMA, "riecjax": version("riecjax")}
    document["summary"] = None
    arrays: dict[str, np.ndarray] = {}
    if estimate.summary is not None:
        document["summary"], of_summary = packed(**vars(estimate.summary))
        arrays |= {f"summary/{name}": array for name, array in of_summary.items()}
    document["estimate"] = _pack(estimate, NAME, arrays)
    write_checked(path, NAME, document, arrays)


def _pack(value: Any, place: str, arrays: dict[str, np.ndarray]) -> Any:
    """A value as plain data, its arrays under their places."""
    kind = type(value)
    if kind in KINDS:
        names = getattr(value, "_fields", None) or [f.name for f in dataclasses.fields(value)]
        fields = {name: _pack(getattr(value, name), f"{place}/{name}", arrays) for name in names}
        return {"kind": kind.__name__, "fields": fields}
    if isinstance(value, AbstractCriterion):
        return {"criterion": to_plain_data(value)}
    if getattr(value, "_enumeration", None) is RefinementStatus:
        return {"status": _pack(value._value, place, arrays)}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        arrays[place] = np.asarray(value)
        return {"array": place}
    if isinstance(value, tuple | list):
        parts = [_pack(each, f"{place}/{i}", arrays) for i, each in enumerate(value)]
        return {"list" if isinstance(value, list) else "tuple": parts}
    if isinstance(value, dict):
        return {"dict": {key: _pack(v, f"{place}/{key}", arrays) for key, v in value.items()}}
    # The Summary has a document of its own, and what a search made small is not kept.
    return None if isinstance(value, Summary | AbstractResiduals) else value


def _unpack(value: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """What [`_pack`][] made plain."""
    if not isinstance(value, dict):
        return value
    if "kind" in value:
        fields = {name: _unpack(of, arrays) for name, of in value["fields"].items()}
        if "units" in fields:  # written before there were tables
            beside = (fields.pop(name) for name in ("parameters", "units", "known"))
            fields["table"] = table_of_names(*beside)
        if value["kind"] == "Refined":  # written when that was another kind of estimate
            names = {field.name for field in dataclasses.fields(Search)}
            search = Search(**{name: fields.pop(name) for name in names & {*fields}})
            return Estimate(**fields, search=search)
        if value["kind"] == "Estimate":  # bounds held in refinement alone
            fields.setdefault("at_bound", np.zeros(fields["theta"].shape, bool))
        return {kind.__name__: kind for kind in KINDS}[value["kind"]](**fields)
    ((of, held),) = value.items()
    match of:
        case "criterion":
            return criterion_from_plain_data(held)
        case "status":
            number = _unpack(held, arrays)
            return eqx.tree_at(lambda s: s._value, RefinementStatus.converged, jnp.asarray(number))
        case "array":
            return arrays[held]
        case "dict":
            return {key: _unpack(each, arrays) for key, each in held.items()}
        case _:
            parts = [_unpack(each, arrays) for each in held]
            return parts if of == "list" else tuple(parts)
