"""What files a result was made from: their digests, and which of them are others by now."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from riecjax.findings import Finding
from riecjax.whole_files import seen_from


def digests(files: Iterable[str], folder: Path | None = None) -> list[dict[str, Any]]:
    """Size and SHA-256 of files, of those that are there.

    **Arguments:** `folder`, where names of files start from; here if `None`.
    """

    def sha256(file: str) -> str:
        with open(file, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()

    return [
        {"file": seen_from(folder, file), "bytes": os.path.getsize(file), "sha256": sha256(file)}
        for file in filter(os.path.isfile, files)
    ]


def changed_files(
    files: Iterable[str], recorded: Iterable[Mapping[str, str]], result: Path
) -> Iterator[Finding]:
    """Files that differ from those that a result was made from.

    **Arguments:** `recorded`, digests of these, with names as seen from the result's folder.
    """
    folder = os.path.dirname(result)
    known = {os.path.normpath(os.path.join(folder, d["file"])): d["sha256"] for d in recorded}
    for file in digests(file for file in files if file in known):
        before, now = known[os.path.normpath(file["file"])], file["sha256"]
        if now != before:
            said = (
                f"{file['file']} is not the file that {result.name} was made from (its SHA-256 "
                f"begins with {now[:8]}, not {before[:8]}): these numbers are of the new file."
            )
            yield Finding("file_changed", said)
