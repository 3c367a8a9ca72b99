"""Makes the docstrings' references by short name, such as [`Record`][], links of the site.

A short name means what the pages under `reference/` show by it. A name that no page shows is set
as code, without a link.
"""

import re
from pathlib import Path
from typing import Any

from griffe import Extension, Function, Object

REFERENCE = Path(__file__).parent / "reference"
SHOWN = re.compile(r"^::: (\S+)", flags=re.MULTILINE)
SHORT = re.compile(r"\[`([\w.]+)`\]\[\]")


def shown_names() -> dict[str, str]:
    """Short name to the full path under which a page shows it."""
    pages = [page.read_text(encoding="utf-8") for page in REFERENCE.glob("*.md")]
    paths = [path for page in pages for path in SHOWN.findall(page)]
    return {path.rpartition(".")[2]: path for path in paths}


class CrossReferences(Extension):
    """Completes short references as docstrings are loaded."""

    def __init__(self) -> None:
        self.paths = shown_names()

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Rewrites one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = SHORT.sub(self._complete, obj.docstring.value)

    def on_function_instance(self, *, func: Function, **_: Any) -> None:
        """A step of preparation is written as its operations, and makes a record."""
        if any(str(decorator.value) == "step" for decorator in func.decorators):
            func.returns = "Record"

    def _complete(self, reference: re.Match[str]) -> str:
        name = reference.group(1)
        first, dot, rest = name.partition(".")
        if first not in self.paths:
            return f"`{name}`"
        return f"[`{name}`][{self.paths[first]}{dot}{rest}]"
