"""Commands whose options are settings: from words, and a job beside them, to what was given."""

import codecs
import dataclasses
import functools
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from riecjax.findings import Finding
from riecjax.settings import Contradiction, Elements, Fit, Option, Reading, Settings
from riecjax.standard_output import keep_for_answers
from riecjax.whole_files import read_plain, seen_from

if TYPE_CHECKING:
    from jaxtyping import Array, Key

    from riecjax.equations.model import Model
    from riecjax.records.recording import Recording


Kind = TypeVar("Kind", bound=Settings)


def _parsed(option: Option, ctx: click.Context, param: click.Parameter, value: Any) -> Any:
    """What an option makes of its text, or of several."""
    try:
        texts = [value] if isinstance(value, str) else value
        return None if texts is None else option.parsed(*texts)
    except ValueError as error:
        raise click.BadParameter(str(error), ctx, param) from None


def _parameter(name: str, settings: type[Settings]) -> click.Parameter:
    """What click knows of a setting. Whether it must be there is seen after a job was read."""
    option = settings.options()[name]
    many, choices = option.shape in ("many", "named"), option.kind.choices
    said: dict[str, Any] = {"is_flag": True, "default": option.default}
    if option.shape != "flag":
        form = option.form if "|" in option.form else option.form.upper()
        said = {
            "type": click.Choice(choices) if choices else str,
            "callback": functools.partial(_parsed, option),
            "metavar": option.metavar or (None if choices else form),
        }
    if not option.flag:
        # A command of one thing takes one; RECORD... stands for any number.
        return click.Argument([name], nargs=-1 if many else 1, required=False, **said)
    if option.shape != "flag":
        default = None if many else option.default
        said |= {"nargs": option.count, "multiple": many, "default": default}
    silent = option.default_in_words or option.default is None or option.default is False
    shown = not silent and option.default not in ((), {})
    return click.Option([option.flag, name], show_default=shown, **said)


@dataclasses.dataclass(frozen=True)
class Given:
    """What a command was given.

    **Fields:** `command`; `values` of all its settings; `typed`, those that were typed, in this
    order; `job`, a file that others are from, and `recorded`, digests of the files that its result
    was made from.
    """

    command: "SettingsCommand"
    values: dict[str, Any]
    typed: dict[str, Any]
    job: Path | None = None
    recorded: Sequence[Mapping[str, str]] = ()

    def __getattr__(self, name: str) -> Any:
        try:
            return self.values[name]
        except KeyError:
            raise AttributeError(name) from None

    @property
    def arguments(self) -> Sequence[str]:
        """What was typed behind `riecjax`."""
        return click.get_current_context().obj or ()

    def take(self, kind: type[Kind]) -> Kind:
        """The settings of one kind."""
        return kind(**{name: self.values[name] for name in kind.options() if name in self.values})

    def model(self) -> "Model":
        """The model, with the elements that are added to it."""
        from riecjax.models.catalogue import find_model, with_asked

        model = find_model(self.model_name)
        return with_asked(model, self.take(Elements)) if "modes" in self.values else model

    def recordings(self, model: "Model", files: Sequence[Path] | None = None) -> "list[Recording]":
        """What files hold, read and prepared for a model; the RECORD... if no others are named.

        **Raises:** `DataError` naming the file, or a recording that was given twice.
        """
        from riecjax.doubts.reading import read_recordings
        from riecjax.records.faults.rows import refuse_duplicates

        asked = {**vars(self.take(Reading)), "model": model}
        recordings = [
            recording
            for file in (self.files if files is None else files)
            for recording in read_recordings(file, **asked)
        ]
        if not self.allow_duplicates:
            refuse_duplicates(recordings)
        return recordings

    def key_of(self, asked: Fit) -> 'Key[Array, ""] | None':
        """The key of windows that are drawn at random; `None` where all are summed."""
        if not isinstance(asked.windows, int):
            return None
        # To make one starts JAX, which takes a quarter of a second.
        import jax

        return jax.random.key(self.seed)

    def shown(self, folder: Path | None = None) -> dict[str, Any]:
        """All that is set, with defaults, by the keys of a job file and as one holds it.

        **Arguments:** `folder`, where relative paths start from; here if `None`.
        """
        shown = {}
        for name, option in self.command.options.items():
            value = self.values[name]
            idle = value is None or value in ((), {}) or value == option.default in option.alone
            if "/" in option.flag or not (idle or value is False):
                shown[option.key] = option.plain(
                    option.moved(value, functools.partial(seen_from, folder))
                )
        return shown

    def as_job(self, folder: Path | None = None) -> dict[str, Any]:
        """The same but for where the result goes: a job that gives it again."""
        idle = {option.key for option in self.command.options.values() if option.of_result}
        return {key: value for key, value in self.shown(folder).items() if key not in idle}

    def inputs(self) -> list[str]:
        """Every file that is read: recordings, also in a bag's folder, and users' code."""
        found: dict[str, str] = {}
        for name, option in self.command.options.items():
            if not option.of_result:
                option.moved(self.values[name], lambda path: found.setdefault(path, path))
        # Of a folder, as a bag is, those in it.
        held = (sorted(Path(p).iterdir()) if os.path.isdir(p) else [p] for p in found)
        return [str(file) for files in held for file in files]

    def made_from(self) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """What makes a result again, and digests of the files that it is of."""
        return self.as_job(self.out), digests(self.inputs(), self.out)

    def changed_files(self) -> list[Finding]:
        """Files that are others than those the job's results were made from, told at once.

        Files typed beside a job are no change of the job's.
        """
        if self.job is None or not self.recorded:
            return []
        folder, changed = os.path.dirname(self.job), []
        known = {
            os.path.normpath(os.path.join(folder, digest["file"])): digest["sha256"]
            for digest in self.recorded
        }
        for file in digests(file for file in self.inputs() if file in known):
            before, now = known[os.path.normpath(file["file"])], file["sha256"]
            if now != before:
                message = (
                    f"{file['file']} is not the file that {self.job.name} was made from (its "
                    f"SHA-256 begins with {now[:8]}, not {before[:8]}): these numbers are of the "
                    f"new file."
                )
                click.echo(f"warning [file_changed]: {message}", err=True)
                changed.append(Finding("file_changed", message))
        return changed

    def with_options(self, words: Sequence[str]) -> list[str]:
        """Arguments of the command with further options, in place of those that they replace.

        A folder that holds a result is not written over. What is found amiss is that of the record
        as prepared: what is left of a delay adds to what was taken off.
        """
        typed = {k: v for k, v in self.typed.items() if k not in ("as_json", "out")}
        for name, further in self.command.typed(words).items():
            option = self.command.options[name]
            typed[name] = _with_names(typed.get(name), option.beside(self.values[name], further))
            typed = {k: v for k, v in typed.items() if k not in option.excludes}
        said = [(self.command.options[name], value) for name, value in typed.items()]
        files = [word for option, value in said if not option.flag for word in option.words(value)]
        words = [word for option, value in said if option.flag for word in option.words(value)]
        is_hidden = any(file.startswith("-") for file in files)
        return [str(self.command.name), *([*words, "--", *files] if is_hidden else files + words)]


def read_job(file: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The options that a file holds, and digests of their files if it is a results.json.

    **Raises:** `click.UsageError` if it is no job.
    """
    try:
        content = read_plain(file)
        # PowerShell 5 redirects to UTF-16, which begins with its mark.
        is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = content.decode("utf-16" if is_utf_16 else "utf-8-sig")
        if file.suffix.lower() != ".json":
            import tomllib

            return tomllib.loads(text), []
        document = json.loads(text)
        if not all(isinstance(document[key], dict) for key in ("job", "provenance")):
            raise KeyError("job")
        from riecjax.reporting.document import SCHEMA, is_intact, unread_schema

        why = unread_schema(document.get("schema", SCHEMA))
        if not why and is_intact(document):
            files = document["provenance"].get("files", [])
            recorded = [{key: str(file[key]) for key in ("file", "sha256")} for file in files]
            return dict(document["job"]), recorded
        why = why or (
            "it is damaged or was changed: its checksum differs. Other options stand beside "
            "--job, or in a TOML file ('riecjax init' prints one)"
        )
    except OSError as error:
        why = f"cannot be read: {error.strerror}"
    except (KeyError, TypeError, RecursionError):
        why = "it is no results.json with a job"
    except UnicodeDecodeError as error:
        why = f"byte {error.start} is not UTF-8; save the file as UTF-8"
    except ValueError as error:  # of TOML and JSON
        toml = "" if file.suffix.lower() == ".json" else ". Words stand in quotes in TOML"
        why = f"it is not understood: {error}{toml}"
    raise click.UsageError(f"--job {file}: {why}.")


def digests(files: Iterable[str], folder: Path | None = None) -> list[dict[str, Any]]:
    """Size and SHA-256 of files, of those that are there.

    **Arguments:** `folder`, where names of files start from; here if `None`.
    """

    def sha256(file: str) -> str:
        with open(file, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()

    return [
        {"file": seen_from(folder, file), "bytes": os.path.getsize(file), "sha256": sha256(file)}
        for file in filter(os.path.isfile, files)
    ]


def _with_names(before: Any, value: Any) -> Any:
    """What is said of some names beside what was said of others; of all else, what is said last."""
    return {**before, **value} if isinstance(before, dict) and isinstance(value, dict) else value


class SettingsCommand(click.Command):
    """A command that is given settings, some of which may stand in a job file."""

    def __init__(self, name: str, kinds: Sequence[type[Settings]], **said: Any):
        self.settings = {field: kind for kind in kinds for field in kind.options()}
        self.options = {field: kind.options()[field] for field, kind in self.settings.items()}
        params = [_parameter(field, kind) for field, kind in self.settings.items()]
        super().__init__(name, params=params, **said)

    def typed(self, words: Sequence[str], ctx: click.Context | None = None) -> dict[str, Any]:
        """Settings that words say, in their order."""
        ctx = ctx or click.Context(self, resilient_parsing=True)
        super().parse_args(ctx, list(words))
        return {
            name: value
            for name, value in ctx.params.items()
            if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE
            and value not in ((), None)
        }

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        typed = self.typed(args, ctx)
        values = {name: option.default for name, option in self.options.items()}
        job, recorded = typed.get("job"), ()
        if job is not None:
            job = job / "results.json" if job.is_dir() else job  # of a folder, its results
            with click.core.augment_usage_errors(ctx):
                held, recorded = read_job(job)
                of_job = dict(self._of_job(ctx, held, job))
            # Without what typed settings stand for: of a band, both its ends.
            said = {**of_job, **typed}
            for name, value in of_job.items():
                others = set(self.options[name].excludes)
                together = others.union(*(self.options[o].excludes for o in others)) - {name}
                is_complete = all(said.get(other) is not None for other in together)
                if name in typed or not (others & typed.keys() and is_complete):
                    values[name] = value
        values |= {name: _with_names(values[name], value) for name, value in typed.items()}
        for param in sorted(self.params, key=lambda param: isinstance(param, click.Option)):
            name = str(param.name)
            if self.options[name].required and values[name] in (None, ()):
                raise click.MissingParameter(ctx=ctx, param=param)
        ctx.params = {"given": Given(self, values, typed, job, recorded)}
        return []

    def _of_job(
        self, ctx: click.Context, job: Mapping[str, Any], file: Path
    ) -> Iterator[tuple[str, Any]]:
        """What a job says of this command's settings.

        A job may hold all options of identify and discover, also where another command reads it;
        what this one does not use is said.
        """

        def from_here(path: str) -> str:
            return os.path.normpath(os.path.join(file.parent, path))

        group, unused = ctx.find_root().command, []
        others: dict[str, Option] = {
            option.key: option
            for name in (("discover", "identify") if isinstance(group, click.Group) else ())
            for option in group.get_command(ctx, name).options.values()  # type: ignore[union-attr]
            if option.key != "job"
        }
        names = {option.key: name for name, option in self.options.items() if name != "job"}
        for key, value in job.items():
            if key not in names:
                if key in others:
                    is_said = others[key].of_plain(value) != others[key].default
                    unused += [key] * (is_said and not others[key].of_result)
                    continue
                near = get_close_matches(key, names, 1)
                remedy = "'riecjax init' prints a job with all of them"
                remedy = f"the nearest is '{near[0]}'" if near else remedy
                raise click.UsageError(f"--job {file}: there is no option '{key}'; {remedy}.")
            option = self.options[names[key]]
            try:
                yield names[key], option.of_plain(value, from_here)
            except ValueError as error:
                raise click.UsageError(f"--job {file}: {error}") from None
        if unused:
            unread = f"{self.name} does not use {', '.join(unused)}"
            click.echo(f"warning: --job {file}: {unread}.", err=True)

    def invoke(self, ctx: click.Context) -> Any:
        if ctx.params["given"].values.get("as_json"):
            keep_for_answers()
        try:
            return super().invoke(ctx)
        except Contradiction as error:
            raise click.UsageError(error.typed(), ctx) from None

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Options below what their settings are about."""
        about: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            if not isinstance(param, click.Option):
                continue
            name, title = str(param.name), "Help"
            if kind := self.settings.get(name):
                title = kind.about(name)
                # Not earlier: to read the texts takes long.
                param.help, param.required = kind.help(name), self.options[name].required
            if record := param.get_help_record(ctx):
                about.setdefault(title, []).append(record)
        for title, records in about.items():
            with formatter.section(title):
                formatter.write_dl(records)


def settings_command(
    name: str, *kinds: type[Settings], short_help: str
) -> Callable[[Callable[[Given], None]], SettingsCommand]:
    """Make a command of a function that is [`Given`][] settings of these kinds."""
    return lambda function: SettingsCommand(
        name, kinds, callback=function, help=function.__doc__, short_help=short_help
    )
