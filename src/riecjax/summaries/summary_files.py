"""Objects in NPZ files: arrays by name, and one JSON document of all that is no array.

An object is its class's name and its fields, objects within objects, so that arrays are called by
where they stand, as `recordings/0/stages/1/0/moments`. The document, an array of bytes, holds the
rest and a checksum of everything. A file names classes and never imports them: what is read is
looked for among those that the running program has defined, so that a new test function needs
nothing here. There is no pickle, and no constructor is called: reading a file runs no code of it.
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
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from riecjax.errors import DataError, ModelError, require
from riecjax.records.reading.channels import foreign_reader, read_array
from riecjax.records.writing import write_npz
from riecjax.whole_files import no_file, write_file

LARGEST = 2**31
"""Bytes that a file may unpack to: it is refused by what it declares, before it is read."""
HEADER = 256
"""Bytes at most that stand before an array's numbers: 64 or 128 for so few axes."""

Arrays = dict[str, np.ndarray]
Document = dict[str, Any]


class FileKind(NamedTuple):
    """What is kept in files of a kind.

    **Fields:** `name` of what it is, and of the document; its `schema`: another one is refused;
    `classes` that it is made of, these or subclasses of them.
    """

    name: str
    schema: int
    classes: tuple[type, ...]


def save(value: Any, path: str | os.PathLike[str], kind: FileKind) -> None:
    """Write an object to a file.

    **Raises:** `DataError` if the file cannot be written; `ModelError` for more than 2 GiB, and
    for what is code rather than numbers.
    """
    file = _path(path)
    document, arrays = _packed(value, kind)
    arrays[kind.name] = np.frombuffer(json.dumps(document).encode(), np.uint8)
    if (size := sum(array.nbytes + HEADER for array in arrays.values())) > LARGEST:
        raise ModelError(
            f"this {kind.name} takes {size} bytes, and a file may hold {LARGEST}: save its "
            f"recordings apart, summary.select(0).save(...), or make it with fewer bins."
        )
    write_file(file, lambda temporary: write_npz(temporary, arrays))


def load(path: str | os.PathLike[str], kind: FileKind) -> Any:
    """The object in a file.

    **Raises:** `DataError`, in one line, for a file that is not there, is damaged or of another
    kind.
    """
    file = _path(path)
    if not file.is_file():
        raise DataError(no_file(file))
    with naming(file, kind.name), zipfile.ZipFile(file) as archive:
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
        document: Any = json.loads(read(kind.name).tobytes()) if kind.name in members else None
        _require_schema(document, kind)
        return _unpacked(
            document, {each: read(each) for each in members if each != kind.name}, kind
        )


def to_bytes(value: Any, kind: FileKind) -> bytes:
    """An object as bytes, the same for the same numbers, without a file's overhead.

    Its length in eight bytes, the document, which lists the arrays, and their numbers; of symmetric
    matrices those of one half.
    """
    document, arrays = _packed(value, kind)
    listed, numbers = [], []
    for name, array in sorted(arrays.items()):
        halved = array.ndim > 1 and array.shape[-1] == array.shape[-2] > 1
        if halved:  # where matrices are, to the bit, their own transposes
            bits = np.ascontiguousarray(array).view(f"V{array.dtype.itemsize}")
            halved = bool((bits == bits.swapaxes(-1, -2)).all())
        listed.append((name, array.dtype.str, array.shape, halved))
        kept = array[..., *_upper(array.shape[-1])] if halved else array
        numbers.append(np.ascontiguousarray(kept).tobytes())
    text = json.dumps({**document, "arrays": listed}).encode()
    return b"".join([len(text).to_bytes(8, "little"), text, *numbers])


def from_bytes(content: bytes, kind: FileKind) -> Any:
    """The object in these bytes.

    **Raises:** `DataError` where they are damaged or of another version.
    """
    with foreign_reader(kind.name.capitalize()):
        place = 8 + int.from_bytes(content[:8], "little")
        document = json.loads(content[8:place])
        _require_schema(document, kind)
        arrays = {}
        for name, dtype_name, shape, halved in document.pop("arrays"):
            dtype = np.dtype(dtype_name)
            kept = (*shape[:-2], shape[-1] * (shape[-1] + 1) // 2) if halved else tuple(shape)
            size = math.prod(kept)
            array = np.frombuffer(content, dtype, size, place).reshape(kept)
            if halved:  # upper halves of symmetric matrices, row by row
                (rows, columns), half = _upper(shape[-1]), array
                array = np.empty(shape, dtype)
                array[..., rows, columns] = array[..., columns, rows] = half
            arrays[name] = array
            place += size * dtype.itemsize
        return _unpacked(document, arrays, kind)


# Looked up for every recording of a fleet, in which all are of a few sizes; a version takes longer
# to look up than all else of a small Summary.
_upper = functools.lru_cache(maxsize=64)(np.triu_indices)
_version_of = functools.cache(version)


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


def _require_schema(document: Any, kind: FileKind) -> None:
    name = kind.name
    if not isinstance(document, dict) or document.get("format") != f"riecjax.{name.capitalize()}":
        raise DataError(f"it is no {name.capitalize()}, of which {name}.save(path) makes a file.")
    if document["schema"] != kind.schema:
        raise DataError(
            f"it was written with schema {document['schema']}, this version reads {kind.schema}: "
            f"make it anew, or use riecjax {document['riecjax']}."
        )


def _packed(value: Any, kind: FileKind) -> tuple[Document, Arrays]:
    """An object as a document, with a checksum, and arrays."""
    arrays: Arrays = {}
    document = {
        "format": f"riecjax.{kind.name.capitalize()}",
        "schema": kind.schema,
        "riecjax": _version_of("riecjax"),
        kind.name: _to_plain_data(value, "", arrays, kind.classes),
    }
    return {**document, "checksum": _checksum(document, arrays)}, arrays


def _unpacked(document: Document, arrays: Arrays, kind: FileKind) -> Any:
    """The object of a document and arrays, which are in this machine's order of bytes then, and may
    be written to."""
    if document.pop("checksum") != _checksum(document, arrays):
        raise DataError("it is damaged: its checksum differs. Copy it again, or make it anew.")
    native = {n: a.astype(a.dtype.newbyteorder("="), order="C") for n, a in arrays.items()}
    value = _from_plain_data(document[kind.name], "", native, kind.classes)
    if not isinstance(value, kind.classes[0]):
        raise DataError(f"it holds no {kind.name.capitalize()}.")
    if native:
        raise DataError("its arrays are not those that it lists.")
    return value


def _checksum(document: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of the document and of every array's name, dtype, shape and bytes."""
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _to_plain_data(value: Any, place: str, arrays: Arrays, classes: tuple[type, ...]) -> Any:
    """A value as what JSON has words for: `{"class": name, "from": module, field: value, ...}` of
    an object, `{dtype: value}` of an array without axes, and otherwise that there is one, which is
    put among the arrays under its place.

    A tuple is a list there, and whatever else there is says what it is by one key.

    **Raises:** `ModelError` for what is code rather than numbers.
    """

    def part(each: Any, name: object) -> Any:
        return _to_plain_data(each, f"{place}/{name}" if place else str(name), arrays, classes)

    if isinstance(value, classes):
        fields = {name: part(getattr(value, name), name) for name in _fields(type(value))}
        return {"class": type(value).__name__, "from": type(value).__module__} | fields
    if isinstance(value, np.ndarray | np.generic | jax.Array) and value.dtype.kind in "fiub":
        if not value.ndim:
            return {str(value.dtype): value.item()}
        arrays[place] = np.asarray(value)
        return {"array": value.ndim}
    if isinstance(value, tuple | list):
        parts = [part(each, number) for number, each in enumerate(value)]
        return {"list": parts} if isinstance(value, list) else parts
    if isinstance(value, Mapping):
        return {"dict": {key: part(each, key) for key, each in value.items()}}
    if isinstance(value, type) and issubclass(value, classes):
        return {"type": value.__name__}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ModelError(f"{place} is code, which no file can hold: give numbers in its place.")


def _from_plain_data(value: Any, place: str, arrays: Arrays, classes: tuple[type, ...]) -> Any:
    """What [`_to_plain_data`][] made plain.

    **Raises:** `DataError` for a class that is not defined here, or one with other fields.
    """

    def part(each: Any, name: object) -> Any:
        return _from_plain_data(each, f"{place}/{name}" if place else str(name), arrays, classes)

    if isinstance(value, list):
        return tuple(part(each, number) for number, each in enumerate(value))
    if not isinstance(value, dict):
        return value
    if "class" in value:
        name, kind = value["class"], _class(value["class"], value["from"], classes)
        fields = {n: part(each, n) for n, each in value.items() if n not in ("class", "from")}
        if {*fields} != {*_fields(kind)}:
            raise DataError(f"its {name} has other settings than the one of this name here.")
        if not issubclass(kind, eqx.Module):
            return kind(**fields)
        # As JAX puts modules together: what their constructors would check or convert was so.
        module = object.__new__(kind)
        for field, each in fields.items():
            object.__setattr__(module, field, each)
        return module
    ((key, kept),) = value.items()
    match key:
        case "array":
            if place not in arrays:
                raise DataError("its arrays are not those that it lists.")
            return arrays.pop(place)
        case "list":
            return [part(each, number) for number, each in enumerate(kept)]
        case "dict":
            return {name: part(each, name) for name, each in kept.items()}
        case "type":
            return _class(kept, "", classes)
        case _:
            return np.array(kept, key)


def _fields(kind: type) -> tuple[str, ...]:
    if dataclasses.is_dataclass(kind):
        return tuple(field.name for field in dataclasses.fields(kind))
    return kind._fields  # pyright: ignore[reportAttributeAccessIssue]


def _class(name: str, module: str, classes: tuple[type, ...]) -> type:
    """The class of this name, as it was defined last; of several modules', that of `module`."""
    found = {kind.__module__: kind for kind in _subclasses(classes) if kind.__name__ == name}
    if module not in found and len(found) != 1:
        raise DataError(
            f"it was made with {name} of '{module}', a class that is not defined here: import the "
            f"module that defines it first."
        )
    return found.get(module) or next(iter(found.values()))


def _subclasses(classes: tuple[type, ...]) -> Iterator[type]:
    """Classes with all below them."""
    for kind in classes:
        yield kind
        yield from _subclasses(tuple(kind.__subclasses__()))
