import base64
import io
import json
import os
import sys
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import jax
import numpy as np
import pyarrow as pa
import pytest
from rich.console import Console

from riecjax.assessment.assessment import Assessment
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.test_functions import Bump, Hat
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.bases import roof
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import staged
from riecjax.equations.term import Term, Terms
from riecjax.errors import DataError
from riecjax.estimation.check import Check
from riecjax.estimation.identify import estimate, identify
from riecjax.models.model import as_model
from riecjax.paper.variations import write_variations
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.reporting.charts import printed
from riecjax.reporting.charts.chart import Axis, Chart, Dots, Line, single
from riecjax.reporting.document import is_intact, sealed, versions
from riecjax.reporting.identification import (
    identification_document,
    print_everything,
    print_identification,
)
from riecjax.reporting.identification_figures import (
    curves_figure,
    identification_figures,
    identified_curves,
)
from riecjax.reporting.output import _folder_beside, emit, write_folder
from riecjax.reporting.page import Page, Section
from riecjax.summaries.summarise import summarise
from riecjax.validation.residuals import ResidualTests
from riecjax.whole_files import stamp

DOCUMENT = {
    "answer": 42,
    "warnings": [{"code": "odd", "message": "5 < 6 & so on"}],
    "provenance": {"seed": 1},
}


def show(document: dict, console: Console) -> None:
    console.print(f"the answer is {document['answer']}", highlight=False)


CHART = single([Line([1, 2], [3, 4])], Axis("time / s"), Axis("x / m"), "How it moves.")


def page(document: dict) -> Page:
    answer = f"the answer is {document['answer']}"
    return Page("A <title>", "", [Section("Answer", [answer], charts=("one", "two"))])


def emitted(
    out: Path | None = None,
    as_json: bool = False,
    charts: Callable[[], Mapping[str, Chart]] = dict,
) -> None:
    emit(DOCUMENT, as_json=as_json, out=out, show=show, charts=charts, page=page)


def test_terminal(capsys):
    emitted()
    captured = capsys.readouterr()
    assert captured.out == "the answer is 42\n"
    assert captured.err == "warning [odd]: 5 < 6 & so on\n"


def test_json(capsys):
    emitted(as_json=True)
    captured = capsys.readouterr()
    assert json.loads(captured.out) == sealed(DOCUMENT)
    assert captured.err == "warning [odd]: 5 < 6 & so on\n"


def test_figures_are_not_made_without_a_folder():
    emitted(charts=lambda: pytest.fail("was made"))


def test_folder(capsys, tmp_path):
    out = tmp_path / "a" / "b"
    emitted(out, charts=lambda: {"one": CHART, "two": CHART})
    names = sorted(path.name for path in out.iterdir())
    assert names == ["one.png", "report.html", "results.json", "two.png"]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]
    assert json.loads((out / "results.json").read_text()) == sealed(DOCUMENT)
    assert str(out) in capsys.readouterr().out


@pytest.mark.parametrize("terminal", [True, False])
def test_pictures_are_drawn_after_the_answer_where_somebody_waits(
    capsys, tmp_path, monkeypatch, terminal
):
    said = []

    def charts() -> dict[str, Chart]:
        said.append(capsys.readouterr().out)
        return {"one": CHART, "two": CHART}

    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    emitted(tmp_path / "out", charts=charts)
    assert said == ["the answer is 42\n" if terminal else ""]
    wrote = f"wrote {tmp_path}/out/results.json, report.html and figures\n"
    assert capsys.readouterr().out == ("" if terminal else "the answer is 42\n") + wrote


def test_page_holds_text_warnings_provenance_and_the_same_picture(tmp_path):
    emitted(tmp_path / "out", charts=lambda: {"one": CHART})
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "A &lt;title&gt;" in html
    assert "5 &lt; 6 &amp; so on" in html
    assert "the answer is 42" in html
    assert "&#34;seed&#34;: 1" in html
    assert "How it moves." in html
    picture = base64.b64encode((tmp_path / "out" / "one.png").read_bytes()).decode()
    assert f'src="data:image/png;base64,{picture}"' in html


@pytest.mark.parametrize("existing", [False, True])
def test_a_failure_leaves_the_folder_as_it_was(capsys, tmp_path, monkeypatch, existing):
    def fail(chart: Chart, file: Path) -> None:
        file.write_bytes(b"half")
        if file.name == "two.png":
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(printed, "print_chart", fail)
    out = tmp_path / "out"
    if existing:
        out.mkdir()
        (out / "results.json").write_text("old")
    with pytest.raises(DataError, match="No space left on device"):
        emitted(out, as_json=True, charts=lambda: {"one": CHART, "two": CHART})
    assert capsys.readouterr().out == ""
    assert [path.name for path in tmp_path.iterdir()] == (["out"] if existing else [])
    if existing:
        assert [path.name for path in out.iterdir()] == ["results.json"]
        assert (out / "results.json").read_text() == "old"


def test_figures_of_an_earlier_run_do_not_stay(tmp_path):
    out = tmp_path / "out"
    table = lambda file: write_variations(pa.table({"x": [1.0]}), file, stamp(file))  # noqa: E731
    write_folder(
        out, DOCUMENT, {"one": CHART, "two": CHART}, page(DOCUMENT), {"variations.parquet": table}
    )
    (out / "mine.png").write_bytes((out / "one.png").read_bytes())
    (out / "photo.png").write_bytes(b"\x89PNG")
    (out / "table.parquet").write_bytes((out / "variations.parquet").read_bytes())
    write_folder(out, DOCUMENT, {"two": CHART}, page(DOCUMENT))
    names = ["mine.png", "photo.png", "report.html", "results.json", "table.parquet", "two.png"]
    assert sorted(path.name for path in out.iterdir()) == names


@pytest.mark.parametrize("moves", range(4))
def test_results_never_stand_beside_what_is_of_others(tmp_path, monkeypatch, moves):
    """Wherever it ends while files take their places, and whatever stood there."""
    out = tmp_path / "out"
    write_folder(out, DOCUMENT, {"one": CHART, "two": CHART}, page(DOCUMENT))
    done = []

    def killed(file: Path, target: Path) -> Path:
        if len(done) == moves:
            raise KeyboardInterrupt
        done.append(target)
        os.replace(file, target)
        return target

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_folder(out, {**DOCUMENT, "answer": 43}, {"one": CHART, "two": CHART}, page(DOCUMENT))
    assert not (out / "results.json").exists()


def test_a_flipped_bit_of_results_is_seen(tmp_path):
    write_folder(tmp_path / "out", DOCUMENT, {}, page(DOCUMENT))
    file = tmp_path / "out" / "results.json"
    whole = file.read_bytes()
    assert is_intact(json.loads(whole))
    for place in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << (place % 8)
        try:
            read = json.loads(damaged.decode())
        except ValueError:
            continue
        told = {key: value for key, value in read.items() if key in DOCUMENT}
        assert not is_intact(read) or told == DOCUMENT


def test_a_failing_chart_leaves_nothing(tmp_path):
    broken = single([Line([1, 2], [3, 4, 5])], Axis(), Axis())
    with pytest.raises(ValueError, match="same first dimension"):
        write_folder(tmp_path / "out", DOCUMENT, {"one": broken}, page(DOCUMENT))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="cannot write to"):
        emitted(tmp_path / "file" / "out")


def test_no_file_is_left_open(tmp_path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        emitted(tmp_path / "out")
    assert [str(warning.message) for warning in caught] == []


def test_results_are_made_in_a_folder_that_keeps_no_one_out(tmp_path):
    (tmp_path / "ordinary").mkdir()
    with _folder_beside(tmp_path / "out") as made:
        assert made.parent == tmp_path
        assert made.stat().st_mode == (tmp_path / "ordinary").stat().st_mode


@pytest.mark.parametrize("module", ["matplotlib", "jinja2", "plotly"])
def test_missing_packages_are_named_with_the_remedy(tmp_path, monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DataError, match=r'pip install "riecjax\[report\]"'):
        emitted(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_versions():
    found = versions()
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["jax"] == jax.__version__
    assert found["numpy"] == np.__version__


EQUATION = Equation(Term("m", "a", unit="kg"), Term("c", "v", unit="N s/m"), -Term(1.0, "f"))


@pytest.fixture(scope="module")
def record() -> Record:
    rng = np.random.default_rng(0)
    a, v = rng.normal(size=(2, 500))
    return Record({"a": a, "v": v, "f": 2 * a + 3 * v + 0.1 * rng.normal(size=500)}, 0.01)


@pytest.fixture(scope="module")
def identified(record):
    return identify(EQUATION, record, DOLS(), known={"c": 3.0})


def result_of(estimate, procedure, record, **changes) -> Assessment:
    given = dict(
        model=as_model(procedure, "cart"),
        procedure=procedure,
        recordings=[Recording(record, "a.csv", ("filtered",))],
        validated_on=[],
        checked=Check([], [], ()),
        estimate=estimate,
        sweep=None,
        residuals=ResidualTests(()),
        choice=None,
        seeds=None,
        validations=[],
        refinement=None,
        failures=[],
        key=jax.random.key(5),
    )
    return Assessment(**{**given, **changes})


@pytest.fixture(scope="module")
def document(identified, record):
    return identification_document(result_of(identified, staged(EQUATION), record))


def test_identification_document(document, identified, record):
    a, f = np.asarray(record["a"]), np.asarray(record["f"] - 3 * record["v"])
    mass = (a @ f) / (a @ a)
    naive = np.sqrt(np.sum((f - mass * a) ** 2) / 499 / (a @ a))
    error = float(identified.standard_error("m"))
    assert document["parameters"] == {
        "m": {
            "value": float(identified["m"]),
            "unit": "kg",
            "std_error": error,
            "interval95": list(identified.interval("m")),
            "naive_std_error": pytest.approx(naive, rel=1e-9),
            "effective_windows": pytest.approx(500 * (naive / error) ** 2, rel=1e-9),
        }
    }
    assert document["correlation"] == {"parameters": ["m"], "matrix": [[pytest.approx(1.0)]]}
    assert document["residual_tests"] == {}
    assert document["window_choice"] is None
    assert document["provenance"]["intervals"] == {
        "method": "studentized block bootstrap, 2000 replicates",
        "blocks": int(identified.block_count),
        "block_seconds": float(identified.block_length),
    }
    assert document["known"] == {"c": {"value": 3.0, "unit": "N s/m"}}
    left = np.asarray(record["f"] - 3 * record["v"])
    share = np.sqrt(np.mean((left - float(identified["m"]) * record["a"]) ** 2) / np.mean(left**2))
    assert document["residual"]["relative_rms"] == pytest.approx(share, rel=1e-9)
    assert document["residual"]["stages"][0]["rows"] == 500
    assert document["provenance"]["preparation"] == ["filtered"]
    json.dumps(document, allow_nan=False)


def test_identification_table(document):
    console = Console(width=80, record=True, file=io.StringIO())
    print_everything(document, console)
    text = console.export_text()
    value = f"{document['parameters']['m']['value']:.6g}"
    for word in ("cart", "DOLS", value, "kg", "known", "N s/m", "500 rows", "filtered"):
        assert word in text


def test_a_narrow_terminal_cuts_nothing_off_a_table(document):
    printed_on = io.StringIO()
    console = Console(width=30, file=printed_on)
    print_everything(document, console)
    printed = printed_on.getvalue()
    rows = [row for row in printed.splitlines() if row.startswith("m  ")]
    assert len(rows) == 2
    assert "\u2026" not in printed
    assert all(" .. " in row and " kg" in row for row in rows)
    assert rows[0].rstrip().endswith(document["verdict"]["parameters"]["m"]["level"])
    assert console.width == 30


def test_numbers_that_are_not_finite_become_null(identified, record):
    import equinox as eqx

    lost = eqx.tree_at(lambda e: e.uncertainty.covariance, identified, np.full((1, 1), np.nan))
    document = identification_document(result_of(lost, staged(EQUATION), record))
    assert document["parameters"]["m"]["std_error"] is None
    assert document["parameters"]["m"]["interval95"] == [None, None]
    json.dumps(document, allow_nan=False)
    print_identification(document, Console(quiet=True))


@pytest.mark.parametrize(
    ("criterion", "unit"),
    [
        (DOLS(), "N"),
        (RIEC(RandomWindows(0.05, 0.2, 300)), "N s"),
        (RIEC(RandomWindows(0.05, 0.2, 300), Hat()), "N s^2"),
        (RIEC(RandomWindows(0.05, 0.2, 300), Bump()), "N s"),
    ],
)
def test_fit_shows_what_is_explained_against_what_was_measured(record, criterion, unit):
    equation = Equation(*EQUATION.terms[:2], -Term(1.0, "f", unit="N"), unit="N")
    procedure = staged(equation)
    key = jax.random.key(0)
    summary = summarise(procedure, record, criterion, key=key, survey=True)
    found = estimate(procedure, summary)
    chart = identification_figures(result_of(found, procedure, record))["fit"]
    fit, residual = chart.panels
    dots, left = fit.marks[-1], residual.marks[-1]
    assert isinstance(dots, Dots)
    assert isinstance(left, Dots)
    explained, measured = np.asarray(dots.x), np.asarray(dots.y)
    scatter = np.asarray(left.y)
    np.testing.assert_allclose(measured - explained, scatter, atol=1e-12)
    # The residual of a least-squares fit is at right angles to what is explained.
    assert abs(explained @ scatter) < 1e-9 * (explained @ explained)
    assert fit.x.label.endswith(f"({unit})")
    share = np.sqrt(np.mean(scatter**2) / np.mean(measured**2))
    assert share == pytest.approx(float(found.stages[0].relative_rms), rel=1e-6)


def test_no_figure_stays_open_when_written(tmp_path):
    # Otherwise a program that identifies in a loop keeps every figure and is warned of it.
    import matplotlib.pyplot as plt

    emitted(tmp_path / "out", charts=lambda: {"one": CHART})
    assert plt.get_fignums() == []


def damper(t):
    v = np.cos(3 * t) + 0.5 * np.sin(7 * t)
    return v, np.interp(v, [-2.0, -0.5, 0.5, 2.0], [-9.0, -5.0, 4.0, 7.0])


def test_curves_pass_through_their_break_points_and_leave_the_hysteresis():
    t = np.arange(3000) * 0.01
    v, force = damper(t)
    lag = 0.8 * np.sign(np.gradient(v))
    record = Record({"v": v, "F": force + lag}, 0.01, units={"v": "m/s"})
    points = [-2.0, -0.5, 0.5, 2.0]
    equation = Equation(-Terms("F_d", roof(points), "v", unit="N"), Term(1.0, "F"), unit="N")
    procedure = staged(equation)
    estimate = identify(procedure, record, DOLS())
    (curve,) = identified_curves(result_of(estimate, procedure, record))
    inner = (np.array(points) > v.min()) & (np.array(points) < v.max())
    at_points = np.interp(np.array(points)[inner], curve.x, curve.y)
    np.testing.assert_allclose(at_points, np.asarray(estimate.theta)[inner], atol=0.02)
    assert curve.samples is not None
    x, y = curve.samples
    np.testing.assert_allclose(x, v)
    np.testing.assert_allclose(y, force + lag, atol=1e-12)
    above, below = curves_figure([curve]).panels
    assert below.x.label == "v / (m/s)"
    assert above.y.label == "F_d / (N)"
    (left,) = (mark for mark in below.marks if isinstance(mark, Line))
    np.testing.assert_allclose(np.asarray(left.y), y - np.interp(x, curve.x, curve.y))
    band = above.marks[-1]
    assert isinstance(band, Line)
    assert band.high is not None
    np.testing.assert_allclose(np.asarray(band.high), curve.y + 1.96 * curve.error)


def test_a_curve_beside_an_acceleration_that_is_not_recorded_has_no_samples():
    t = np.arange(3000) * 0.01
    v, force = damper(t)
    # m v' = F - F_d(v), with F made from the exact derivative.
    slope = -3 * np.sin(3 * t) + 3.5 * np.cos(7 * t)
    record = Record({"v": v, "F": force + 2.0 * slope}, 0.01)
    equation = Equation(
        Term("m", "v", derivative=1),
        Terms("F_d", roof([-2.0, -0.5, 0.5, 2.0]), "v"),
        -Term(1.0, "F"),
    )
    procedure = staged(equation)
    criterion = RIEC(RandomWindows(0.05, 0.5, 500))
    estimate = identify(procedure, record, criterion, key=jax.random.key(0))
    (curve,) = identified_curves(result_of(estimate, procedure, record))
    assert curve.samples is None
    assert len(curves_figure([curve]).panels) == 1
    np.testing.assert_allclose(
        curve.y, np.interp(curve.x, [-2, -0.5, 0.5, 2], [-9, -5, 4, 7]), atol=0.05
    )
