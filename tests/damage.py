"""Files as they come back from a bad disk or a cut transfer, and what reading them may lead to."""

from pathlib import Path

import numpy as np

from riecjax.doubts.reading import read_record
from riecjax.errors import RiecjaxError


def outcome(path: Path, content: bytes) -> str | None:
    """Read these bytes: `None` for a record in order, or the message; anything else fails."""
    path.write_bytes(content)
    try:
        record = read_record(path)
    except RiecjaxError as error:
        message = str(error)
        assert "\n" not in message
        assert message.startswith(path.name)
        assert len(message) < 3000
        return message
    for values in (*record.arrays.values(), record.time, record.time_step):
        assert np.isfinite(np.asarray(values)).all()
    return None


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four injuries of a kind that files suffer."""
    for _ in range(rng.integers(1, 5)):
        size = len(content)
        a, b = sorted(int(place) for place in rng.integers(0, size + 1, 2))
        kind = rng.integers(0, 7)
        if kind == 0:
            content = content[:a]
        elif kind == 1 and size:
            flipped = bytearray(content)
            for place in rng.integers(0, size, rng.integers(1, 9)):
                flipped[place] ^= 1 << int(rng.integers(0, 8))
            content = bytes(flipped)
        elif kind == 2:
            content = content[:a] + rng.bytes(int(rng.integers(1, 40))) + content[a:]
        elif kind == 3:
            content = content[:a] + content[b:]
        elif kind == 4:
            content = content[:a] + content[a:b] + content[a:b] + content[b:]
        elif kind == 5:
            content = content[:a] + bytes(min(b - a, 64)) + content[min(b, a + 64) :]
        elif size:
            # Counts and sizes are four bytes on a multiple of four: make one huge.
            place = 4 * int(rng.integers(0, max(size // 4, 1)))
            content = content[:place] + b"\xff\xff\xff\x7f" + content[place + 4 :]
    return content
