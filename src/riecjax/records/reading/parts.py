"""Which recordings a file holds: elements of a cell or an array of structures, groups, sheets.

Names alone do not tell a recording from a sensor: `Y(1).Data`, `Y(2).Data` are two channels of one
recording, and `X.time`, `X.signals.values` is one of Simulink's. So a part counts as a recording
where it holds signals with names of their own, and is timed by itself.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Literal, NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import Channels
from riecjax.records.reading.times import is_called_time, listed
from riecjax.records.reading.units import split_unit

_INDEXED = re.compile(
    r"(?P<head>[^(){}\[\]]*[^(){}\[\]\s])(?P<index>[({]\d+[)}])(?P<rest>.*)", re.S
)
_NUMBERED = re.compile(r"(?P<stem>.*?)[ _-]?(?P<number>\d+)", re.S)
_SEPARATOR = re.compile(r"[./]")
GENERIC = frozenset(("data", "value", "values", "signal", "signals", "samples"))
"""What a channel's samples are called in a structure of one channel."""
CHOOSE = "choose one by part='NAME' (on the command line: --part NAME)"
DEEPEST_GROUP = 3
"""Groups within groups in which recordings are looked for."""
UNLIKE = 0.05
"""Share by which lengths of groups without numbers differ, if they are recordings, not sensors."""


class Parts(NamedTuple):
    """Recordings in a file, by name; `""` where the whole file is one. Of `broken` ones, why."""

    held: dict[str, Channels]
    broken: Mapping[str, str] = {}


Member = dict[str, str]
"""Columns of a part: their names inside it, to those in the file."""


class _Family(NamedTuple):
    """Parts that may be recordings, by name. `kind`: what tells them apart."""

    members: dict[str, Member]
    kind: Literal["sheet", "element", "number", "name"]

    def usual(self) -> frozenset[str]:
        """The columns that most members have; of equally many, the most columns."""
        kinds = [frozenset(member) for member in self.members.values()]
        return max(kinds, key=lambda kind: (kinds.count(kind), len(kind)), default=frozenset())

    @property
    def differs(self) -> bool:
        """Whether these are sheets of different kinds."""
        return self.kind == "sheet" and len({frozenset(m) for m in self.members.values()}) > 1

    def has(self, names: Iterable[str]) -> bool:
        """Whether columns may be meant by all of these names; see [`column_named`][]."""
        return all(
            any(n in (c, split_unit(c)[0]) or c.endswith((f".{n}", f"/{n}")) for c in self.usual())
            for n in names
        )


def recordings_in(channels: Channels, named: Collection[str] = (), part: str = "") -> Parts:
    """The recordings that a file holds, each with columns called as if it were alone in its file.

    Columns beside the parts that are as long as a part belong to it too.

    **Arguments:** `named`: columns that are asked for. Where one of them is named in full, as
    `runs(1).x`, the file is read as one recording; else those parts count that have them. `part`:
    the name of the only one that is wanted, which may be any part at all.

    **Raises:** `DataError` if there is no such part, or where it is unclear which parts are meant.
    """
    if channels.parts:
        members = {
            sheet: {
                name.removeprefix(f"{sheet}/"): name
                for name in channels.columns
                if name.startswith(f"{sheet}/")
            }
            for sheet in channels.parts
        }
        families = [_Family(members, "sheet")]
    elif channels.nested:
        families = [*_structures(channels), *_cells(channels), *_groups(channels)]
    else:
        families = []
    if part:
        for family in families:
            if part in family.members:
                return Parts({part: _alone(channels, family.members[part])})
        names = dict.fromkeys(name for family in families for name in family.members)
        raise DataError(f"there is no part '{part}'; there are: {listed(names) or 'none'}.")
    found = [family for family in families if _are_recordings(family, channels)]
    inside = {column for f in found for member in f.members.values() for column in member.values()}
    if not found or inside & {*named}:
        return Parts({"": channels})
    found = [f for f in found if f.has(named)] or found
    if len({family.usual() for family in found}) > 1 or any(family.differs for family in found):
        kinds = (
            item for f in found for item in list(f.members.items())[: None if f.differs else 1]
        )
        listing = "; ".join(f"{name} with {listed(member)}" for name, member in kinds)
        raise DataError(f"it holds recordings of several kinds: {listing}; {CHOOSE}.")
    held, broken = {}, {}
    for family in found:
        for name, member in family.members.items():
            if lacking := sorted(family.usual() - member.keys()):
                broken[name] = f"it lacks {listed(lacking)}"
            else:
                held[name] = _alone(channels, member)
    return Parts(held, broken)


def several(names: Collection[str]) -> DataError:
    """The error of a file with several recordings where one is wanted."""
    return DataError(
        f"it holds {len(names)} recordings: {listed(names)}; read all of them with"
        f" rx.read_recordings, or {CHOOSE}."
    )


def _alone(channels: Channels, member: Member) -> Channels:
    """A part as a file of its own, with what lies beside the parts and is as long."""
    columns = {inner: channels.columns[name] for inner, name in member.items()}
    sizes = {values.size for values in columns.values()}
    timed = any(map(_is_time, columns))
    source = dict(member)
    for name, values in channels.columns.items():
        beside = not (_INDEXED.fullmatch(name) or _SEPARATOR.search(name))
        if beside and values.size in sizes and not (timed and _is_time(name)):
            source.setdefault(name, name)
    inner = {name: own for own, name in source.items()}
    times = {own: channels.time_of.get(name) for own, name in source.items()}
    return Channels(
        {own: channels.columns[name] for own, name in source.items()},
        {own: channels.units[name] for own, name in source.items() if name in channels.units},
        {own: inner[time] for own, time in times.items() if time in inner},
        channels.left_out,
        channels.notes,
    )


def _structures(channels: Channels) -> Iterator[_Family]:
    """Arrays of structures, and cells with structures in them: `runs(1).x`, `runs{1}.x`."""
    heads: dict[str, dict[str, Member]] = {}
    for name in _every_name(channels):
        found = _INDEXED.fullmatch(name)
        if found and found["rest"].startswith("."):
            members = heads.setdefault(found["head"], {})
            member = members.setdefault(found["head"] + found["index"], {})
            if name in channels.columns:
                member[found["rest"][1:]] = name
    return (_Family(members, "element") for members in heads.values())


def _cells(channels: Channels) -> Iterator[_Family]:
    """Cells of vectors and matrices, those of equal lengths together: `T{1}`, `X{1}[0]`, ..."""
    heads: dict[str, dict[str, Member]] = {}
    for name in channels.columns:
        found = _INDEXED.fullmatch(name)
        if found and found["index"][0] == "{" and not found["rest"].startswith("."):
            inner = _SEPARATOR.split(found["head"])[-1] + found["rest"]
            heads.setdefault(found["head"], {}).setdefault(found["index"], {})[inner] = name
    gathered: list[tuple[str, dict[str, Member]]] = []
    for head, members in heads.items():
        for _, family in gathered:
            common = family.keys() & members.keys()
            if len(common) == min(len(family), len(members)) and all(
                _size(channels, family[index]) == _size(channels, members[index])
                for index in common
            ):
                for index, member in members.items():
                    family.setdefault(index, {}).update(member)
                break
        else:
            gathered.append((head, members))
    for head, members in gathered:
        yield _Family({head + index: member for index, member in members.items()}, "element")


def _groups(channels: Channels) -> Iterator[_Family]:
    """Groups within one group, those with numbers behind one stem together: `run1/x`, `run2/x`."""
    names = [name for name in _every_name(channels) if not _INDEXED.fullmatch(name)]
    for depth in range(DEEPEST_GROUP):
        families: dict[tuple[str, bool], dict[str, Member]] = {}
        for name in names:
            marks = [mark.start() for mark in _SEPARATOR.finditer(name)]
            if len(marks) <= depth:
                continue
            group, inner = name[: marks[depth]], name[marks[depth] + 1 :]
            found = _NUMBERED.fullmatch(group)
            stem = found["stem"] if found else name[: marks[depth - 1]] if depth else ""
            member = families.setdefault((stem, bool(found)), {}).setdefault(group, {})
            if name in channels.columns:
                member[inner] = name
        for (_, numbered), members in families.items():
            # Groups of HDF5 stand in the order of the alphabet, run10 before run2.
            number = {g: match for g in members if (match := _NUMBERED.fullmatch(g))}
            order = sorted(members, key=lambda g: int(number[g]["number"])) if numbered else members
            yield _Family({g: members[g] for g in order}, "number" if numbered else "name")


def _every_name(channels: Channels) -> list[str]:
    """Names of columns, and of what was left out: an empty part is a part."""
    return [*channels.columns, *channels.left_out]


def _are_recordings(family: _Family, channels: Channels) -> bool:
    if len(family.members) < 2 or family.kind == "sheet":
        return len(family.members) >= 2
    usual = family.usual()
    signals = [name for name in usual if not _is_time(name)]
    # The last of their names, without a place in a matrix.
    bare = [_SEPARATOR.split(name)[-1].partition("[")[0].lower() for name in signals]
    if len(usual) < 2 or {*bare} <= {*GENERIC}:
        return False
    members = [member for member in family.members.values() if member]
    sizes = {_size(channels, member) for member in members}
    if len(signals) < len(usual):
        # Sensors record for as long as each other, tests rarely.
        spans = [_span(channels, member) for member in members]
        apart = len(signals) > 1 and max(spans) > (1 + UNLIKE) * min(spans)
        return family.kind != "name" or apart
    if family.kind != "element":
        return family.kind == "number" and len(sizes) > 1
    beside = {channels.columns[name].size for name in channels.columns if _is_time(name)}
    return not (len(sizes) == 1 and sizes <= beside)


def _is_time(name: str) -> bool:
    return is_called_time(_SEPARATOR.split(name)[-1], {})


def _size(channels: Channels, member: Member) -> int:
    return max((channels.columns[name].size for name in member.values()), default=0)


def _span(channels: Channels, member: Member) -> float:
    """How long a part lasts, in the units of its time; 0 without one."""
    times = [channels.columns[name] for inner, name in member.items() if _is_time(inner)]
    return max((float(np.nanmax(time) - np.nanmin(time)) for time in times), default=0.0)
