"""A fleet's groups are estimated as their recordings would be, whoever sums these, and whenever."""

import itertools
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
import scipy.io
from pyarrow import parquet
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_fleet as drives

import riecjax as rx
from riecjax.fleets import engine, groups, kept, order, sources
from riecjax.fleets.report import Fleet, sentence

MODEL = rx.find_model("drag-oscillator")
SAMPLES = 1500


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Three vehicles of three drives each; a file of the last is none, and one a copy."""
    place = tmp_path_factory.mktemp("fleet")
    for vehicle in range(3):
        own = place / f"vehicle={vehicle}"
        own.mkdir()
        for i, record in enumerate(drives(3, SAMPLES, 10 + vehicle)):
            rx.write_record(own / f"{i}.parquet", record)
    (place / "vehicle=2/broken.parquet").write_bytes(b"PAR1, but no more")
    shutil.copy(place / "vehicle=1/0.parquet", place / "vehicle=1/copy.parquet")
    return place


@pytest.fixture(scope="module")
def by_vehicle(folder, tmp_path_factory) -> tuple[Fleet, Path]:
    out = tmp_path_factory.mktemp("out")
    return rx.fleet(MODEL, folder, by="vehicle", workers=0, out=out), out


def values(found: Fleet, group: str) -> dict[str, tuple[float, float]]:
    return {
        e.parameter: (e.value, e.std_error)  # pyright: ignore[reportReturnType]
        for e in found.entries
        if e.group == group and e.status == "ok"
    }


def test_a_group_of_one_file_is_estimated_as_identify_does(folder):
    found = rx.fleet(MODEL, folder / "vehicle=0", workers=0)
    assert found.by == ("file",)
    for name in ("0.parquet", "2.parquet"):
        recording = rx.read_recording(folder / "vehicle=0" / name, model=MODEL)
        alone = rx.identify(MODEL, recording, found.criterion)
        for n, (value, error) in values(found, name).items():
            assert value == pytest.approx(float(alone[n]), rel=1e-9)
            errors = dict(zip(alone.parameters, np.asarray(alone.standard_errors)))
            assert error == pytest.approx(float(errors[n]), rel=1e-6)


def test_what_fails_is_a_row_with_its_reason(by_vehicle):
    found, out = by_vehicle
    lost = {e.group: e.status for e in found.entries if e.status != "ok"}
    assert set(lost) == {"vehicle=1", "vehicle=2"}
    assert "the same samples as vehicle=1/0.parquet" in lost["vehicle=1"]
    assert lost["vehicle=2"].startswith("broken.parquet: not a readable Parquet file")
    assert len(found.failures) == 2
    assert len(values(found, "vehicle=2")) == 4
    table = parquet.read_table(out / "estimates.parquet").to_pylist()
    assert [tuple(row.values()) for row in table] == [tuple(e) for e in found.entries]
    names = "group start end parameter value unit std_error low95 high95 verdict findings status"
    assert " ".join(table[0]) == names


def test_an_interrupted_run_goes_on_and_ends_in_the_same_bits(
    folder, by_vehicle, tmp_path, monkeypatch
):
    _, out = by_vehicle
    monkeypatch.setattr(engine, "TOGETHER", 2)
    summed, given = [], {"by": "vehicle", "workers": 0, "out": tmp_path}

    def interrupted(what: str, done: int, total: int, samples: int) -> None:
        if done >= 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rx.fleet(MODEL, folder, **given, progress=interrupted)
    parts = sorted((tmp_path / kept.PARTS).glob("*.parquet"))
    assert len(parts) == 2
    # One of them is damaged meanwhile.
    content = bytearray(parts[1].read_bytes())
    content[len(content) // 2] ^= 1
    parts[1].write_bytes(bytes(content))
    rx.fleet(MODEL, folder, **given, progress=lambda what, done, *_: summed.append((what, done)))
    assert ("summing", 2) in summed  # and not from none
    for name in ("summaries.parquet", "estimates.parquet"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes()
    assert not (tmp_path / kept.PARTS).exists()


def test_a_later_run_sums_only_what_is_new_or_has_changed(folder, tmp_path):
    drives_of = tmp_path / "drives"
    shutil.copytree(folder / "vehicle=0", drives_of)
    done = []

    def count(what: str, n: int, *_: int) -> None:
        done.extend([n] if what == "summing" else [])

    def run() -> Fleet:
        done.clear()
        settings = {"workers": 0, "out": tmp_path / "out", "progress": count}
        return rx.fleet(MODEL, drives_of, **settings)

    first = run()
    assert done[0] == 0
    run()
    assert done == []
    shutil.copy(folder / "vehicle=1/1.parquet", drives_of / "1.parquet")
    changed = run()
    assert done[0] == 2
    assert values(changed, "0.parquet") == values(first, "0.parquet")
    assert values(changed, "1.parquet") != values(first, "1.parquet")


def test_what_goes_on_changing_is_told(folder, tmp_path):
    drives_of = tmp_path / "drives"
    shutil.copytree(folder / "vehicle=0", drives_of)
    times = [0]

    def touched(what: str, done: int, total: int, samples: int) -> None:
        if what == "summing" and done == total:
            times[0] += 1
            shutil.copy(folder / f"vehicle={times[0] % 3}/1.parquet", drives_of / "1.parquet")

    found = rx.fleet(MODEL, drives_of, workers=0, progress=touched)
    assert found.changed == ["1.parquet"]
    assert "1 recording went on changing while summed (1.parquet): run" in sentence(found)


@pytest.mark.slow
def test_sums_of_an_earlier_run_are_estimated_anew(by_vehicle):
    found, out = by_vehicle
    table = out / "summaries.parquet"
    again = rx.fleet(MODEL, table, by="vehicle", workers=0)
    assert again.entries == found.entries
    held = rx.fleet(MODEL, table, by="vehicle", known={"k": 20.0}, workers=0)
    assert set(values(held, "vehicle=0")) == {"m", "r", "r2"}
    assert len({e.group for e in rx.fleet(MODEL, table, workers=0).entries}) == 11
    with pytest.raises(rx.ModelError, match="other equations"):
        rx.fleet(rx.find_model("duffing"), table, workers=0)


def test_columns_of_a_file_tell_its_recordings_apart(folder, by_vehicle, tmp_path):
    # A drive follows another, of another vehicle.
    runs = [(f"vehicle={v}/{i}", str(v), SAMPLES) for i in range(3) for v in range(2)]
    parquet.write_table(several(folder, runs), tmp_path / "all.parquet")
    found = rx.fleet(MODEL, tmp_path, by="vehicle", workers=0)
    for vehicle in ("vehicle=0", "vehicle=1"):
        for name, (value, _) in values(by_vehicle[0], vehicle).items():
            assert values(found, vehicle)[name][0] == pytest.approx(value, rel=1e-9)
    with pytest.raises(rx.DataError, match="no column 'truck'"):
        rx.fleet(MODEL, tmp_path, by="truck", workers=0)


def test_of_a_file_with_several_recordings_parts_are_asked_for(folder, tmp_path):
    runs = {}
    for name in ("0", "1"):
        table = parquet.read_table(folder / f"vehicle=0/{name}.parquet")
        runs[f"run{name}"] = {c: table[c].to_numpy() for c in table.column_names}
    scipy.io.savemat(tmp_path / "runs.mat", runs)
    found = rx.fleet(MODEL, tmp_path, workers=0, parts=["run1"])
    (row,) = found.recordings
    assert row.part == "run1"
    alone = rx.fleet(MODEL, folder / "vehicle=0/1.parquet", workers=0)
    for name, (value, _) in values(alone, "1.parquet").items():
        assert values(found, "runs.mat, run1")[name][0] == pytest.approx(value, rel=1e-6)
    assert len(rx.fleet(MODEL, tmp_path, workers=0).recordings) == 2
    with pytest.raises(rx.DataError, match="run7"):
        rx.fleet(MODEL, tmp_path, workers=0, parts=["run7"])
    with pytest.raises(rx.DataError, match="parts="):
        rx.fleet(MODEL, tmp_path, workers=0, parts="run1")


@pytest.mark.slow
def test_a_data_set_of_many_files_is_one_recording_whose_windows_all_count(tmp_path, monkeypatch):
    (record,) = drives(1, 2**17 + 70000, 5)
    rx.write_record(tmp_path / "whole.parquet", record)
    table = parquet.read_table(tmp_path / "whole.parquet")
    monkeypatch.setattr(order, "STRETCH", 2**17)
    monkeypatch.setattr(sources, "LONG", 2**40)
    (tmp_path / "week.parquet").mkdir()
    cuts = [0, 30011, 130000, 131100, table.num_rows]
    for i, (a, b) in enumerate(itertools.pairwise(cuts)):
        parquet.write_table(table.slice(a, b - a), tmp_path / f"week.parquet/{i}.parquet")
    given = {"noise": {"u": 0.0, "x": 0.01, "dx": 0.03}, "align": "none", "outliers": "keep"}
    parts = rx.fleet(MODEL, tmp_path / "week.parquet", workers=0, **given)
    whole = rx.fleet(MODEL, tmp_path / "whole.parquet", workers=0, **given)
    assert len(parts.recordings) == 2
    assert parts.samples == whole.samples == record.sample_count
    for name, (value, _) in values(whole, "whole.parquet").items():
        assert values(parts, "week.parquet")[name][0] == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("given", [{"criterion": rx.DOLS()}, {"noise": "none"}], ids=str)
def test_sums_that_say_nothing_of_noise_are_estimated(folder, given):
    found = rx.fleet(MODEL, folder / "vehicle=0/0.parquet", workers=0, **given)
    assert values(found, "0.parquet")["k"][0] == pytest.approx(TRUTH["k"], rel=0.2)


def several(folder: Path, runs: list[tuple[str, str, int]]) -> pa.Table:
    """Drives after each other: file, what the column of the vehicle says, rows."""
    return pa.concat_tables(
        parquet.read_table(folder / f"{file}.parquet")
        .append_column("vehicle", pa.array([name] * SAMPLES))
        .slice(0, rows)
        for file, name, rows in runs
    )


def test_one_bad_recording_of_a_file_leaves_the_others(folder, tmp_path):
    rows = {"a": SAMPLES, "b": 5, "c": SAMPLES}
    runs = [(f"vehicle=0/{i}", name, count) for i, (name, count) in enumerate(rows.items())]
    parquet.write_table(several(folder, runs), tmp_path / "all.parquet")
    found = rx.fleet(MODEL, tmp_path, by="vehicle", workers=0)
    assert values(found, "vehicle=a")
    assert values(found, "vehicle=c")
    (failed,) = found.failures
    assert failed.part == f"vehicle=b, from row {SAMPLES} on"


def test_what_a_run_writes_is_no_recording_of_the_next(folder, tmp_path):
    shutil.copytree(folder / "vehicle=0", tmp_path / "drives")
    pattern = f"{tmp_path}/**/*.parquet"
    first, again = (rx.fleet(MODEL, pattern, workers=0, out=tmp_path / "out") for _ in range(2))
    assert again.entries == first.entries
    assert len(again.recordings) == 3


def test_a_group_without_an_answer_is_counted_and_all_of_them_are_an_error(folder, monkeypatch):
    real, calls = groups.assess_summary, []

    def failing(*args, **kwargs):
        calls.append(1)
        if len(calls) > fails_from:
            raise ZeroDivisionError("by chance")
        return real(*args, **kwargs)

    monkeypatch.setattr(groups, "assess_summary", failing)
    fails_from = 1
    found = rx.fleet(MODEL, folder, by="vehicle", workers=0)
    assert [e.status for e in found.unanswered] == ["ZeroDivisionError: by chance"] * 2
    fails_from = 0
    calls.clear()
    with pytest.raises(rx.DataError, match="no group can be estimated; the first: ZeroDivision"):
        rx.fleet(MODEL, folder, by="vehicle", workers=0)


def test_of_a_part_with_a_flipped_bit_all_is_made_anew_or_nothing_has_changed(by_vehicle, tmp_path):
    _, out = by_vehicle
    content = (out / kept.SUMMARIES).read_bytes()
    rows = list(kept.read_rows(out / kept.SUMMARIES))
    digest = parquet.read_metadata(out / kept.SUMMARIES).metadata[kept.ORDER].decode()
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    whole = [row.piece for row in rows if row.status == "ok"]
    for place in (*range(0, footer, footer // 100), *range(footer, len(content), 7)):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        (tmp_path / kept.PARTS).mkdir(exist_ok=True)
        (tmp_path / kept.PARTS / "0.parquet").write_bytes(bytes(damaged))
        store = kept.SumStore(tmp_path, SimpleNamespace(digest=digest, model=MODEL))  # pyright: ignore[reportArgumentType]
        pieces = [piece for piece in whole if piece in store]
        assert pieces in ([], whole)
        if pieces:
            file = store.finish(pieces)
            assert list(kept.read_rows(file)) == [row for row in rows if row.status == "ok"]
            file.unlink()


def test_an_interval_of_many_recordings_holds_what_differs_between_them(tmp_path):
    """Within one recording it is alike: blocks of its own would be nine times the same."""
    rng = np.random.default_rng(0)
    stiffness = TRUTH["k"] * (1 + 0.02 * rng.standard_normal(12))
    for i, k in enumerate(stiffness):
        (record,) = drives(1, SAMPLES, 50 + i, k=float(k))
        rx.write_record(tmp_path / f"{i}.parquet", record)
    found = rx.fleet(MODEL, tmp_path, by="folder", workers=0)
    (entry,) = [e for e in found.entries if e.parameter == "k"]
    scatter = float(np.std(stiffness, ddof=1)) / np.sqrt(12)
    assert entry.std_error is not None
    assert 0.85 * scatter < entry.std_error < 1.3 * scatter


def test_sums_are_not_read_in_another_way_and_no_other_run_replaces_them(by_vehicle, folder):
    _, out = by_vehicle
    before = (out / "summaries.parquet").read_bytes()
    given = {"stop": 2.0, "cutoffs": {"x": 10.0}, "every": 1, "noise": "auto"}
    with pytest.raises(rx.DataError, match="cannot heed parts, stop, cutoffs"):
        rx.fleet(MODEL, out / "summaries.parquet", workers=0, parts=["a"], **given)
    with pytest.raises(rx.DataError, match=r"holds sums by another model.*delete its summaries"):
        rx.fleet(MODEL, folder, by="vehicle", workers=0, out=out, stop=2.0)
    assert (out / "summaries.parquet").read_bytes() == before


def test_what_makes_no_answer_possible_is_said_before_anything_is_summed(folder, tmp_path):
    told = []
    settings = {"workers": 0, "progress": lambda *said: told.append(said)}
    for wrong in ({"by": "a,,b"}, {"span": -1.0}, {"workers": -1}):
        with pytest.raises(rx.ModelError, match=f"{next(iter(wrong))}[: ]"):
            rx.fleet(MODEL, folder, **{**settings, **wrong})
    with pytest.raises(rx.ModelError, match="kk"):
        rx.fleet(MODEL, folder, known={"kk": 20.0}, **settings)
    (tmp_path / "a.csv").write_text("nothing")
    with pytest.raises(rx.DataError, match="none of the first 1 recordings"):
        rx.fleet(MODEL, tmp_path, **settings)
    assert told == []
    with pytest.raises(rx.DataError, match=r"broken\.parquet: not a readable"):
        rx.fleet(MODEL, folder, by="vehicle", strict=True, **settings)
