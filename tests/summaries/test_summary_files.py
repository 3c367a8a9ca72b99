"""Summaries in files, from other processes, put together and taken apart."""

import io
import json
import re
import zipfile
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import MACHINES, Shape

import riecjax as rx
from nightly import by_day, nightly
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.summaries import summary_files

STEP = 0.01
KEY = jax.random.key(3)
TRUTH = MACHINES["linear"].truth
OSCILLATOR = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg"),
    rx.Term("c", "x", derivative=1, measured=("dx",), unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "u", unit="N"),
    name="oscillator",
)
SPRING = rx.Equation(rx.Term("k", "x"), -rx.Term(1.0, "f"), name="spring")


@cache
def record(count: int = 1500, seed: int = 0, rate: int = 100, k2: float = 0.0) -> rx.Record:
    """An oscillator under an exact force, and white noise on that."""
    signals = MACHINES["linear"].signals(drive=seed, shape=Shape(count, rate))
    noise = 0.5 * np.random.default_rng(seed).normal(size=count)
    signals["u"] = signals["u"] + k2 * signals["x"] ** 2 + noise
    return rx.Record.from_samples(signals, time_step=1 / rate)


class Parabola(rx.Bump):
    """Of one's own: a bump with further settings."""

    name: ClassVar[str] = "parabola"
    powers: tuple[float, ...] = eqx.field(static=True, default=(1.0, 0.1))
    scale: jax.Array | None = None


ALL = rx.AllWindows(0.1, 0.6)
BOXCAR = rx.RIEC(ALL)
CRITERIA: dict[str, AbstractCriterion] = {
    "dols": rx.DOLS(),
    "boxcar": BOXCAR,
    "hat": rx.RIEC(ALL, rx.Hat(quadrature=6)),
    "bump": rx.RIEC(ALL, rx.Bump(5, lengths=7)),
    "fixed limit": rx.RIEC(rx.AllWindows(0.1, 0.6, longest_samples=100)),
    "random": rx.RIEC(rx.RandomWindows(0.1, 0.6, 300), rx.Hat()),
    "between": rx.RIEC(rx.RandomWindows(0.1, 0.6, 300, between_samples=True)),
    "own": rx.RIEC(ALL, Parabola(4, 5, (0.1, 2.0), jnp.asarray(0.1, jnp.float32))),
}


def same_arrays(one: object, other: object) -> None:
    """Leaf by leaf the same bytes, in the same order in memory: NumPy adds up as that tells it."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other)):
        a, b = np.asarray(a), np.asarray(b)
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
        assert a.flags.c_contiguous
        assert b.flags.c_contiguous


def same_estimates(model: rx.Equation, one: rx.Summary, other: rx.Summary, **settings) -> None:
    a, b = (rx.estimate(model, summary, **settings) for summary in (one, other))
    assert a.parameters == b.parameters
    for get in (
        lambda e: e.theta,
        lambda e: e.uncertainty.covariance,
        lambda e: e.standard_errors,
        lambda e: [e.interval(name) for name in e.parameters],
    ):
        np.testing.assert_array_equal(np.asarray(get(a)), np.asarray(get(b)), strict=True)
    assert a.findings() == b.findings()


def through_a_file(summary: rx.Summary, folder: Path) -> rx.Summary:
    summary.save(folder / "kept.npz")
    return rx.load(folder / "kept.npz")


@pytest.mark.parametrize("name", by_day(CRITERIA, "hat", "own"))
def test_a_summary_comes_back_to_the_bit(name, tmp_path):
    records = [record(), record(2200, 2), record(1700, 3, 125)]
    bins = {"bins": 9, "survey": True} if name in ("hat", "bump") else {}
    summary = rx.summarise(OSCILLATOR, records, CRITERIA[name], key=KEY, **bins)
    shorter = summary.leave_out(2.0, 5.0, recording=1)
    for kept in (summary, shorter, *([summary.between(0.13, 0.5)] if bins else [])):
        again = through_a_file(kept, tmp_path)
        assert again.criterion == kept.criterion
        assert again.criterion.describe() == kept.criterion.describe()
        assert (again.outline, again.digests) == (kept.outline, kept.digests)
        assert (again.band, again.asked, again.in_law) == (kept.band, kept.asked, kept.in_law)
        same_arrays((again.recordings, again.edges), (kept.recordings, kept.edges))
        same_estimates(OSCILLATOR, again, kept, per_record=["c"])


def test_a_name_stays_as_it_is_and_nothing_else_is_left_behind(tmp_path):
    summary = rx.summarise(OSCILLATOR, record(), rx.DOLS())
    file = tmp_path / "sums of monday"
    file.write_text("older")
    summary.save(str(file))
    assert [path.name for path in tmp_path.iterdir()] == ["sums of monday"]
    same_arrays(rx.load(file).recordings, summary.recordings)
    with np.load(file, allow_pickle=False) as arrays:
        np.testing.assert_array_equal(
            arrays["recordings/0/stages/0/0/moments"], summary.recordings[0].stages[0][0].moments
        )
        assert json.loads(arrays["summary"].tobytes())["schema"] == 6


def refusal(path: Any) -> str:
    """Why a file is refused, in one line."""
    with pytest.raises(rx.DataError) as caught:
        rx.load(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_no_summary_is_refused_in_one_line(tmp_path):
    file = tmp_path / "other.npz"
    assert "there is no file" in refusal(file)
    assert "there is no file" in refusal(tmp_path)
    assert "the file is None" in refusal(None)
    for content in (b"", b"t,x\n0,1\n"):
        file.write_bytes(content)
        assert "not a zip file" in refusal(file)
    np.savez(file, x=np.zeros(3))
    assert "it is no Summary" in refusal(file)
    for content, words in (
        (np.frombuffer(b"[1, 2]", np.uint8), "it is no Summary"),
        (np.frombuffer(b"\xff{", np.uint8), "not a readable Summary file"),
        (np.array([{}], object), "Python objects"),
    ):
        np.savez(file, summary=content, allow_pickle=True)
        assert re.search(words, refusal(file))


def rewritten(file: Path, change, seal: bool = True) -> None:
    """Change the document and the arrays of a file, with a checksum that is right again or not."""
    with np.load(file) as archive:
        arrays = dict(archive)
    document = json.loads(arrays.pop("summary").tobytes())
    kept = document.pop("checksum")
    change(document, arrays)
    document["checksum"] = summary_files._checksum(document, arrays) if seal else kept
    arrays["summary"] = np.frombuffer(json.dumps(document).encode(), np.uint8)
    np.savez(file, **arrays)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d, _: d.update(schema=7, riecjax="9.1"), "schema 7, this version reads 6: .* 9.1"),
        (
            lambda d, _: d["summary"]["criterion"].update({"class": "Tent", "from": "rig"}),
            "Tent of 'rig'.*imp",
        ),
        (lambda d, _: d["summary"]["criterion"].update(speed=1), "RIEC has other settings"),
        (lambda d, _: d.update(summary=d["summary"]["criterion"]), "it holds no Summary"),
        (lambda _, a: a.pop("recordings/0/digest"), "arrays are not those"),
        (lambda _, a: a.update(more=np.zeros(2)), "arrays are not those"),
    ],
)
def test_other_contents_are_refused_in_one_line(change, words, tmp_path):
    file, name = tmp_path / "kept.npz", "recordings/0/stages/0/0/moments"
    rx.summarise(OSCILLATOR, record(), CRITERIA["boxcar"]).save(file)
    rewritten(file, lambda d, a: None)
    rx.load(file)
    rewritten(file, lambda _, a: np.multiply(a[name], 1 + 1e-15, out=a[name]), seal=False)
    assert "checksum" in refusal(file)
    rewritten(file, change)
    assert re.search(words, refusal(file))


@pytest.mark.parametrize("packing", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_damaged_files_are_refused_or_say_the_same(packing, tmp_path, monkeypatch):
    """Every fiftieth byte flipped, and files cut short: what passes has lost nothing."""
    monkeypatch.setattr("riecjax.records.writing.zipfile.ZIP_DEFLATED", packing)
    file = tmp_path / "kept.npz"
    summary = rx.summarise(SPRING, spring_record(600, 0), rx.RIEC(ALL), bins=2)
    summary.save(file)
    whole = file.read_bytes()
    refusals = []
    cut = [whole[:size] for size in range(0, len(whole), max(len(whole) // 50, 1))]
    flipped = []
    for place in range(0, len(whole), 50):
        for bits in (0xFF, 0x01):
            changed = bytearray(whole)
            changed[place] ^= bits
            flipped.append(bytes(changed))
    # The directory at the end is where most of what can be declared stands.
    for place in range(len(whole) - 400, len(whole)):
        flipped.append(whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :])
    for content in [*cut, *flipped]:
        file.write_bytes(content)
        try:
            again = rx.load(file)
        except rx.DataError as error:
            refusals.append(str(error))
        else:
            same_arrays(again.recordings, summary.recordings)
            assert again.criterion == summary.criterion
            assert (again.outline, again.band) == (summary.outline, summary.band)
    assert not any("\n" in words for words in refusals)
    assert len(refusals) > 0.5 * (len(cut) + len(flipped))


def test_a_file_that_declares_too_much_is_refused_before_it_is_read(tmp_path, monkeypatch):
    file = tmp_path / "kept.npz"
    rx.summarise(SPRING, spring_record(600, 0), rx.DOLS()).save(file)
    with zipfile.ZipFile(file) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
    with monkeypatch.context() as limit:
        limit.setattr(summary_files, "LARGEST", unpacked)
        rx.load(file)
        limit.setattr(summary_files, "LARGEST", unpacked - 1)
        limit.setattr(zipfile.ZipFile, "open", None)
        assert "declares to unpack to more" in refusal(file)
    huge = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        huge, {"descr": "|u1", "fortran_order": False, "shape": (10**15,)}
    )
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("summary.npy", huge.getvalue())
    assert "an array is larger than its file" in refusal(file)


def test_what_cannot_be_saved_is_refused_in_one_line(tmp_path, monkeypatch):
    file = tmp_path / "kept.npz"
    summary = rx.summarise(OSCILLATOR, record(), rx.DOLS())
    with pytest.raises(rx.DataError, match="No such file or directory"):
        summary.save(tmp_path / "none" / "kept.npz")
    with pytest.raises(rx.DataError, match="cannot write"):
        summary.save(tmp_path)
    batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), summary)
    with pytest.raises(rx.ModelError, match="one by one of a batch"):
        batch.save(file)
    monkeypatch.setattr(summary_files, "LARGEST", summary.byte_count)
    with pytest.raises(rx.ModelError, match="save its recordings apart"):
        summary.save(file)
    assert not list(tmp_path.iterdir())


def squares():
    """An expression that prints where it lies in memory, as it differs between processes."""

    def squared(power, signals):
        return signals["x"] ** power

    return partial(squared, 2)


@pytest.mark.slow
def test_a_recording_counts_once_whichever_process_summed_it():
    expressions = squares(), squares()
    assert str(expressions[0]) != str(expressions[1])
    models = [
        rx.Equation(rx.Term("k2", each, unit="N/m^2"), *OSCILLATOR.terms, name="oscillator")
        for each in expressions
    ]
    made = record(2300, 11, k2=4.0)
    one, other = (rx.summarise(model, made, CRITERIA["hat"], bins=3) for model in models)
    assert one.digests == other.digests
    assert len(one.merge(other).recordings) == 1
    found = rx.estimate(models[0], one.merge(other))
    for name, value in {**TRUTH, "k2": 4.0}.items():
        assert float(found[name]) == pytest.approx(value, abs=0.05 * value + 0.1)


def test_summaries_merge_to_the_same_bits_in_any_order():
    parts = [spring_summary(seed) for seed in range(4)]
    first = parts[0].merge(*parts[1:])
    assert len(first.recordings) == 4
    a, b, c, d = (parts[i] for i in (3, 1, 0, 2))
    for merged in (a.merge(b, c, d), a.merge(b).merge(c.merge(d)), b.merge(a, c, d, a)):
        same_arrays(merged.recordings, first.recordings)
    same_estimates(SPRING, first.select(2, 0, 1, 3).merge(), first)
    surveyed = spring_summary(survey=True)
    for merged in (parts[0].merge(surveyed), surveyed.merge(parts[0])):
        assert merged.recordings[0].stages[0][0].survey is not None
    records = [spring_record(1500, seed) for seed in range(4)]
    whole = rx.identify(SPRING, records, BOXCAR, intervals=rx.Naive())
    found = rx.estimate(SPRING, parts, intervals=rx.Naive())
    np.testing.assert_allclose(found.theta, whole.theta, rtol=1e-12)


def spring_record(count: int, seed: int) -> rx.Record:
    rng = np.random.default_rng(seed)
    x = np.sin(0.05 * np.arange(count) + seed) + 0.3 * rng.normal(size=count)
    f = 3.0 * x + 0.2 * rng.normal(size=count)
    return rx.Record.from_samples({"x": x, "f": f}, time_step=STEP)


def spring_summary(seed: int = 0, criterion: AbstractCriterion = BOXCAR, **settings) -> rx.Summary:
    return rx.summarise(SPRING, spring_record(1500, seed), criterion, **settings)


def test_summaries_that_do_not_belong_together_are_refused_in_one_line():
    one = spring_summary()
    renamed = rx.Equation(rx.Term("c", "x"), -rx.Term(1.0, "f"), name="spring")
    other = rx.summarise(renamed, spring_record(1500, 1), rx.RIEC(ALL))
    for second, words in [
        (other, "other equations or parameters"),
        (spring_summary(1, bins=3), "other bins"),
        (spring_summary(1, rx.DOLS()), "another criterion"),
        (spring_summary(1, rx.RIEC(ALL, rx.Boxcar(quadrature=2))), "another criterion"),
        (one.scale(0.5), "hold a recording differently, scaled or"),
        (one.leave_out(2.0, 5.0), "hold a recording differently, scaled or"),
    ]:
        for first, then in ((one, second), (second, one)):
            with pytest.raises(rx.ModelError, match=words) as caught:
                first.merge(then)
            assert "\n" not in str(caught.value)
    binned = spring_summary(bins=3)
    with pytest.raises(rx.ModelError, match="other bins"):
        binned.merge(spring_summary(1, bins=4))
    with pytest.raises(rx.ModelError, match="what is merged is the text"):
        one.merge("sums.npz")  # pyright: ignore[reportArgumentType]
    with pytest.raises(rx.ModelError, match="made for other equations"):
        rx.estimate(OSCILLATOR, one)


def test_sums_of_jit_do_not_tell_whose_they_are_and_are_not_merged():
    """They would all count as one recording."""
    traced = eqx.filter_jit(lambda r: rx.summarise(SPRING, r, rx.RIEC(ALL)))
    one, other = (traced(spring_record(1500, seed)) for seed in (0, 1))
    for parts in ((one, other), (one, spring_summary(2)), (spring_summary(2), one)):
        with pytest.raises(rx.ModelError, match=r"made under jax\.jit do not tell which"):
            parts[0].merge(*parts[1:])
    assert len(one.merge().recordings) == 1


def test_selecting_and_leaving_out_recordings_is_a_fit_of_the_others():
    records = [record(1500, 1), record(2200, 2), record(1700, 3, 125)]
    summary = rx.summarise(OSCILLATOR, records, rx.DOLS())
    some = rx.estimate(OSCILLATOR, summary.select(2, 0))
    fit = rx.identify(OSCILLATOR, [records[2], records[0]], rx.DOLS())
    np.testing.assert_allclose(some.theta, fit.theta, rtol=1e-12)
    np.testing.assert_allclose(some.standard_errors, fit.standard_errors, rtol=1e-9)
    for numbers in ((3,), (), (-4,)):
        with pytest.raises(rx.ModelError, match="numbered from 0 to 2"):
            summary.select(*numbers)
    with pytest.raises(rx.ModelError, match="numbered from 0 to 2"):
        summary.leave_out(0.0, 1.0, recording=3)


def test_leaving_out_a_stretch_is_a_fit_of_the_windows_that_start_elsewhere():
    """By hand: rows of DOLS are samples, and blocks are so many of them."""
    made = spring_record(3000, 4)
    summary = rx.summarise(SPRING, made, rx.DOLS())
    each = round(float(summary.recordings[0].block_seconds) / STEP)
    shorter = summary.leave_out(10.0, 15.0)
    block = np.arange(3000) // each
    outside = (block < int(10.0 / STEP / each)) | (block > int((15.0 / STEP - 1e-6) / each))
    x, f = (np.asarray(made[name])[outside] for name in ("x", "f"))
    assert float(rx.estimate(SPRING, shorter)["k"]) == pytest.approx((x @ f) / (x @ x), rel=1e-12)
    assert int(rx.estimate(SPRING, shorter).stages[0].count) == outside.sum()
    with pytest.raises(rx.DataError, match="fewer than two blocks"):
        summary.leave_out(0.0, 29.99)


@pytest.mark.slow
def test_a_factor_of_all_rows_is_kept_and_does_not_bring_back_what_was_left_out(tmp_path):
    """Of nearly collinear rows a factor solves; a wild stretch that is left out is not in it."""
    rng = np.random.default_rng(8)
    x, f = rng.normal(size=(2, 2000))
    y = x + 1e-8 * rng.normal(size=2000)
    f = 3.0 * x + 0.01 * f
    f[1000:1400] += 100.0 * x[1000:1400]
    made = rx.Record.from_samples({"x": x, "y": y, "f": f}, time_step=STEP)
    model = rx.Equation(rx.Term("k", "x"), rx.Term("c", "y"), -rx.Term(1.0, "f"))
    summary = rx.summarise(model, made, rx.DOLS(), survey=True)
    assert summary.recordings[0].stages[0][0].factor is not None
    again = through_a_file(summary, tmp_path)
    same_arrays(again.recordings, summary.recordings)
    same_estimates(model, again, summary)
    found = rx.estimate(model, summary.leave_out(9.9, 14.1), known={"c": 0.0})
    assert float(found["k"]) == pytest.approx(3.0, abs=0.01)
    with pytest.raises(rx.IdentifiabilityError):
        rx.estimate(model, summary.leave_out(9.9, 14.1))


@pytest.mark.parametrize("weight", [rx.Boxcar(), *nightly([rx.Hat()])], ids=["boxcar", "hat"])
@pytest.mark.parametrize("rate", [100, *nightly([137])])
@pytest.mark.parametrize(
    ("alpha", "beta"),
    [
        (0.2, 0.4),
        *nightly([(0.1, 0.6), (0.1, 0.4), (0.2, 0.9), (0.05, 0.1)]),
        pytest.param(0.17, 0.55, marks=pytest.mark.raises_finding("band_snapped")),
    ],
)
def test_another_band_is_a_fresh_fit_and_says_if_it_snapped(weight, rate, alpha, beta):
    made = record(2000, 5, rate)
    summary = rx.summarise(
        OSCILLATOR, made, rx.RIEC(ALL, weight), bins=[0.05, 0.1, 0.2, 0.4, 0.6, 0.9]
    )
    banded = summary.between(alpha, beta)
    found = rx.estimate(OSCILLATOR, banded, intervals=rx.Sandwich())
    fresh = rx.identify(OSCILLATOR, made, banded.criterion, intervals=rx.Sandwich())
    np.testing.assert_allclose(found.theta, fresh.theta, rtol=1e-10)
    assert fresh.summary is not None
    if int(fresh.summary.recordings[0].blocks) == int(summary.recordings[0].blocks):
        np.testing.assert_allclose(found.standard_errors, fresh.standard_errors, rtol=1e-8)
    else:
        assert beta > 0.6, "windows longer than the law's take longer blocks in a fresh fit"
    assert float(found.stages[0].count) == pytest.approx(float(fresh.stages[0].count), rel=1e-12)

    # Snapped if windows of the band asked for are others, by their lengths in samples.
    unit = banded.criterion.test_function.length_multiple / rate
    taken = banded.criterion.windows
    assert taken is not None
    asked = [round(alpha / unit), round(beta / unit)]
    snapped = asked != [round(float(taken.alpha) / unit), round(float(taken.beta) / unit)]
    assert ("band_snapped" in [finding.code for finding in found.findings()]) == snapped
    if not snapped:
        assert (float(taken.alpha), float(taken.beta)) == (alpha, beta)


def test_another_band_needs_bins_and_the_first_comes_back_as_it_was():
    binned = spring_summary(bins=4)
    back = binned.between(0.2, 0.4).between(0.1, 0.6)
    assert back.asked is None
    same_arrays(back.recordings, binned.recordings)
    assert len(back.merge(spring_summary(1, bins=4)).recordings) == 2
    with pytest.raises(rx.ModelError, match="make it with bins"):
        spring_summary().between(0.2, 0.4)
    with pytest.raises(rx.ModelError, match="0 < alpha < beta"):
        binned.between(0.4, 0.2)


@pytest.mark.slow
def test_a_summary_is_of_its_equations_numbers_too():
    """With another factor in front of the force, sums are other sums; a known value moves none."""
    criterion = rx.RIEC(rx.AllWindows(0.1, 0.5))

    def equation(factor, **known):
        return rx.Equation(rx.Term("k", "x", **known), rx.Term("c", "x", derivative=1), -factor)

    once, twice = (equation(rx.Term(number, "u")) for number in (1.0, 2.0))
    summary = rx.summarise(once, record(), criterion)
    with pytest.raises(rx.ModelError, match="made for other equations"):
        rx.estimate(twice, summary)
    held = equation(rx.Term(1.0, "u"), known=3.0)
    assert rx.summarise(held, record(), criterion).digests == summary.digests
    assert float(rx.estimate(held, summary).known["k"]) == 3.0
