"""Job files: the options of a command in TOML, or in the results.json that they led to."""

import codecs
import json
from pathlib import Path
from typing import Any

import click

from riecjax.whole_files import read_plain


def read_job(file: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The options that a file holds, and digests of their files if it is a results.json.

    **Raises:** `click.UsageError` if it is no job.
    """
    try:
        content = read_plain(file)
        # PowerShell 5 redirects to UTF-16, which begins with its mark.
        is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = content.decode("utf-16" if is_utf_16 else "utf-8-sig")
        if file.suffix.lower() == ".json":
            document = json.loads(text)
            if not all(isinstance(document[key], dict) for key in ("job", "provenance")):
                raise KeyError("job")
            from riecjax.reporting.document import SCHEMA, is_intact, unread_schema

            if why := unread_schema(document.get("schema", SCHEMA)):
                raise click.UsageError(f"--job {file}: {why}.")
            if not is_intact(document):
                raise click.UsageError(
                    f"--job {file}: it is damaged or was changed: its checksum differs. Other "
                    f"options stand beside --job, or in a TOML file ('riecjax init' prints one)."
                )
            recorded = document["provenance"].get("files", [])
            return dict(document["job"]), [
                {"file": str(one["file"]), "sha256": str(one["sha256"])} for one in recorded
            ]
        import tomllib

        return tomllib.loads(text), []
    except OSError as error:
        raise click.UsageError(f"--job {file}: cannot be read: {error.strerror}.") from None
    except (KeyError, TypeError, RecursionError):
        raise click.UsageError(f"--job {file}: it is no results.json with a job.") from None
    except UnicodeDecodeError as error:
        raise click.UsageError(
            f"--job {file}: byte {error.start} is not UTF-8; save the file as UTF-8."
        ) from None
    except ValueError as error:  # of TOML and JSON
        toml = "" if file.suffix.lower() == ".json" else " Words stand in quotes in TOML."
        raise click.UsageError(f"--job {file}: it is not understood: {error}.{toml}") from None
