"""Entry point of the command line."""

import contextlib
import errno
import gc
import importlib
import io
import os
import sys
from typing import Any

import click

from riecjax.errors import RiecjaxError, printable, require
from riecjax.extensions import extension, extension_names
from riecjax.runtime import COLLECT_AFTER, REMEDY
from riecjax.standard_output import answer, is_for_answers, keep_for_answers, restored

# Imported when called: `riecjax models` and `--help` need not wait for JAX.
COMMANDS = ("identify", "discover", "check", "init", "models", "simulate")
"""The core's own, each in a module of its name."""
ORDER = ("identify", "discover", "fleet", "check", "init", "models", "simulate", "reproduce")
"""In which help lists them, before further ones."""


class LazyGroup(click.Group):
    """The core's own commands and those of extensions, which never replace one of the core's."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        listed = dict.fromkeys([*COMMANDS, *extension_names("commands")])
        return sorted(listed, key=lambda name: (*ORDER, name).index(name))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in COMMANDS:
            return importlib.import_module(f"riecjax.cli.{cmd_name}").command
        try:
            command: Any = extension("commands", cmd_name)
            if command is not None:
                require(f"the command '{cmd_name}'", command, click.Command, "a click.Command")
            return command
        except RiecjaxError as error:
            # The help of all commands is not to fail by one of them: called, it says why.
            why = error

        def refuse() -> None:
            raise why

        return click.Command(
            cmd_name,
            {"ignore_unknown_options": True, "allow_extra_args": True},
            refuse,
            short_help=str(why),
            add_help_option=False,
        )


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="riecjax")
def cli() -> None:
    """Identify physical parameters of reduced mechanical models from recorded motion."""


INTERRUPTED = 130
"""Exit status, as of shells, after Ctrl-C, where `riecjax.cli.start` does not see to it."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 no answer from these data, 2 wrong usage."""
    gc.set_threshold(COLLECT_AFTER)
    for stream in (sys.stdout, sys.stderr):
        # Names of columns and files may not be in its encoding: redirected on Windows, a code page.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    sys.exit(run(arguments))


def run(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit status is returned, every message is one line.

    Where the status is 1, `--json` prints `{"schema": 3, "error": {"code": ..., "message": ...}}`.
    """
    given = sys.argv[1:] if arguments is None else arguments
    try:
        with restored():
            if "--json" in given:
                keep_for_answers()
            status = _status(given)
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
        return status
    except OSError as error:
        return _lost(error)


def _status(given: list[str]) -> int:
    try:
        status = cli.main(given, prog_name="riecjax", standalone_mode=False, obj=given)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return 2
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "riecjax"
        return _fail(f"{error.format_message()} See '{where} --help'.", 2)
    except click.Abort:
        return _fail("interrupted.", INTERRUPTED)
    except RiecjaxError as error:
        return _no_answer(str(error), error.code)
    except MemoryError as error:
        return _no_answer(str(error) or "not enough memory for this record.", "memory")
    except RuntimeError as error:
        # XLA's own word, where more was asked for than was foreseen.
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        return _no_answer(
            f"the memory does not hold this computation ({str(error).splitlines()[0]}). {REMEDY}",
            "memory",
        )
    return status if isinstance(status, int) else 0


def _lost(error: OSError) -> int:
    """What to do about an error of a standard stream, or of a file that nothing else told of."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError:
            # Python flushes it again when it ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    # The reader of our output went away (`| head`), for which Windows has two numbers; leave
    # quietly.
    if error.errno == errno.EPIPE or (error.errno, sys.platform) == (errno.EINVAL, "win32"):
        return 1
    what = "the output" if error.filename is None else f"'{error.filename}'"
    return _fail(f"{what} cannot be written or read: {error.strerror}.", 1)


def _no_answer(message: str, code: str) -> int:
    if is_for_answers():
        from riecjax.reporting.document import SCHEMA

        answer({"schema": SCHEMA, "error": {"code": code, "message": message}})
    return _fail(message, 1)


def _fail(message: str, status: int) -> int:
    with contextlib.suppress(OSError):  # there is no one to tell
        click.echo(f"riecjax: {printable(' '.join(message.split()))}", err=True)
    return status
