"""`riecjax discover`: which terms a model lacks."""

import dataclasses

from riecjax import reporting, settings
from riecjax.cli import Given, Progress, settings_command
from riecjax.runtime import start_jax

MODEL_FILE = "model.py"
SETTINGS = (
    *(settings.ModelName, settings.Offered, settings.Recordings, settings.Discover),
    *(settings.Job, settings.Output),
)


@settings_command("discover", *SETTINGS, short_help="Find the terms that a model lacks.")
def command(given: Given) -> None:
    """Find the terms that a model lacks, by what they predict of blocks of time left out.

    The model's own terms stay; candidates are added only where chance does not explain what they
    gain. With --out the model that was found is written to model.py, for identify and simulate.
    """
    asked = given.take(settings.Discover)
    given.changed_files()
    start_jax(keep_compiled=True)
    from riecjax.discovery.candidate import as_candidates
    from riecjax.discovery.discover import discover, model_source
    from riecjax.models.catalogue import object_of_file
    from riecjax.reporting.discovery import (
        discovery_document,
        discovery_figures,
        discovery_page,
        print_discovery,
    )

    out, candidates = given.out, given.candidates
    if out is not None:
        reporting.require_folder(out)
    model = given.model()
    if candidates is not None:
        offered = as_candidates(object_of_file(candidates))
        asked = dataclasses.replace(asked, candidates=offered)
    with Progress():
        found = discover(model, given.recordings(model), **vars(asked))
    others, written = {}, None
    if out is not None:
        source = model_source(found, given.model_name, out, candidates)
        written = str(out / MODEL_FILE)
        others[MODEL_FILE] = lambda path: path.write_text(source, encoding="utf-8")
    document = discovery_document(found, given.arguments, written)
    document["job"], document["provenance"]["files"] = given.made_from()
    reporting.emit(
        document,
        as_json=given.as_json,
        out=out,
        show=lambda _, console: print_discovery(found, written, console),
        charts=lambda: discovery_figures(found),
        page=lambda _: discovery_page(found),
        others=others,
    )
