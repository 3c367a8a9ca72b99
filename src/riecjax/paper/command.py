"""`riecjax reproduce`: the paper's tables, figures and statements beside their reproduction."""

import functools
import os
from collections.abc import Iterator
from dataclasses import dataclass

from riecjax.cli import Given, Progress, settings_command
from riecjax.runtime import start_jax
from riecjax.settings import Output, Seed, Settings, flag, setting, whole

DEFAULT_ROADS = 32


@dataclass(frozen=True, kw_only=True)
class Study(Settings):
    """How much of the study is repeated."""

    roads: int | None = setting("--roads N", whole(1, 100_000), default_in_words=f"{DEFAULT_ROADS}")
    """Number of random roads behind the tables."""
    full: bool = flag("--full")
    """The whole study: every table, figure and statement."""
    quick: bool = flag("--quick")
    """The whole study on few roads, in about a minute."""

    def contradictions(self) -> Iterator[str]:
        """What sets the number of roads twice."""
        if self.roads and (self.full or self.quick):
            yield "{roads} excludes {full} and {quick}, which set the number of roads."


@settings_command(
    "reproduce", Seed, Study, Output, short_help="Repeat the study of Best and Gordon (1999)."
)
def command(given: Given) -> None:
    """Reproduce Best and Gordon (1999) on simulated roads.

    Without --full or --quick: Tables 1, 3, 4 and 5, and the statements that they decide.
    """
    given.take(Study)
    out = given.out
    start_jax(keep_compiled=True, devices=os.cpu_count() or 1)
    import jax

    from riecjax.models.quarter_car import reconstructed
    from riecjax.paper.charts import study_charts
    from riecjax.paper.claims import evaluate_claims
    from riecjax.paper.report import print_reproduction, reproduction_document, reproduction_page
    from riecjax.paper.reproduction import FULL, QUICK, run_study
    from riecjax.reporting import emit, require_folder

    if out is not None:
        require_folder(out)
    shapes = reconstructed()
    scale = QUICK if given.quick else FULL if given.full else given.roads or DEFAULT_ROADS
    key = jax.random.key(given.seed)
    with Progress() as progress:
        study = run_study(scale, key, shapes, progress.count)
        progress.count("statements", 0, 1)
        claims = evaluate_claims(study.parts)
    emit(
        reproduction_document(study, claims, seed=given.seed),
        as_json=given.as_json,
        out=out,
        show=print_reproduction,
        charts=functools.partial(study_charts, study, shapes),
        page=reproduction_page,
    )
