"""Objects print, draw, leave and come back with the numbers that they hold."""

import json
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest

import riecjax as rx
from riecjax.reporting import write_report
from riecjax.reporting.tables import latex_name, latex_unit, with_error

matplotlib.use("Agg")
CRITERION = rx.RIEC(rx.AllWindows(0.05, 0.4), rx.Hat())


def across(s):
    return s["x"] - s["u"]


def equation(*more: rx.Term) -> rx.Equation:
    return rx.Equation(
        rx.Term("m", "x", derivative=2, unit="kg"),
        rx.Term("c_1", "x", derivative=1, unit="N s/m"),
        rx.Term("k", "x", unit="N/m"),
        *more,
        -rx.Term(1.0, "u"),
        name="oscillator",
        unit="N",
    )


def record(seed: int = 0, noise: float = 1e-3) -> rx.Record:
    """2 x'' + 3 x' + 50 x = u of a sum of sines, solved one by one, and noise."""
    rng, t = np.random.default_rng(seed), 0.01 * np.arange(2000)
    w = 2 * np.pi * np.linspace(0.3, 3.0, 9)
    x = np.sum([np.sin(v * t + rng.uniform(0, 6)) for v in w], axis=0)
    dt = 0.01
    xx = np.gradient(np.gradient(x, dt), dt)
    u = 2 * xx + 3 * np.gradient(x, dt) + 50 * x
    x = x + noise * rng.normal(size=x.size)
    return rx.Record.from_samples({"x": x, "u": u}, time_step=dt, units={"x": "m", "u": "N"})


@pytest.fixture(scope="module")
def estimate():
    return rx.identify(equation(), record(), CRITERION)


@pytest.fixture(scope="module")
def assessed():
    return rx.assess(equation(), record(), CRITERION, hold_out=0.3, refine=None)


def test_equations_are_words():
    assert "oscillator: m x'' + c_1 x' + k x = u [N]" in repr(equation())
    body = rx.Equation(
        rx.Term("M", "x", derivative=1, known=302.7),
        -rx.Term("K", "u"),
        -rx.Terms("F", rx.roof([-1, 0, 1]), of=across),
        rx.Term("o", rx.constant),
        -rx.Terms("p", rx.Polynomial((0, 1, 3)), of=rx.difference("a", "b")),
    )
    words = "302.7 x' - K u - F R(across) + o - p_0 - p_1 (a - b) - p_3 (a - b)^3 = 0"
    assert words in str(body)
    turned = rx.Equation(-rx.Term("k", "x"), rx.Term(2.0, "u"), rx.Term(-1.0, lambda s: s["x"]))
    assert ": k x = 2 u - f(signals)" in str(turned)
    assert "2. oscillator" in str(rx.staged(body, equation()))


def all_print_briefly(*objects):
    for one in objects:
        for text in (repr(one), str(one)):
            assert len(text.splitlines()) <= 30
            assert "Array(" not in text
            assert "f64[" not in text
        page = one._repr_html_()
        assert "<table" in page
        assert not re.search("http|src=|background:(?!none)|[^-]color:#", page)


def test_everything_prints_briefly_and_in_html(estimate, assessed):
    sweep, checked, held = (
        assessed.test("window_sweep"),
        assessed.checked,
        assessed.test("validation").runs[0].held,
    )
    held_back = {"m": 2.0, "k": 50.0}
    known = rx.identify(equation(), record(), CRITERION, known=held_back, intervals=rx.Naive())
    recording = assessed.recordings[0]
    comparison = rx.compare([estimate, known])
    model, verdict = rx.find_model("quarter-car"), assessed.verdict
    all_print_briefly(
        *(estimate, assessed, sweep, held, checked, known, recording, comparison),
        *(model, verdict),
    )
    assert re.search(r"^k +50 +known +N/m$", str(known), re.MULTILINE)
    assert "&lt;b&gt;" in rx.Record({"<b>": jnp.ones(3)}, 0.1)._repr_html_()


def test_an_object_in_a_notebook_fills_no_cell_but_its_own(monkeypatch):
    displayed = []
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr("rich.jupyter.display", lambda *shown: displayed.append(shown))
    assert "2000 samples" in str(record())
    assert displayed == []


def test_what_is_traced_prints():
    said = []

    def fit(one, known):
        result = rx.identify(equation(), one, CRITERION, known={"m": known})
        scaled = rx.Equation(*equation().terms[:3], rx.Term(known, "u"))
        said.extend(map(repr, (one, result, scaled)))
        return result["k"]

    jax.jit(fit)(record(), 2.0)
    assert "Record of u [N], x [m], being traced" in said[0]
    assert "Estimate of c_1 [N s/m], k [N/m], being traced" in said[1]
    assert "k x = " in said[2]


def test_an_estimate_is_a_mapping_of_numbers(estimate):
    assert dict(estimate) == {name: float(estimate[name]) for name in ("m", "c_1", "k")}
    assert len(estimate) == 3
    assert "m" in estimate
    assert "M" not in estimate
    assert list(estimate.keys()) == estimate._ipython_key_completions_() == list(estimate)
    assert dict(estimate.items()) == dict(estimate.values)
    assert isinstance(estimate["m"], float)
    assert f"{estimate['m']:.1f}" == f"{float(estimate.theta[0]):.1f}"


def test_a_frame_holds_values_read_one_by_one(estimate):
    frame, plain = estimate.to_frame(), estimate.to_dict()
    for name in estimate:
        row = frame.loc[name]
        assert row["value"] == estimate[name] == plain[name]["value"]
        assert row["std_error"] == estimate.standard_error(name)
        assert (row["low95"], row["high95"]) == estimate.interval(name) == plain[name]["interval"]
    assert list(frame["unit"]) == ["kg", "N s/m", "N/m"]
    held = rx.identify(equation(), record(), CRITERION, known={"m": 2.0}).to_frame()
    assert held["known"].to_dict() == {"c_1": False, "k": False, "m": True}
    assert np.isnan(held.loc["m", "std_error"])
    single = jax.tree.map(lambda x: x.astype("float32") if eqx.is_inexact_array(x) else x, estimate)
    assert single.to_frame().loc["m", "value"] == np.float32(estimate["m"])


def squeezed(table: str) -> str:
    return re.sub(" +", " ", table)


def test_tables_of_a_paper_round_by_the_error(estimate):
    assert with_error(20712.3, 153.2) == "20710 ± 150"
    assert with_error(1.49936, 0.00996) == "1.499 ± 0.010"
    assert with_error(-2.5e7, 3e5) == "(-2.500 ± 0.030) × 10^7"
    assert with_error(None, None) == "nan"
    assert latex_name("F_coulomb_pos") == "$F_\\mathrm{coulomb\\_pos}$"
    assert latex_unit("N s^2/m^2") == "$\\mathrm{N\\,s^{2}/m^{2}}$"
    value, error = with_error(float(estimate["k"]), float(estimate.standard_error("k"))).split(
        " ± "
    )
    assert f"| k | {value} | {error} | N/m |" in squeezed(estimate.to_markdown())
    cells = f"$k$ & ${value}$ & ${error}$ & $\\mathrm{{N/m}}$ \\\\"
    assert cells in squeezed(estimate.to_latex())
    lost = eqx.tree_at(lambda e: e.theta, estimate, jnp.full(3, jnp.nan))
    assert "| k | nan |" in squeezed(lost.to_markdown())
    assert lost.to_dict()["k"]["value"] is None
    assert "none" in repr(lost)


def comes_back_equal(one, file):
    one.save(file)
    again = rx.load(file)
    assert str(again) == str(one)
    assert again.findings() == one.findings()
    for level in (0.5, 0.95, 0.99):
        np.testing.assert_array_equal(again.intervals(level), one.intervals(level))


def test_a_saved_estimate_comes_back_equal(estimate, tmp_path):
    file = tmp_path / "kept"
    comes_back_equal(estimate, file)
    fresh = rx.estimate(equation(), rx.load(file).summary)
    np.testing.assert_allclose(fresh.theta, estimate.theta, rtol=1e-12)
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
    refined = rx.refine(equation(), record(), estimate, rx.IntegralError(CRITERION))
    comes_back_equal(refined, tmp_path / "refined")


def test_an_assessment_and_its_verdict_print_the_level_of_each_parameter(assessed):
    for shown in (str(assessed), str(assessed.verdict)):
        rows = {line.split()[0]: line for line in shown.splitlines()[1:] if line.strip()}
        for name, judged in assessed.verdict.parameters.items():
            assert judged.level in rows[name]
            assert " % " in rows[name]


def test_results_of_the_command_line_are_read(assessed, tmp_path):
    write_report(assessed, tmp_path / "out")
    read = rx.load(tmp_path / "out")
    answer = assessed.answer
    assert dict(read) == dict(answer)
    assert read.interval("k") == answer.interval("k")
    assert read.units == dict(answer.units)
    assert [f.code for f in read.findings()] == [f.code for f in assessed.findings()]
    assert read.to_frame().equals(answer.to_frame())
    assert read.to_markdown() == answer.to_markdown()
    assert read.criterion["name"] == "riec"
    assert assessed.verdict.sentence in str(read)
    file = tmp_path / "out" / "results.json"
    document = json.loads(file.read_text())
    for wrong, words in (
        ({**document, "schema": 99}, "schema 99"),
        ({"schema": 4, "tables": {}}, "lacks"),
        ({"schema": 4, "error": {"code": "data", "message": "too short"}}, "too short"),
        ([1], "no results.json"),
    ):
        file.write_text(json.dumps(wrong))
        with pytest.raises(rx.DataError, match=words):
            rx.load(file)


def test_a_comparison_counts_a_useless_term_against_its_model(estimate, assessed):
    more = equation(rx.Term("q", rx.product("x", "x"), unit="N/m^2"))
    further = rx.identify(more, record(), CRITERION)
    both = rx.compare([estimate, further], names=["plain", "more"])
    windows = min(
        len(e.parameters) / np.sum(1 / np.asarray(e.effective_windows)) for e in (estimate, further)
    )
    rms = [float(e.equations["oscillator"].residual_rms) for e in (estimate, further)]
    difference = 2 * windows * np.log(rms[1] / rms[0]) + 2
    assert both.information is not None
    assert both.information[1] - both.information[0] == pytest.approx(difference)
    assert "ΔAIC" in both.to_markdown()
    assert both.to_frame().loc[("k", "more"), "value"] == further["k"]
    assert "$k$ & $" in squeezed(both.to_latex())
    apart = rx.compare([estimate, assessed])
    assert apart.information is None
    assert "other data" in str(apart)
    assert re.search(r"^fit of x, .* 9\d\.\d", str(apart), re.MULTILINE)
    with pytest.raises(rx.ModelError, match=r"rx\.identify"):
        rx.compare([estimate, 3.0])


def test_objects_draw_into_new_and_given_axes(estimate, assessed):
    from matplotlib import pyplot

    axes = estimate.plot()
    names = [label.get_text().split(" = ")[0] for label in axes.get_yticklabels()]
    assert names == ["m", "c_1", "k"]
    ends = axes.lines[1].get_xdata()[:2]
    expected = 100 * (np.array(estimate.interval("m")) / estimate["m"] - 1)
    np.testing.assert_allclose(ends, expected)
    _, own = pyplot.subplots()
    assert estimate.plot(own) is own
    assert len(assessed.plot().axes) > 4
    assert len(record().plot().axes) == 2
    with pytest.raises(rx.DataError, match="as many axes"):
        record().plot(own)
    pyplot.close("all")


@pytest.mark.slow
def test_the_report_opens(assessed, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = assessed.show()
    assert opened == [page.as_uri()]
    assert "<html" in page.read_text(encoding="utf-8")
