"""`riecjax check`: whether recordings can answer what a model asks, before any fit."""

import dataclasses

import click

from riecjax import reporting, settings
from riecjax.cli import Given, Progress, settings_command
from riecjax.runtime import start_jax

SETTINGS = (
    *(settings.ModelName, settings.Recordings, settings.Elements, settings.Check),
    *(settings.Seed, settings.Job, settings.Document),
)


@settings_command(
    "check", *SETTINGS, short_help="Say before any fit whether recordings can answer."
)
def command(given: Given) -> None:
    """Say whether recordings can answer what a model asks, before any fit.

    Looks at sensors (missing samples, clipping, stuck or spiking signals), sampling, length, and
    how each parameter is excited; where noise leaves windows no answer, whether refinement has one.
    The exit status is 1 if some parameter cannot be found.
    """
    asked = given.take(settings.Check)
    start_jax(keep_compiled=True)
    from riecjax.assessment.assess import check_answering
    from riecjax.reporting.checking import check_document, print_check

    model = given.model()
    with Progress():
        recordings = given.recordings(model)
        asked = dataclasses.replace(asked, key=given.key_of(asked))
        checked = check_answering(model, recordings, asked)
    document = check_document(checked, model.name, recordings)
    reporting.emit(document, as_json=given.as_json, out=None, show=print_check)
    if not checked.answerable:
        click.get_current_context().exit(1)
