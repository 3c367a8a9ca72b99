"""`riecjax discover`: which terms a model lacks."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from riecjax.cli import options
from riecjax.cli.progress import Progress
from riecjax.runtime import start_jax

if TYPE_CHECKING:
    from riecjax.equations.procedure import AtRest

MODEL_FILE = "model.py"


@click.command("discover", short_help="Find the terms that a model lacks.")
@options.model_option
@click.option(
    "--candidates",
    metavar="FILE.py:OBJECT",
    help="Terms that it may lack, a list of your own. [default: friction, springs, dead zones, "
    "offsets and the like of its motions]",
)
@options.record_options
@options.criterion_options
@options.set_option
@click.option(
    "--hold-out",
    type=options.SHARE,
    metavar="SHARE",
    help="Choose without this share at the end of each recording, and take values and intervals "
    "from it alone.",
)
@click.option(
    "--least",
    type=options.SHARE,
    default=0.01,
    show_default=True,
    metavar="SHARE",
    help="Of what is unexplained, the share that a term must make up for.",
)
@click.option(
    "--smallest",
    type=options.SHARE,
    default=2e-5,
    show_default=True,
    metavar="SHARE",
    help="Of the target's energy, the share that a term must make up for: less for exact data.",
)
@options.at_rest_option
@options.seed_option
@options.json_option
@options.out_option
def command(
    recordings: options.RecordingOptions,
    model_name: str,
    candidates: str | None,
    criteria: options.CriterionOptions,
    known: dict[str, float],
    hold_out: float | None,
    least: float,
    smallest: float,
    at_rest: "AtRest | None",
    seed: int,
    as_json: bool,
    out: Path | None,
) -> None:
    """Find the terms that a model lacks, by what they predict of blocks of time left out.

    The model's own terms stay; candidates are added only where chance does not explain what they
    gain. With --out the model that was found is written to model.py, for identify and simulate.
    """
    criteria.require_sense()
    start_jax(once=options.are_small(recordings.files), keep_compiled=True)
    from riecjax.discovery.candidate import as_candidates
    from riecjax.discovery.discover import discover
    from riecjax.discovery.model_file import model_source
    from riecjax.models.catalogue import find_model, object_of_file
    from riecjax.reporting.discovery import (
        discovery_document,
        discovery_figures,
        discovery_page,
        print_discovery,
    )
    from riecjax.reporting.output import emit, require_folder
    from riecjax.uncertainty.intervals import BlockBootstrap

    if out is not None:
        require_folder(out)
    model = find_model(model_name)
    own = None if candidates is None else as_candidates(object_of_file(candidates))
    with Progress():
        read = recordings.read(recordings.files, model)
        found = discover(
            model,
            read,
            own,
            criteria.build(model, read) if criteria.is_given else None,
            hold_out=hold_out,
            least=least,
            smallest=smallest,
            known=known,
            intervals=BlockBootstrap(seed=seed),
            at_rest=at_rest,
            seed=seed,
        )
    others, written = {}, None
    if out is not None:
        source, written = model_source(found, model_name, out, candidates), str(out / MODEL_FILE)
        others[MODEL_FILE] = lambda path: path.write_text(source, encoding="utf-8")
    command_line = click.get_current_context().obj or ()
    emit(
        discovery_document(found, command_line, written),
        as_json=as_json,
        out=out,
        show=print_discovery,
        charts=lambda: discovery_figures(found),
        page=discovery_page,
        others=others,
    )
