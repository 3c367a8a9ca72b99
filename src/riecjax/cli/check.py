"""`riecjax check`: whether recordings can answer what a model asks, before any fit."""

import click

from riecjax.cli import options
from riecjax.cli.job import JobCommand, job_option
from riecjax.cli.progress import Progress
from riecjax.runtime import start_jax


@click.command(
    "check", cls=JobCommand, short_help="Say before any fit whether recordings can answer."
)
@options.model_option
@options.record_options
@options.hidden_options
@options.criterion_options
@options.set_option
@options.per_record_option
@options.seed_option
@job_option
@options.json_option
def command(
    recordings: options.RecordingOptions,
    model_name: str,
    hidden: options.HiddenOptions,
    criteria: options.CriterionOptions,
    known: dict[str, float],
    per_record: tuple[str, ...],
    seed: int,
    as_json: bool,
) -> None:
    """Say whether recordings can answer what a model asks, before any fit.

    Looks at sensors (missing samples, clipping, stuck or spiking signals), sampling, length, and
    how each parameter is excited; where noise leaves windows no answer, whether refinement has one.
    The exit status is 1 if some parameter cannot be found.
    """
    criteria.require_sense()
    start_jax(once=options.are_small(recordings.files), keep_compiled=True)
    from riecjax.compilation import load_ahead

    load_ahead("check", model_name)
    import jax

    from riecjax.assessment.assess import check_answering
    from riecjax.reporting.checking import check_document, print_check
    from riecjax.reporting.output import emit

    model = hidden.added_to(model_name)
    with Progress():
        read = recordings.read(recordings.files, model)
        criterion = criteria.build(model, read)
        key = jax.random.key(seed)
        found = check_answering(model, read, criterion, key=key, known=known, per_record=per_record)
    emit(
        check_document(found.checked, model.name, criterion, read, found.by_refinement),
        as_json=as_json,
        out=None,
        show=print_check,
    )
    if not found.answerable:
        click.get_current_context().exit(1)
