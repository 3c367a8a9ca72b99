"""`riecjax init`: a job file to fill in, from a look at recordings."""

import codecs
import re
import sys

import click

from riecjax.cli import identify
from riecjax.cli.command import Given, settings_command
from riecjax.settings import Read
from riecjax.settings.toml import form, toml_value


@settings_command(
    "init", *identify.SETTINGS, short_help="Propose a job file for recordings and a model."
)
def command(given: Given) -> None:
    """Print a job file (TOML) for `riecjax identify --job`: every option has its line there.

    The map of signals to columns is proposed from their names and units; a comment marks a guess.
    """
    from riecjax.criteria.windows import DEFAULT_BAND
    from riecjax.models.catalogue import find_model
    from riecjax.models.column_proposal import map_lines
    from riecjax.records.reading.channels import read_channels
    from riecjax.records.reading.selection import recordings_in

    model, read = find_model(given.model_name), given.take(Read)
    dialect = {"delimiter": read.delimiter, "decimal": read.decimal, "columns": read.columns}
    named, part = read.rename.values(), next(iter(read.parts), "")
    channels = [
        each
        for file in given.files
        for each in recordings_in(read_channels(file, **dialect), named, part).held.values()
    ]
    notes = {"map": list(map_lines(model, channels[0], read))}
    if given.band is None:
        band = [float(end) for end in model.band or DEFAULT_BAND]
        notes["band"] = [f"# band = {toml_value(band)}  # taken unless another is given"]
    job = "\n".join(form(given.command.settings, given.shown(), notes))
    # TOML is UTF-8. Windows redirects in a code page, in which no reader of TOML takes even a
    # comment: ASCII, with TOML's escapes, is the same in all of them.
    if codecs.lookup(sys.stdout.encoding or "utf-8").name != "utf-8":
        job = re.sub(r"[^\x00-\x7f]", lambda sign: f"\\U{ord(sign[0]):08x}", job)
    click.echo(job)
