"""Job files: the options of a command in TOML, or in the results.json that they led to."""

import codecs
import functools
import json
import os
import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from riecjax.whole_files import read_plain

if TYPE_CHECKING:
    from riecjax.findings import Finding

JOB = "riecjax.job"
"""Where the context keeps the options as given, raw, by parameter; and digests beside it."""
DIGESTS = "riecjax.digests"
SHOWN = ("json", "out", "verbose", "job", "help")
"""Options of where a result goes, and not of what it is: a result's job leaves them out."""
PYTHON_FILE = re.compile(r"(?P<file>.+\.py)(?P<object>:[^:/\\]*)?")

job_option = click.option(
    "--job",
    type=click.Path(path_type=Path),
    expose_value=False,
    help="Options and recordings from a TOML file (see 'riecjax init') or a results.json (or its "
    "folder); what is given beside it wins.",
)


class JobCommand(click.Command):
    """A command whose options may stand in a file: they go before those that were typed."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        typed = self._raw(ctx, args)
        if typed.get("job") is not None:
            file = _job_file(typed["job"])
            job, ctx.meta[DIGESTS] = read_job(file)
            args = [*self._arguments(ctx, job, typed, file.parent), *args]
        ctx.meta[JOB] = self._raw(ctx, args)
        return super().parse_args(ctx, list(args))

    def _raw(self, ctx: click.Context, args: list[str]) -> dict[str, Any]:
        """What is said of each parameter, as text, before it is understood."""
        values, _, named = self.make_parser(ctx).parse_args(args=list(args))
        said = {param.name: values[param.name] for param in named if param.name}
        # What is absent has no value, or click's own word for none.
        return {
            k: v for k, v in said.items() if isinstance(v, str | tuple | list | bool) and v != ()
        }

    def _arguments(
        self, ctx: click.Context, job: Mapping[str, Any], typed: Mapping[str, Any], folder: Path
    ) -> list[str]:
        """A job as arguments, without what typed ones replace."""
        params = {key_of(param): param for param in self.get_params(ctx)}
        # A job may hold all options of identify, also where another command reads it.
        group = ctx.find_root().command
        other = group.get_command(ctx, "identify") if isinstance(group, click.Group) else None
        others = {key_of(param) for param in (other.params if other else ())}

        def moved(path: str) -> str:
            """A path, which is relative to the job's folder, as seen from here."""
            return os.path.normpath(os.path.join(folder, path))

        made = []
        for key, value in job.items():
            if key in SHOWN[-2:] or (key not in params and key not in others):
                near = get_close_matches(key, [k for k in params if k not in SHOWN[-2:]], 1)
                remedy = "'riecjax init' prints a job with all of them"
                remedy = f"the nearest is '{near[0]}'" if near else remedy
                raise click.UsageError(f"--job: there is no option '{key}'; {remedy}.")
            if key not in params:
                continue
            param = params[key]
            entries = [
                [*entry[:-1], _repathed(param, entry[-1], moved)]
                for entry in _entries(param, key, value)
            ]
            if param.name in typed:
                entries = _left(param, entries, typed[param.name])
            made += [text for entry in entries for text in entry]
        return made


def key_of(param: click.Parameter) -> str:
    """What a job calls a parameter: an option by its long name, RECORD... `records`."""
    if isinstance(param, click.Option):
        return max(param.opts, key=len).removeprefix("--")
    return f"{(param.metavar or param.name or '').strip('.').lower()}s"


def _job_file(path: str) -> Path:
    """A job's file; of a folder with results the results.json in it."""
    return Path(path) / "results.json" if os.path.isdir(path) else Path(path)


def read_job(file: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The options that a file holds, and digests of their files if it is a results.json.

    **Raises:** `click.UsageError` if it is no job.
    """
    try:
        content = read_plain(file)
        # PowerShell 5 redirects to UTF-16, which begins with its mark.
        is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = content.decode("utf-16" if is_utf_16 else "utf-8-sig")
        if file.suffix.lower() == ".json":
            document = json.loads(text)
            if not all(isinstance(document[key], dict) for key in ("job", "provenance")):
                raise KeyError("job")
            from riecjax.reporting.document import SCHEMA, is_intact, unread_schema

            if why := unread_schema(document.get("schema", SCHEMA)):
                raise click.UsageError(f"--job {file}: {why}.")
            if not is_intact(document):
                raise click.UsageError(
                    f"--job {file}: it is damaged or was changed: its checksum differs. Other "
                    f"options stand beside --job, or in a TOML file ('riecjax init' prints one)."
                )
            recorded = document["provenance"].get("files", [])
            return dict(document["job"]), [
                {"file": str(one["file"]), "sha256": str(one["sha256"])} for one in recorded
            ]
        import tomllib

        return tomllib.loads(text), []
    except OSError as error:
        raise click.UsageError(f"--job {file}: cannot be read: {error.strerror}.") from None
    except (KeyError, TypeError, RecursionError):
        raise click.UsageError(f"--job {file}: it is no results.json with a job.") from None
    except UnicodeDecodeError as error:
        raise click.UsageError(
            f"--job {file}: byte {error.start} is not UTF-8; save the file as UTF-8."
        ) from None
    except ValueError as error:  # of TOML and JSON
        toml = "" if file.suffix.lower() == ".json" else " Words stand in quotes in TOML."
        raise click.UsageError(f"--job {file}: it is not understood: {error}.{toml}") from None


def _entries(param: click.Parameter, key: str, value: Any) -> list[list[str]]:
    """The arguments that say this value, a list for each time that the option is given.

    **Raises:** `click.UsageError` for a value of the wrong kind.
    """
    name = param.opts[0]
    if isinstance(param, click.Option) and param.is_flag:
        if not isinstance(value, bool):
            raise _wrong(key, "true or false", value)
        return [[name]] if value else [[off] for off in param.secondary_opts[:1]]
    if param.nargs == -1:
        listed = [value] if isinstance(value, str) else value
        if not (isinstance(listed, list) and all(isinstance(one, str) for one in listed)):
            raise _wrong(key, "a list of names in quotes", value)
        return [[_text(key, one)] for one in listed]
    if not param.multiple:  # type: ignore[attr-defined]
        # Names between commas may as well be a list.
        listed = (
            ",".join(map(str, value)) if key == "columns" and isinstance(value, list) else value
        )
        return [[name, *_texts(param, key, listed)]]
    if isinstance(value, dict):
        if "=" not in (param.metavar or param.type.name):
            raise _wrong(key, "a list of names in quotes", value)
        return [[name, f"{one}={_text(f'{key}.{one}', v)}"] for one, v in value.items()]
    listed = value if isinstance(value, list) else [value]
    return [[name, *_texts(param, key, one)] for one in listed]


def _texts(param: click.Parameter, key: str, value: Any) -> list[str]:
    if param.nargs == 1:
        return [_text(key, value)]
    if not (isinstance(value, list) and len(value) == param.nargs):
        raise _wrong(key, f"a list of {param.nargs}", value)
    return [_text(key, one) for one in value]


def _text(key: str, value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise _wrong(key, "a number, or a name in quotes", value)
    text = str(value)
    try:
        if b"\0" not in os.fsencode(text):
            return text
    except UnicodeEncodeError:
        pass
    raise _wrong(key, "text as can be typed", value)


def _wrong(key: str, wanted: str, value: Any) -> click.UsageError:
    return click.UsageError(f"--job: '{key}' must be {wanted}; got {value!r}.")


def _repathed(param: click.Parameter, text: str, moved: Any) -> str:
    """The text with its path moved: of an option that takes files, or FILE.py[:OBJECT]."""
    if isinstance(param.type, click.Path):
        path = moved(text)
        # Else it would be taken for an option.
        return f"./{path}" if path.startswith("-") else path
    found = PYTHON_FILE.fullmatch(text)
    # Only these two options name code; elsewhere .py may end any name.
    if found is None or key_of(param) not in ("model", "test-function"):
        return text
    return moved(found["file"]) + (found["object"] or "")


def _left(param: click.Parameter, entries: list[list[str]], typed: Any) -> list[list[str]]:
    """Entries that typed ones do not replace: assignments to other names."""
    assigned = (
        [one for one in typed if isinstance(one, str) and "=" in one]
        if (getattr(param, "multiple", False))
        else []
    )
    if not assigned or len(assigned) < len(typed) or any("=" not in e[-1] for e in entries):
        return []
    names = {one.partition("=")[0].strip() for one in assigned}
    return [e for e in entries if e[-1].partition("=")[0].strip() not in names]


def job_of(ctx: click.Context, folder: Path | None = None) -> dict[str, Any]:
    """Options and recordings of the running command, with defaults, as a job file holds them.

    **Arguments:** `folder`, where the job will stand, which its relative paths start from; here
    if `None`.
    """
    return {key: value for key, value in given(ctx, folder).items() if key not in SHOWN}


def given(ctx: click.Context, folder: Path | None = None) -> dict[str, Any]:
    """As [`job_of`][], with the options of where a result goes."""
    raw, found = ctx.meta[JOB], {}
    for param in ctx.command.get_params(ctx):
        default = param.default if isinstance(param.default, str | int | float | bool) else None
        value = raw.get(param.name, default)
        if (value is not None and value is not False) or getattr(param, "secondary_opts", ()):
            found[key_of(param)] = _plain(param, value, folder)
    return found


def _seen_from(folder: Path | None, path: str) -> str:
    """A path, which starts from here, as one that starts from a folder, on any system.

    It is absolute where the folder is on another drive, to which no path of Windows leads.
    """
    seen = os.path.normpath(path)
    if folder is not None and not os.path.isabs(path):
        try:
            seen = os.path.relpath(path, folder)
        except ValueError:
            seen = os.path.abspath(path)
    return seen.replace(os.sep, "/")


def _plain(param: click.Parameter, value: Any, folder: Path | None) -> Any:
    if isinstance(value, bool):
        return value
    moved = functools.partial(_seen_from, folder)
    if isinstance(value, tuple | list):
        texts = [_repathed(param, one, moved) if isinstance(one, str) else one for one in value]
        pairs = [text.partition("=") for text in texts] if getattr(param, "multiple", False) else []
        names = {name.strip() for name, _, _ in pairs}
        if pairs and all(equals for _, equals, _ in pairs) and len(names) == len(pairs):
            return {name.strip(): _number(text.strip()) for name, _, text in pairs}
        return [_number(text) if param.nargs > 1 else text for text in texts]
    return _number(_repathed(param, str(value), moved))


def _number(text: str) -> Any:
    """The number that is written so and not otherwise, or the text."""
    try:
        number = json.loads(text)
    except ValueError:
        return text
    return number if type(number) in (int, float) and repr(number) == text else text


def input_files(ctx: click.Context) -> list[str]:
    """Every file that the command reads: recordings, also in a bag's folder, and users' code."""
    raw, files = ctx.meta[JOB], {}
    for param in ctx.command.get_params(ctx):
        if key_of(param) in SHOWN:
            continue
        value = raw.get(param.name, ())
        for text in value if isinstance(value, tuple | list) else [value]:
            _repathed(param, str(text), lambda path: files.setdefault(path, path))
    # Of a folder, as a bag is, those in it.
    return [
        file
        for path in files
        for file in (
            [os.path.join(path, name) for name in sorted(os.listdir(path))]
            if os.path.isdir(path)
            else [path]
        )
    ]


def digests(files: Iterable[str], folder: Path | None = None) -> list[dict[str, Any]]:
    """Size and SHA-256 of files, as `provenance` keeps them; of those only that are there.

    **Arguments:** `folder`, where names of files start from, as in [`job_of`][].
    """
    import hashlib

    found = []
    for file in filter(os.path.isfile, files):
        with open(file, "rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        name = _seen_from(folder, file)
        found.append({"file": name, "bytes": os.path.getsize(file), "sha256": digest})
    return found


def changed_files(ctx: click.Context) -> "list[Finding]":
    """Files that are others than those the job's results were made from, told at once.

    Files typed beside a job are no change of the job's.
    """
    from riecjax.findings import Finding

    recorded = ctx.meta.get(DIGESTS) or []
    if not recorded:
        return []
    job = str(_job_file(ctx.meta[JOB]["job"]))
    folder = os.path.dirname(job)
    known = {os.path.normpath(os.path.join(folder, d["file"])): d["sha256"] for d in recorded}
    found = [
        Finding(
            "file_changed",
            f"{one['file']} is not the file that {os.path.basename(job)} was made from (its "
            f"SHA-256 begins with {one['sha256'][:8]}, not {known[one['file']][:8]}): these "
            f"numbers are of the new file.",
        )
        for one in digests(file for file in input_files(ctx) if file in known)
        if one["sha256"] != known[one["file"]]
    ]
    for finding in found:
        click.echo(f"warning [{finding.code}]: {finding.message}", err=True)
    return found
