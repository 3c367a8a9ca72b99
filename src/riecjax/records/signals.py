"""The signals of a record by name."""

from collections.abc import Iterator, Mapping

from jaxtyping import Array

from riecjax.errors import MissingSignalError


class Signals(Mapping[str, Array]):
    """The signals of a record by name; asking for one that is missing says which ones exist.

    `read` collects the names that were asked for: which signals an expression depends on.
    """

    def __init__(self, arrays: Mapping[str, Array]):
        self._arrays = dict(arrays)
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> Array:
        try:
            value = self._arrays[name]
        except KeyError:
            raise MissingSignalError(name, tuple(self._arrays)) from None
        self.read.add(name)
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __contains__(self, name: object) -> bool:
        return name in self._arrays
