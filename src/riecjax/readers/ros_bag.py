"""Reading bags of ROS 1 (.bag) and ROS 2 (.mcap, .db3, or their folder), with the extra `ros`."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.records import reading

LONGEST_ARRAY = 100
"""Elements of a field past which it is a picture or a cloud, and no set of channels."""
CLOCKS_AGREE = 60e9
"""Nanoseconds by which stamps of a message and of its log may differ on one clock."""


@reading.apart("ROS bag", needs="ROS", is_trusted=False)
def read_ros_bag(file: Path) -> reading.Channels:
    """Read a bag: fields of the messages of a topic, called `/topic.field`.

    Fields in fields are called `/topic.field.x`, elements of arrays `/topic.field[0]`; where there
    is one topic, its name is left out. A topic's time is that of its headers' stamps where these
    rise, else that at which messages were logged; it is called `/topic.time`, from the earliest
    of all on. Bags are packed, and decoded by code that the library makes from what they declare,
    so it reads in a process of its own.

    **Raises:** `DataError` for a damaged bag, or where rosbags is not installed; `MemoryError`.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    rows: dict[str, list[dict[str, Any]]] = {}
    logged: dict[str, list[int]] = {}
    # Bags of ROS 2 before 2023 don't hold the types of their messages.
    with AnyReader([file], default_typestore=get_typestore(Stores.LATEST)) as source:
        for connection, stamp, raw in source.messages():
            message = _plain(source.deserialize(raw, connection.msgtype))
            rows.setdefault(connection.topic, []).append(message)
            logged.setdefault(connection.topic, []).append(stamp)
    times = {topic: _stamps(rows[topic], logged[topic]) for topic in rows}
    earliest = min((int(stamps[0]) for stamps in times.values()), default=0)
    whole = reading.Channels({})
    for topic, messages in rows.items():
        fields = reading.gathered(topic, messages)
        reading.check_declared(len(whole.columns) + len(fields.columns))
        is_taken = f"{topic}.time" in {*fields.columns, *fields.left_out}
        time = f"{topic}.log_time" if is_taken else f"{topic}.time"
        whole.take(time, (times[topic] - earliest) * 1e-9, "s")
        whole.take_all(replace(fields, time_of=dict.fromkeys(fields.columns, time)))
        if times[topic].tolist() != logged[topic]:
            whole.notes.append(f"topic '{topic}': time by its headers")
    return reading.without_common_group(whole, ".")


def _plain(message: Any) -> Any:
    """A message as dictionaries, lists and numbers."""
    if isinstance(message, np.ndarray):
        return message.tolist() if message.size <= LONGEST_ARRAY else f"{message.size} numbers"
    if isinstance(message, list):
        return list(map(_plain, message[:LONGEST_ARRAY]))
    fields = getattr(message, "__dataclass_fields__", None)
    if fields is None:
        return message
    return {name: _plain(getattr(message, name)) for name in fields if name != "__msgtype__"}


def _stamps(rows: list[dict[str, Any]], logged: list[int]) -> np.ndarray:
    """Nanoseconds of a topic's messages, on the clock of the log; headers are taken out of them."""
    headers = [row.pop("header", None) for row in rows]
    log = np.array(logged, np.int64)
    stamps = [header["stamp"] for header in headers if isinstance(header, dict)]
    if len(stamps) < len(rows):
        return log
    own = np.array([s["sec"] * 10**9 + s["nanosec"] for s in stamps], np.int64)
    if not (np.diff(own) > 0).all():
        return log
    ahead = own[0] - log[0]
    return own if abs(ahead) < CLOCKS_AGREE else own - ahead
