"""Results in files: an estimate with its Summary, and what `riecjax identify --out` wrote."""

import contextlib
import dataclasses
import json
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from riecjax import shows
from riecjax.arrays import is_concrete
from riecjax.errors import DataError, ModelError, printable
from riecjax.estimation.estimate import Estimate, RefinementStatus, Search
from riecjax.estimation.parameters import TABLE_KINDS
from riecjax.estimation.stages import EquationFit, Solution, StageSolution
from riecjax.findings import Finding
from riecjax.reporting.answer import Answer, read
from riecjax.reporting.document import is_intact, unread_schema
from riecjax.summaries import summary as summaries
from riecjax.summaries import summary_files
from riecjax.summaries.summary_files import naming
from riecjax.uncertainty.intervals import Uncertainty
from riecjax.whole_files import no_file, read_plain

OF_FITS = Estimate, Search, Uncertainty, StageSolution, Solution, EquationFit, Finding
STATUS = RefinementStatus, type(RefinementStatus.converged)
KIND = summary_files.FileKind("estimate", 3, (*OF_FITS, *STATUS, *TABLE_KINDS, *summaries.CLASSES))
"""The file of an estimate, and what that is made of beside arrays and names."""
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
            holds_an_estimate = f"{KIND.name}.npy" in archive.namelist()
        if holds_an_estimate:
            return summary_files.load(file, KIND)
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
    """Write an estimate to a file; see [`Estimate.save`][riecjax.Estimate.save]."""
    if not is_concrete(estimate):
        raise ModelError("an estimate that jax.jit is making is saved outside of it.")
    if estimate.batch_shape:
        raise ModelError("estimates of a batch are saved one by one: batch.member(0).save(path).")
    if estimate.search is not None:  # the recordings that its residuals are of are not kept
        search = dataclasses.replace(estimate.search, residuals=None)
        estimate = dataclasses.replace(estimate, search=search)
    summary_files.save(estimate, path, KIND)
