"""A discovered model as a Python file that `identify` and `simulate` take."""

import os
from collections.abc import Mapping
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
    table = found.estimate.table
    of_mode = {n: v for n, v in values.items() if isinstance(table[n].element, ModeParameters)}
    added: dict[str, list[str]] = {}
    first = found.start.equation_names[0][0]
    own = False
    for one in (chosen.candidate for chosen in found.chosen):
        lines = [term.source for term in one.terms]
        if None in lines:
            if candidates is None:
                raise ModelError(f"{one.name} is of a function of your own: name its file.")
            own = True
            lines = [f"*rx.discovery.named({_path(candidates, folder)}, {written(one.name)}).terms"]
        added.setdefault(one.equation or first, []).extend(map(str, lines))
    start = _path(model, folder)
    body = [f"MODEL = rx.find_model({start})"]
    if found.chosen or found.mode is None:
        others = {name: value for name, value in values.items() if name not in of_mode}
        of_terms = [one.candidate for one in found.chosen]
        named = {name: one.meaning for one in of_terms for name in one.columns}
        meanings = _mapping("meanings", named)
        body[-1] += ".with_terms("
        body.append("    {")
        for equation, lines in added.items():
            terms = (f"            {line}," for line in lines)
            body += [f"        {written(equation)}: [", *terms, "        ],"]
        body.append("    },")
        states = []
        for memory in dict.fromkeys(m for one in of_terms for m in one.memories):
            given = ((field, getattr(memory, field.name)) for field in fields(memory))
            words = ", ".join(written(value) for field, value in given if value != field.default)
            states.append(f"        rx.equations.{type(memory).__name__}({words}),")
        body += ["    memories=[", *states, "    ],"] if states else []
        body += [*_mapping("values", others), *meanings, ")"]
    if found.mode is not None:
        body[-1] += ".with_modes("
        mode = f"rx.HiddenMode({written(found.mode.on)}, {found.mode.hz!r})"
        body += [f"    {mode},", *_mapping("values", of_mode if found.chosen else values), ")"]
    folder_line = ["HERE = Path(__file__).parent"] if "HERE" in start or own else []
    folder_line += [""] if folder_line else []
    imports = ["from pathlib import Path", ""] if folder_line else []
    imports += ["import riecjax as rx", ""]
    return head + "\n".join([*imports, *folder_line, *body]) + "\n"


def _path(reference: str, folder: Path) -> str:
    """Source of a reference to a model, that of a file relative to the folder."""
    path, separator, attribute = reference.rpartition(":")
    if reference.endswith(".py"):
        path, separator, attribute = reference, "", ""
    if not path.endswith(".py"):
        return written(reference)
    beside = os.path.relpath(Path(path).resolve(), folder.resolve()).replace(os.sep, "/")
    return f'f"{{HERE}}/{beside}{separator}{attribute}"'


def _mapping(name: str, values: Mapping[str, object]) -> list[str]:
    if not values:
        return []
    each = (f"        {written(key)}: {written(value)}," for key, value in values.items())
    return [f"    {name}={{", *each, "    },"]
