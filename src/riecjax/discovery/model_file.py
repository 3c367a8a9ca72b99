"""A discovered model as a Python file that `identify` and `simulate` take."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path

from riecjax.discovery.discovery import Discovery
from riecjax.equations.hidden_elements import ModeParameters
from riecjax.equations.term import written
from riecjax.errors import ModelError


def model_source(found: Discovery, model: str, folder: Path, candidates: str | None = None) -> str:
    """The text of a file in a folder that holds the model.

    **Arguments:** `model`, as [`find_model`][riecjax.find_model] takes it, that was searched; and
    `candidates`, the file and object that a term came from which cannot be written down.

    **Raises:** `ModelError` for a term that is a function of the user's own, without `candidates`.
    """
    names = ", ".join(found.names)
    head = f'"""{found.start.name}{f" with {names}" if names else ""}."""\n\n'
    values = {name: float(found.estimate[name]) for name in found.estimate.parameters}
    table, terms = found.estimate.table, [chosen.candidate for chosen in found.chosen]
    of_mode = {n: v for n, v in values.items() if isinstance(table[n].element, ModeParameters)}
    added: dict[str, list[str]] = {}
    for candidate in terms:
        lines = [term.source for term in candidate.terms]
        if None in lines:
            if candidates is None:
                raise ModelError(f"{candidate.name} is of a function of your own: name its file.")
            name = written(candidate.name)
            lines = [f"*rx.discovery.named({_path(candidates, folder)}, {name}).terms"]
        equation = candidate.equation or found.start.equation_names[0][0]
        added.setdefault(equation, []).extend(f"{line}," for line in lines)
    body = [f"MODEL = rx.find_model({_path(model, folder)})"]
    if found.chosen or found.mode is None:
        equations = [
            line
            for name, lines in added.items()
            for line in _block(f"{written(name)}: [", lines, "],")
        ]
        states = []
        for memory in dict.fromkeys(memory for candidate in terms for memory in candidate.memories):
            given = ((field, getattr(memory, field.name)) for field in fields(memory))
            words = ", ".join(written(value) for field, value in given if value != field.default)
            states.append(f"rx.equations.{type(memory).__name__}({words}),")
        others = {name: value for name, value in values.items() if name not in of_mode}
        meanings = {name: candidate.meaning for candidate in terms for name in candidate.columns}
        arguments = [
            *_block("{", equations, "},"),
            *(_block("memories=[", states, "],") if states else []),
            *_mapping("values", others),
            *_mapping("meanings", meanings),
        ]
        body = _block(f"{body[0]}.with_terms(", arguments, ")")
    if found.mode is not None:
        mode = f"rx.HiddenMode({written(found.mode.on)}, {found.mode.hz!r}),"
        arguments = [mode, *_mapping("values", of_mode if found.chosen else values)]
        body = [*body[:-1], *_block(f"{body[-1]}.with_modes(", arguments, ")")]
    imports = ["import riecjax as rx", ""]
    if any("{HERE}" in line for line in body):
        imports = ["from pathlib import Path", "", *imports, "HERE = Path(__file__).parent", ""]
    return head + "\n".join([*imports, *body]) + "\n"


def _path(reference: str, folder: Path) -> str:
    """Source of a reference to a model, that of a file relative to the folder."""
    path, separator, attribute = reference.rpartition(":")
    if reference.endswith(".py"):
        path, separator, attribute = reference, "", ""
    if not path.endswith(".py"):
        return written(reference)
    beside = os.path.relpath(Path(path).resolve(), folder.resolve()).replace(os.sep, "/")
    return f'f"{{HERE}}/{beside}{separator}{attribute}"'


def _block(opening: str, lines: Iterable[str], closing: str) -> list[str]:
    return [opening, *(f"    {line}" for line in lines), closing]


def _mapping(name: str, values: Mapping[str, object]) -> list[str]:
    each = (f"{written(key)}: {written(value)}," for key, value in values.items())
    return _block(f"{name}={{", each, "},") if values else []
