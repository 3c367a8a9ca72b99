"""Files that appear whole or not at all, and what stands beside them."""

import os
from pathlib import Path

import click
import pytest

import riecjax as rx
from riecjax.cli.command import read_job
from riecjax.errors import DataError
from riecjax.reporting.output import require_folder
from riecjax.whole_files import is_stamped, require_plain, stamp, sweep, temporary

CONTENT = bytes(range(256)) * 3
LEFT = f".riecjax-{'0' * 32}"
LONG_AGO = (0, 0)


@pytest.mark.portable
@pytest.mark.parametrize("is_folder", [False, True])
def test_what_was_left_long_ago_goes_and_all_else_stays(tmp_path, is_folder):
    left = tmp_path / LEFT
    if is_folder:
        (left / "inside").mkdir(parents=True)
    else:
        left.touch()
    others = [tmp_path / name for name in (".riecjax-notes", ".riecjax-" + "0" * 31, "a.csv")]
    for other in others:
        other.touch()
        os.utime(other, LONG_AGO)
    with temporary(tmp_path, is_folder=is_folder) as made:
        assert left.exists()  # it may be another process's
        os.utime(left, LONG_AGO)
        sweep(tmp_path)
        assert made.exists()
        assert not left.exists()
    assert sorted(tmp_path.iterdir()) == sorted(others)


def test_what_is_no_plain_file_is_never_opened(tmp_path):
    """A pipe would wait for ever; a link leads elsewhere."""
    os.mkfifo(tmp_path / LEFT)
    (tmp_path / LEFT.replace("0", "1")).symlink_to("/dev/zero")
    for path in tmp_path.iterdir():
        os.utime(path, LONG_AGO, follow_symlinks=False)
    with temporary(tmp_path):
        pass
    assert len(list(tmp_path.iterdir())) == 2
    os.mkfifo(tmp_path / "a.png")
    assert not is_stamped(tmp_path / "a.png")
    for name in ("a.png", LEFT):
        with pytest.raises(OSError, match="no plain file"):
            require_plain(tmp_path / name)
        with pytest.raises(DataError, match="no plain file"):
            rx.load(tmp_path / name)
        with pytest.raises(click.UsageError, match="cannot be read: it is no plain file"):
            read_job(tmp_path / name)


def test_a_result_that_is_no_text_is_one_line(tmp_path):
    (tmp_path / "results.json").write_bytes(b'{"a": "\xff"}')
    with pytest.raises(DataError, match="byte 7 is not UTF-8"):
        rx.load(tmp_path / "results.json")


@pytest.mark.parametrize("name", ["file", "file/inside", "a" * 300])
def test_a_folder_that_cannot_be_is_refused_before_the_work(tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="cannot write to"):
        require_folder(tmp_path / name)
    require_folder(tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_stamp_tells_a_file_from_a_copy_of_it_by_its_ends(tmp_path, monkeypatch):
    file, copy, folder = (tmp_path / name for name in ("a.png", "b.png", "c.png"))
    folder.mkdir()
    for each in (file, copy):
        each.write_text(f"... {stamp(file)} ...")
    (tmp_path / "d.png").write_text(stamp(tmp_path / "d.png"))
    with (tmp_path / "d.png").open("ab") as stream:
        stream.truncate(2**34)  # of which only the ends are read
    found = {path.name for path in (*tmp_path.iterdir(), Path("absent")) if is_stamped(path)}
    assert found == {"a.png", "d.png"}
