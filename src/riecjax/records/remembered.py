"""Answers that are kept by the content of what they were made of, so that none is found twice.

A file is looked at when it is read and its record again when it is assessed, mostly unchanged.
"""

import functools
import hashlib
import pickle
from collections import OrderedDict
from collections.abc import Callable
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Answer = TypeVar("Answer")
MOST = 32
"""Answers of one function that are kept."""


def remembered(function: Callable[Given, Answer]) -> Callable[Given, Answer]:
    """A function of arrays, numbers and words that keeps its last answers, which nobody may
    change."""
    kept: OrderedDict[bytes, Answer] = OrderedDict()

    @functools.wraps(function)
    def found(*args: Given.args, **kwargs: Given.kwargs) -> Answer:
        # Protocol 4 writes arrays out, however they lie in memory.
        content = pickle.dumps((args, kwargs), protocol=4)
        key = hashlib.blake2b(content, digest_size=16).digest()
        # Of two threads both may find it, which does no harm.
        answer = kept[key] if key in kept else function(*args, **kwargs)
        kept[key] = answer
        kept.move_to_end(key)
        while len(kept) > MOST:
            kept.popitem(last=False)
        return answer

    return found
