"""A Summary in an NPZ file: arrays by name, and one JSON document of all that is no array.

Names are paths, as in `0/stages/1/0/moments`: recording, stage, equation, field. The document, an
array of bytes called `summary`, holds the rest and a checksum of everything. There is no pickle:
reading a file runs no code of it.
"""

import contextlib
import dataclasses
import functools
import hashlib
import json
import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from riecjax.criteria.criterion import (
    AbstractCriterion,
    criterion_from_plain_data,
    to_plain_data,
)
from riecjax.errors import DataError, ModelError, require
from riecjax.leaves import Leaf, is_concrete
from riecjax.records.reading.channels import foreign_reader, read_array
from riecjax.records.signal import Noise
from riecjax.records.writing import write_npz
from riecjax.summaries.normal_equations import EquationSums, Outline, RecordingSums, Survey
from riecjax.whole_files import no_file, write_file

DOCUMENT = "summary"
"""Name of the JSON document among the arrays."""
EDGES = "edges"
"""Name of the array of the bins' edges."""
FORMAT = "riecjax.Summary"
SCHEMA = 5
"""Of what a Summary holds; another one is refused."""
LARGEST = 2**31
"""Bytes that a file may unpack to: it is refused by what it declares, before it is read."""
HEADER = 256
"""Bytes at most that stand before an array's numbers: 64 or 128 for so few axes."""

Arrays = dict[str, np.ndarray]
Document = dict[str, Any]


def read_parts(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The fields of the Summary in a file; see [`load`][]."""
    document, arrays = read_checked(path, DOCUMENT, FORMAT, SCHEMA)
    with naming(Path(path), DOCUMENT):
        return unpacked(document, arrays)


def to_bytes(document: Document, arrays: Arrays) -> bytes:
    """A packed Summary as bytes, the same for the same numbers, without a file's overhead.

    Its length in eight bytes, the document, which lists the arrays, and their numbers; of symmetric
    matrices those of one half.
    """
    listed, numbers = [], []
    for name, array in sorted(arrays.items()):
        halved = array.ndim > 1 and array.shape[-1] == array.shape[-2] > 1
        if halved:  # where matrices are, to the bit, their own transposes
            bits = np.ascontiguousarray(array).view(f"V{array.dtype.itemsize}")
            halved = bool((bits == bits.swapaxes(-1, -2)).all())
        listed.append((name, array.dtype.str, array.shape, halved))
        kept = array[..., *_upper(array.shape[-1])] if halved else array
        numbers.append(np.ascontiguousarray(kept).tobytes())
    told = {**document, "checksum": _checksum(document, arrays), "arrays": listed}
    text = json.dumps(told).encode()
    return b"".join([len(text).to_bytes(8, "little"), text, *numbers])


def from_bytes(content: bytes) -> dict[str, Any]:
    """The fields of the Summary in these bytes.

    **Raises:** `DataError` where they are damaged or of another version.
    """
    with foreign_reader(DOCUMENT.capitalize()):
        place = 8 + int.from_bytes(content[:8], "little")
        document = json.loads(content[8:place])
        _require_schema(document, DOCUMENT, FORMAT, SCHEMA)
        arrays = {}
        for name, kind, shape, halved in document.pop("arrays"):
            dtype = np.dtype(kind)
            kept = (*shape[:-2], shape[-1] * (shape[-1] + 1) // 2) if halved else tuple(shape)
            size = math.prod(kept)
            array = np.frombuffer(content, dtype, size, place).reshape(kept)
            if halved:  # upper halves of symmetric matrices, row by row
                (rows, columns), half = _upper(shape[-1]), array
                array = np.empty(shape, dtype)
                array[..., rows, columns] = array[..., columns, rows] = half
            arrays[name] = array
            place += size * dtype.itemsize
        if document.pop("checksum") != _checksum(document, arrays):
            raise DataError("it is damaged: its checksum differs. Make it anew.")
        return unpacked(document, {name: _native(array) for name, array in arrays.items()})


# Looked up for every recording of a fleet, in which all are of a few sizes; a version takes longer
# to look up than all else of a small Summary.
_upper = functools.lru_cache(maxsize=64)(np.triu_indices)
version_of = functools.cache(version)


def packed(
    recordings: tuple[RecordingSums, ...],
    criterion: AbstractCriterion,
    outline: Outline,
    edges: Leaf | None,
    in_law: tuple[int, int],
    band: tuple[int, int],
    asked: tuple[float, float] | None,
) -> tuple[Document, Arrays]:
    """The fields of a Summary as a document and arrays.

    **Raises:** `ModelError` for what is traced or of a batch.
    """
    is_batch = any(np.ndim(sums.blocks) for sums in recordings)
    if is_batch or not is_concrete(recordings, criterion, edges):
        raise ModelError(
            "sums of jax.jit or jax.vmap are saved outside of it, and one by one of a batch."
        )
    leaves, _ = jax.tree_util.tree_flatten_with_path(recordings)
    arrays = {_name(place): np.asarray(leaf) for place, leaf in leaves}
    if edges is not None:
        arrays[EDGES] = np.asarray(edges)
    document = {
        "format": FORMAT,
        "schema": SCHEMA,
        "riecjax": version_of("riecjax"),
        "dtype": str(recordings[0].stages[0][0].moments.dtype),
        "stages": outline.stages,
        "parameters": outline.parameters,
        "units": outline.units,
        "fingerprint": outline.fingerprint,
        "bins": edges is not None,
        "in_law": in_law,
        "band": band,
        "asked": asked,
        "criterion": to_plain_data(criterion),
        "recordings": [
            {
                # Of what there may be, whether there is; of a survey, whose reaches it has.
                "stages": [
                    [
                        {
                            "parameters": equation.parameters,
                            "survey": None if (s := equation.survey) is None else sorted(s.reach),
                            "factor": equation.factor is not None,
                            "noise": equation.noise is not None,
                            "constant": equation.constant is not None,
                        }
                        for equation in stage
                    ]
                    for stage in one.stages
                ],
                "noise": {signal: sorted(of) for signal, of in one.noise.kernels.items()},
            }
            for one in recordings
        ],
    }
    return document, arrays


def write_checked(
    path: str | os.PathLike[str], name: str, document: Document, arrays: Arrays
) -> None:
    """Write a document under this name, with a checksum of all, and arrays to an NPZ file.

    **Raises:** `DataError` if the file cannot be written; `ModelError` for more than 2 GiB.
    """
    file = _path(path)
    text = json.dumps({**document, "checksum": _checksum(document, arrays)}).encode()
    arrays = {**arrays, name: np.frombuffer(text, np.uint8)}
    if (size := sum(array.nbytes + HEADER for array in arrays.values())) > LARGEST:
        raise ModelError(
            f"this {name} takes {size} bytes, and a file may hold {LARGEST}: save its recordings "
            f"apart, summary.select(0).save(...), or make it with fewer bins."
        )
    write_file(file, lambda temporary: write_npz(temporary, arrays))


def read_checked(
    path: str | os.PathLike[str], name: str, kind: str, schema: int
) -> tuple[Document, Arrays]:
    """The document under this name, of this kind and schema, and the arrays beside it.

    **Raises:** `DataError`, in one line, for a file that is not there, is damaged or of another
    kind.
    """
    file = _path(path)
    if not file.is_file():
        raise DataError(no_file(file))
    with naming(file, name), zipfile.ZipFile(file) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        if sum(member.file_size for member in archive.infolist()) > LARGEST:
            raise DataError(f"declares to unpack to more than {LARGEST} bytes, and is not read.")

        def read(each: str) -> np.ndarray:
            with archive.open(members[each]) as stream:
                array = read_array(stream, members[each].file_size)
            if array is None:
                raise ValueError("it holds Python objects.")
            return array

        # Sizes, schema and checksum are seen to be right before anything is made of it.
        document: Any = json.loads(read(name).tobytes()) if name in members else None
        _require_schema(document, name, kind, schema)
        arrays = {each: read(each) for each in members if each != name}
        if document.pop("checksum") != _checksum(document, arrays):
            raise DataError("it is damaged: its checksum differs. Copy it again, or make it anew.")
        return document, {each: _native(array) for each, array in arrays.items()}


@contextlib.contextmanager
def naming(file: Path, name: str) -> Iterator[None]:
    """Any error about the contents of a file is a `DataError` of one line that names it."""
    try:
        with foreign_reader(name.capitalize()):
            yield
    except DataError as error:
        raise DataError(" ".join(f"{file.name}: {error}".split())) from None


def _path(path: str | os.PathLike[str]) -> Path:
    require("the file", path, (str, os.PathLike), "its name, 'recording.npz'", DataError)
    return Path(path)


def _name(path: tuple[Any, ...]) -> str:
    return jax.tree_util.keystr(path, simple=True, separator="/")


def _checksum(document: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of the document and of every array's name, dtype, shape and bytes."""
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _native(array: np.ndarray) -> np.ndarray:
    """The array in this machine's order of bytes, and one that may be written to."""
    return array.astype(array.dtype.newbyteorder("="), order="C")


def _require_schema(document: Any, name: str, kind: str, schema: int) -> None:
    if not isinstance(document, dict) or document.get("format") != kind:
        raise DataError(f"it is no {name.capitalize()}, of which {name}.save(path) makes a file.")
    if document["schema"] != schema:
        raise DataError(
            f"it was written with schema {document['schema']}, this version reads {schema}: make "
            f"it anew, or use riecjax {document['riecjax']}."
        )


def unpacked(document: Document, arrays: Arrays) -> dict[str, Any]:
    """The fields of the Summary with this document and these arrays."""
    edges = arrays.pop(EDGES) if document["bins"] else None
    names, structure = _frame(json.dumps(document["recordings"]))
    if set(names) != set(arrays):
        raise DataError("its arrays are not those that it lists.")
    stages = tuple(
        tuple((name, tuple(parameters)) for name, parameters in stage)
        for stage in document["stages"]
    )
    units, fingerprint = tuple(map(tuple, document["units"])), str(document["fingerprint"])
    return {
        "recordings": jax.tree.unflatten(structure, [arrays[name] for name in names]),
        "criterion": criterion_from_plain_data(document["criterion"]),
        "outline": Outline(stages, tuple(document["parameters"]), units, fingerprint),
        "edges": edges,
        "in_law": tuple(document["in_law"]),
        "band": tuple(document["band"]),
        "asked": None if document["asked"] is None else tuple(document["asked"]),
    }


@functools.lru_cache(maxsize=64)
def _frame(recordings: str) -> tuple[list[str], Any]:
    """Names of the arrays of recordings that are described so, and how they hang together."""
    empty = tuple(_skeleton(**one) for one in json.loads(recordings))
    paths, structure = jax.tree_util.tree_flatten_with_path(empty)
    return [_name(path) for path, _ in paths], structure


def _skeleton(stages: list[list[Document]], noise: dict[str, list[str]]) -> RecordingSums:
    """Sums of a recording with a zero in place of every array that there is."""

    def zeros(kind: type, **others: Any) -> Any:
        names = [field.name for field in dataclasses.fields(kind)]
        return kind(**dict.fromkeys(names, 0) | others)

    def of(equation: Document) -> EquationSums:
        reach = equation["survey"]
        return zeros(
            EquationSums,
            survey=None if reach is None else zeros(Survey, reach=dict.fromkeys(reach, 0)),
            factor=0 if equation["factor"] else None,
            noise=0 if equation["noise"] else None,
            noise_of_source=0 if equation["noise"] else None,
            constant=0 if equation["constant"] else None,
            parameters=tuple(equation["parameters"]),
        )

    anything: Any = 0  # what is read takes its place
    kernels = {signal: {source: anything for source in of} for signal, of in noise.items()}
    return zeros(
        RecordingSums,
        stages=tuple(tuple(of(e) for e in stage) for stage in stages),
        noise=Noise(kernels),
    )
