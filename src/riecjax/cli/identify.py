"""`riecjax identify`: parameters from recordings, from settings to `assess` to `emit`."""

import dataclasses

import msgspec

from riecjax import reporting, settings
from riecjax.cli import Given, Progress, settings_command
from riecjax.runtime import start_jax

SETTINGS = (
    *(settings.ModelName, settings.Recordings, settings.Elements, settings.Assess),
    *(settings.Report, settings.Seed, settings.Job, settings.Output),
)


@settings_command(
    "identify", *SETTINGS, short_help="Identify a model's parameters from recordings."
)
def command(given: Given) -> None:
    """Identify a model's parameters from one or several recordings.

    A recording is a file of text (CSV), JSON, Parquet, NPZ or MATLAB, or with an extra HDF5 (and
    MATLAB v7.3), a spreadsheet, MDF4, TDMS or ROS bag. Units that it states are converted to SI;
    --map says which column is which signal, --unit in which unit it is where the file states none.
    """
    asked = given.take(settings.Assess)
    start_jax(keep_compiled=True)
    changed = given.changed_files()
    from riecjax.assessment.assess import assess
    from riecjax.uncertainty.intervals import intervals_of

    if given.out is not None:
        reporting.require_folder(given.out)
    model = given.model()
    with Progress() as progress:
        recordings = given.recordings(model)
        asked = dataclasses.replace(
            asked,
            key=given.key_of(asked),
            intervals=intervals_of(given.intervals, given.seed),
            validate_on=given.recordings(model, given.validate_on),
            on_estimate=progress.show_estimate,
            progress=progress.refining,
        )
        assessment = assess(model, recordings, **vars(asked))
    # Not earlier: what reports are made with takes a second to import.
    from riecjax.reporting.answer import FilePart, WarningPart, answer_of, read
    from riecjax.reporting.identification import print_everything, print_identification

    answer = answer_of(assessment, given.arguments, given.with_options)
    # Files that changed have been told of already.
    told = msgspec.to_builtins(answer.warnings) if given.verbose or given.as_json else []
    answer.warnings += [read(WarningPart, finding._asdict()) for finding in changed]
    answer.job, files = given.made_from()
    answer.provenance.files = read(list[FilePart], files)
    answer.provenance.seed = given.seed
    reporting.emit(
        answer,
        as_json=given.as_json,
        out=given.out,
        show=print_everything if given.verbose else print_identification,
        charts=lambda: reporting.identification_figures(assessment),
        page=lambda answer: reporting.identification_page(answer, assessment.tests),
        warnings=told,
    )
