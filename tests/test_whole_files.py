"""Files that appear whole or not at all, and what is made of damaged ones."""

import os
from pathlib import Path

import pytest

from riecjax import whole_files
from riecjax.whole_files import (
    Store,
    is_stamped,
    stamp,
    sweep,
    temporary,
)

CONTENT = bytes(range(256)) * 3


@pytest.mark.parametrize("is_folder", [False, True])
def test_what_is_in_use_stays_and_what_is_not_goes(tmp_path, is_folder):
    left = tmp_path / f".riecjax-{'0' * 32}"
    if is_folder:
        (left / "inside").mkdir(parents=True)
    else:
        left.touch()
    others = [tmp_path / name for name in (".riecjax-notes", ".riecjax-" + "0" * 31, "a.csv")]
    for other in others:
        other.touch()
    with temporary(tmp_path, is_folder=is_folder) as made:
        sweep(tmp_path)
        assert made.exists()
        assert not left.exists()
    assert sorted(tmp_path.iterdir()) == sorted(others)


def test_what_was_swept_before_it_was_locked_is_made_again(tmp_path, monkeypatch):
    flock, swept = whole_files.fcntl.flock, []

    def first_swept(descriptor: int, kind: int) -> None:
        if not swept:
            swept.extend(tmp_path.iterdir())
            swept[0].unlink()
        flock(descriptor, kind)

    monkeypatch.setattr(whole_files.fcntl, "flock", first_swept)
    with temporary(tmp_path) as made:
        assert made.exists()
        assert made not in swept


def test_a_store_forgets_what_was_not_used_for_longest(tmp_path):
    store = Store(tmp_path, "-cache", 3 * (len(CONTENT) + 32))
    for age, key in enumerate("abc"):
        store.put(key, CONTENT)
        os.utime(tmp_path / f"{key}-cache", (1000 + age, 1000 + age))
    assert store.get("a") == CONTENT  # used now
    store.put("d", CONTENT)
    assert [key for key in "abcd" if store.get(key) is None] == ["b"]
    (tmp_path / "a-cache").write_bytes(b"damaged")
    assert store.get("a") is None
    store.put("a", CONTENT)
    assert store.get("a") == CONTENT
    Store(tmp_path / "absent", "", 10**6).put("a", CONTENT)


def test_a_stamp_tells_a_file_from_a_copy_of_it(tmp_path):
    file, copy, folder = (tmp_path / name for name in ("a.png", "b.png", "c.png"))
    folder.mkdir()
    for each in (file, copy):
        each.write_text(f"... {stamp(file)} ...")
    assert [is_stamped(each) for each in (file, copy, folder, Path("absent"))] == [
        True,
        False,
        False,
        False,
    ]
