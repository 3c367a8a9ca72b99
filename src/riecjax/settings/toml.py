"""TOML of settings: values, and the form of a job with a line for each."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from riecjax.settings.option import Settings


def form(
    kinds: Mapping[str, type[Settings]],
    said: Mapping[str, Any],
    notes: Mapping[str, Iterable[str]] = {},
) -> Iterator[str]:
    """Lines of a job file with all settings, those that are not said as comments.

    **Arguments:** `kinds`, to which each setting belongs; `said`, values by key, as a job file
    holds them; `notes`, lines that go below a key's own, or instead of its empty one.
    """
    yield "# A job for: riecjax identify --job FILE. Paths are relative to this file: save it in"
    yield "# the folder where 'riecjax init' was called, or change them."
    options = {name: kind.options()[name] for name, kind in kinds.items()}
    for name in sorted(options, key=lambda name: not options[name].required):
        option = options[name]
        if option.key == "job":
            continue
        yield ""
        if help := kinds[name].help(name):
            yield f"# {help}"
        key = option.key
        lines = [*(assigned(key, said[key]) if key in said else ()), *notes.get(key, ())]
        # What an option that is not set may be. In TOML, all but numbers stands in quotes.
        sign = "" if option.kind.is_number and not option.kind.word else '"'
        name, equals, value = option.form.rpartition("|")[2].partition("=")
        example = f"{sign}{option.form}{sign}"
        if option.shape == "flag":
            example = "false"
        elif equals and BARE.fullmatch(name.strip("[")):
            example = "{ " + f"{name.strip('[')} = {sign}{value.rstrip(']')}{sign}" + " }"
        elif option.shape == "many" or option.count > 1:
            example = f"[{example}]"
        yield from lines or [f"# {key} = {example}"]


BARE = re.compile(r"[A-Za-z0-9_-]+")


def assigned(key: str, value: Any) -> Iterator[str]:
    """TOML that gives a key this value: of a table, a line for each name."""
    if not isinstance(value, dict):
        yield f"{key} = {toml_value(value)}"
    else:
        for name, each in value.items():
            yield f"{key}.{quoted_key(name)} = {toml_value(each)}"


def quoted_key(name: str) -> str:
    """A name as a key of TOML."""
    return name if BARE.fullmatch(name) else toml_value(name)


def toml_value(value: Any) -> str:
    """A text, number, truth or list of them in TOML, whose escapes are JSON's but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
