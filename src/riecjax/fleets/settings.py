"""Settings of a fleet: what is estimated together, how all recordings are read, and by whom."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from riecjax import settings
from riecjax.errors import ModelError
from riecjax.settings import POSITIVE, TEXT, Reading, flag, setting, whole

Progress = Callable[[str, int, int, int], None]
"""Told what is being done, how much of it is, of how much, and how many samples that were."""


@dataclass(frozen=True, kw_only=True)
class Groups(settings.Settings):
    """What is estimated together, and by whom."""

    by: str | Sequence[str] = setting("--by file|folder|COLUMN[,COLUMN]", TEXT, "file", free=True)
    """What is estimated together: each file, each folder, or all that agrees in keys of its path
    (vehicle=3/) or columns of its Parquet files."""
    span: float | None = setting("--span SECONDS", POSITIVE)
    """Estimate over time as well, in spans of about this length."""
    workers: int | None = setting("--workers N", whole(0, 4096), default_in_words="one a core")
    """Processes that sum; 0 for none but this one."""
    scheduler: str | None = setting("--scheduler ADDRESS", TEXT)
    """Use the workers of this scheduler of Dask."""
    strict: bool = flag("--strict")
    """End at the first recording that cannot be summed."""

    def contradictions(self) -> Iterator[str]:
        """Workers of this machine and of a scheduler; raises for names of groups that are none."""
        if not self.keys or not all(isinstance(key, str) and key for key in self.keys):
            raise ModelError("by names what groups are: by='file', 'folder' or names of columns.")
        if self.workers is not None and self.scheduler is not None:
            yield "{workers} are of this machine, {scheduler} has its own: give one."

    @property
    def keys(self) -> tuple[str, ...]:
        """`"file"`, `"folder"`, or names of columns."""
        said = self.by.split(",") if isinstance(self.by, str) else self.by
        return tuple(part.strip() if isinstance(part, str) else part for part in said)


@dataclass(frozen=True, kw_only=True)
class Fleets(
    Groups,
    settings.Seed,
    settings.Uncertainty,
    settings.Known,
    settings.Fit,
    settings.Prepare,
    settings.Read,
):
    """Which recordings count, and what is kept.

    Keywords of [`fleet`][riecjax.fleet].

    **Fields:** also `allow_duplicates`: count recordings of a group that hold the same samples
    each; `out`: folder for `summaries.parquet` and `estimates.parquet`, `None` keeps nothing;
    `progress`: called with what is being done, how much of it is, of how much, and samples.
    """

    allow_duplicates: bool = flag("--allow-duplicates")
    """Take recordings that hold the same samples, which are refused otherwise."""
    out: str | os.PathLike[str] | None = None
    progress: Progress | None = None

    @property
    def reading(self) -> Reading:
        """How each recording is read and prepared."""
        return Reading(**{name: getattr(self, name) for name in Reading.options()})
