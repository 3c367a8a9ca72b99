"""What a fleet is asked for, said once: keywords of the verb, options of the command."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from riecjax.settings import (
    POSITIVE,
    TEXT,
    Contradiction,
    Fit,
    Known,
    Prepare,
    Read,
    Settings,
    Uncertainty,
    flag,
    setting,
    whole,
)

Progress = Callable[[str, int, int, int], None]
"""Told what is being done, how much of it is, of how much, and how many samples that were."""


@dataclass(frozen=True, kw_only=True)
class Groups(Settings):
    """What is estimated together, and by whom."""

    by: str | Sequence[str] = setting("--by file|folder|COLUMN[,COLUMN]", TEXT, "file")
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

    def require_sense(self) -> None:
        """**Raises:** [`Contradiction`][riecjax.settings.Contradiction]."""
        if self.workers is not None and self.scheduler is not None:
            raise Contradiction(
                "{workers} are of this machine, {scheduler} has its own: give one.", self.options()
            )


@dataclass(frozen=True, kw_only=True)
class Recorded(Prepare, Read):
    """How all recordings are read."""

    allow_duplicates: bool = flag("--allow-duplicates")
    """Take recordings that hold the same samples, which are refused otherwise."""


@dataclass(frozen=True, kw_only=True)
class FleetSettings(Groups, Uncertainty, Known, Recorded, Fit):
    """Keywords of [`fleet`][riecjax.fleet].

    **Fields:** also `out`, folder for `summaries.parquet` and `estimates.parquet`; `None` keeps
    nothing. `storage`, what fsspec is to know of the store. `progress`, called with what is being
    done, how much of it is, of how much, and samples.
    """

    out: str | os.PathLike[str] | None = None
    storage: Mapping[str, Any] = field(default_factory=dict)
    progress: Progress | None = None

    def require_sense(self) -> None:
        """**Raises:** [`Contradiction`][riecjax.settings.Contradiction]."""
        Groups.require_sense(self)
        Fit.require_sense(self)

    @property
    def keys(self) -> tuple[str, ...]:
        """What groups are: `file`, `folder`, or names of columns or keys."""
        return (
            tuple(map(str.strip, self.by.split(","))) if isinstance(self.by, str) else (*self.by,)
        )

    @property
    def reading(self) -> dict[str, Any]:
        """Keywords that each recording is read by."""
        return {name: getattr(self, name) for name in (*Read.options(), *Prepare.options())}
