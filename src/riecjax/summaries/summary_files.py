"""Objects in NPZ files: arrays by name, and one JSON document of all that is no array.

An object is its class's name and its fields, objects within objects, so that arrays are called by
where they stand, as `recordings/0/stages/1/0/moments`. The document, an array of bytes, holds the
rest and a checksum of everything. A file names classes and never imports them: what is read is
looked for among those that the running program has defined, so that a new test function needs
nothing here. No constructor is called: reading a file runs no code of it.
"""

import contextlib
import dataclasses
import functools
import hashlib
import io
import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any, NamedTuple

import jax
import numpy as np

from riecjax.errors import DataError, ModelError, require
from riecjax.records.reading.channels import foreign_reader, read_array
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
    arrays = _packed(value, kind)
    write_file(_path(path), lambda temporary: _write(temporary, arrays, zipfile.ZIP_DEFLATED))


def to_bytes(value: Any, kind: FileKind) -> bytes:
    """What a file would hold, the same for the same numbers; it is left to others to compress it.

    **Raises:** `ModelError` as [`save`][].
    """
    stream = io.BytesIO()
    _write(stream, _packed(value, kind), zipfile.ZIP_STORED)
    return stream.getvalue()


def load(path: str | os.PathLike[str], kind: FileKind) -> Any:
    """The object in a file.

    **Raises:** `DataError`, in one line, for a file that is not there, is damaged or of another
    kind.
    """
    file = _path(path)
    if not file.is_file():
        raise DataError(no_file(file))
    with naming(file, kind.name):
        return _read(file, kind)


def from_bytes(content: bytes, kind: FileKind) -> Any:
    """The object in these bytes.

    **Raises:** `DataError` where they are damaged or of another version.
    """
    with foreign_reader(kind.name.capitalize()):
        return _read(io.BytesIO(content), kind)


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


# To look it up takes longer than all else of a small Summary.
_version_of = functools.cache(version)


def _packed(value: Any, kind: FileKind) -> Arrays:
    """An object's arrays, and the document as one of them."""
    arrays: Arrays = {}
    document = {
        "format": f"riecjax.{kind.name.capitalize()}",
        "schema": kind.schema,
        "riecjax": _version_of("riecjax"),
        kind.name: _to_plain_data(value, "", arrays, kind.classes),
    }
    document["checksum"] = _checksum(document, arrays)
    arrays[kind.name] = np.frombuffer(json.dumps(document).encode(), np.uint8)
    if (size := sum(array.nbytes + HEADER for array in arrays.values())) > LARGEST:
        raise ModelError(
            f"this {kind.name} takes {size} bytes, and a file may hold {LARGEST}: save its "
            f"recordings apart, summary.select(0).save(...), or make it with fewer bins."
        )
    return arrays


def _write(file: Path | IO[bytes], arrays: Arrays, packing: int) -> None:
    """Write an archive, which tells nothing of when that was."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, values in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            member.compress_type = packing
            with archive.open(member, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, values)


def _read(file: Path | IO[bytes], kind: FileKind) -> Any:
    """The object in an archive, whose arrays are in this machine's order of bytes then, and may be
    written to.

    **Raises:** `DataError`, and what a damaged archive leads to.
    """
    with zipfile.ZipFile(file) as archive:
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
        name = kind.name
        document: Any = json.loads(read(name).tobytes()) if name in members else None
        if (
            not isinstance(document, dict)
            or document.get("format") != f"riecjax.{name.capitalize()}"
        ):
            raise DataError(
                f"it is no {name.capitalize()}, of which {name}.save(path) makes a file."
            )
        if document["schema"] != kind.schema:
            raise DataError(
                f"it was written with schema {document['schema']}, this version reads "
                f"{kind.schema}: make it anew, or use riecjax {document['riecjax']}."
            )
        arrays = {each: read(each) for each in members if each != name}
    if document.pop("checksum") != _checksum(document, arrays):
        raise DataError("it is damaged: its checksum differs. Copy it again, or make it anew.")
    native = {n: a.astype(a.dtype.newbyteorder("="), order="C") for n, a in arrays.items()}
    value = _from_plain_data(document[name], "", native, kind.classes)
    if not isinstance(value, kind.classes[0]):
        raise DataError(f"it holds no {name.capitalize()}.")
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
        if not dataclasses.is_dataclass(kind):
            return kind(**fields)
        # As JAX puts pytrees together: what their constructors would check or convert was so.
        made = object.__new__(kind)
        for field, each in fields.items():
            object.__setattr__(made, field, each)
        return made
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
    below = [*classes]
    for kind in below:
        below += kind.__subclasses__()
    found = {kind.__module__: kind for kind in below if kind.__name__ == name}
    if module not in found and len(found) != 1:
        raise DataError(
            f"it was made with {name} of '{module}', a class that is not defined here: import the "
            f"module that defines it first."
        )
    return found.get(module) or next(iter(found.values()))
