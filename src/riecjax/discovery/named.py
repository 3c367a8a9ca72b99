"""A candidate of a file, by its name: what a discovered model's file asks for."""

from riecjax.discovery.candidate import Candidate, as_candidates
from riecjax.errors import ModelError
from riecjax.models.catalogue import object_of_file


def named(reference: str, name: str) -> Candidate:
    """The candidate of this name among those that `path/to/file.py:object` holds.

    **Raises:** `ModelError` if there is no such file, object or candidate, or it has a width.
    """
    for one in as_candidates(object_of_file(reference)):
        if one.name == name and isinstance(one, Candidate):
            return one
    raise ModelError(f"{reference} holds no candidate '{name}'.")
