"""The page of an identification says what its document holds."""

from typing import Any

import pytest

from riecjax.reporting.identification_page import identification_page
from riecjax.reporting.page import Page, Section

ENTRY = {"value": 2.0, "unit": "kg", "std_error": 0.01, "interval95": [1.98, None]}
FIT = {"fit_percent": 91.27, "vaf_percent": 99.0, "p_percent": None, "grade": "well"}
RUN = {"signals": {"x": {**FIT, "judged": True}, "y": {**FIT, "judged": False}}}
DOCUMENT: dict[str, Any] = {
    "model": "cart",
    "criterion": {"name": "riec", "alpha": 0.1, "beta": 1.0},
    "parameters": {"m": ENTRY},
    "known": {"c": {"value": 3.0, "unit": "N s/m"}},
    "residual": {
        "stages": [
            {
                "equation": "motion",
                "parameters": ["m"],
                "relative_rms": 0.05,
                "condition_number": None,
                "rows": 500,
                "equations": ["motion"],
            }
        ]
    },
    "excitation": {"m": {"equation": "motion", "own_share": 0.5, "noise_share": None}},
    "noise": {"v": {"std": 0.02, "unit": "m/s", "share": 0.05}},
    "residual_tests": {
        "motion": {
            "relative_rms": 0.04,
            "correlation_time_s": 0.2,
            "follows": [{"signal": "v", "correlation": -0.6, "lag_s": 0.01, "bound": 0.2}],
            "peak": {"frequency": 12.0, "low": 10.0, "high": 15.0, "share": 0.4},
            "windows": None,
        }
    },
    "window_choice": None,
    "modes": [],
    "equations": ["motion: m v' + c v = f"],
    "verdict": {
        "sentence": "Trust m to 3 %.",
        "parameters": {
            "m": {"level": "good", "reason": "scatter", "doubt": [1.95, None], "share": 0.03}
        },
        "causes": [
            {
                "kind": "model",
                "phrase": "the model leaves out a mode near 12 Hz",
                "parameters": ["m"],
                "share": 0.02,
                "codes": ["unmodelled_mode", "window_sensitive"],
            }
        ],
        "next": [
            {"words": "Find the mode", "options": [], "command": "riecjax identify a.csv"},
            {"words": "Record for longer", "options": [], "command": None},
        ],
    },
    "refinement": None,
    "validation": [{"on": "a.csv, last part", "verdict": "It ran.", **RUN}],
    "provenance": {
        "records": [{"file": "logs/a.csv", "samples": 400, "time_step": 0.01}],
        "preparation": ["filtered"],
        "intervals": {"method": "sandwich", "blocks": 20, "block_seconds": 0.2},
    },
}
REFINEMENT = {
    "chosen": True,
    "declined": None,
    "whiteness": None,
    "refined": {"m": {"value": 2.0}},
    "by": {"refine": "integral"},
    "reason": "converged",
    "steps": 4,
    "basis": "impulses over the same windows",
    "identified": {"m": {"value": 1.9}},
    "left": {"v": {"before": 0.2, "after": None, "unit": "m/s"}},
    "at_bound": ["m"],
    "simulations": [
        {
            "on": "a.csv",
            "fitted": True,
            "before": {"signals": {}},
            "after": {"signals": {"x": {"fit_percent": 95.0}}},
        }
    ],
    "intervals": {"method": "bootstrap", "blocks": 9, "block_seconds": 1.0},
}


def section(page: Page, heading: str) -> Section:
    return {each.heading: each for each in page.sections}[heading]


@pytest.fixture
def page() -> Page:
    return identification_page(DOCUMENT)


def test_parameters_stand_with_unit_error_and_interval(page):
    assert page.title == "cart from a.csv"
    assert "Identified by RIEC (alpha 0.1, beta 1.0)." in section(page, "Parameters").text
    table, excitation = section(page, "Parameters").tables
    assert [list(row) for row in table.rows] == [
        ["m", "2", "0.01", "1.98 to none", "kg"],
        ["c", "3", "", "known", "N s/m"],
    ]
    assert [list(row) for row in excitation.rows] == [["m", "motion", "50", "none"]]


def test_the_page_begins_with_the_verdict_and_what_to_do(page):
    assert page.lead == "Trust m to 3 %."
    assert page.answer is not None
    (table,) = page.answer.tables
    assert list(table.rows[0]) == ["m", "2", "kg", "3.0 %", "1.95 to none", "good", "scatter"]
    assert page.answer.text == [
        "Find the mode: riecjax identify a.csv",
        "Record for longer.",
        "Where motion: m v' + c v = f.",
    ]


def test_warnings_stand_under_what_lies_behind_them(page):
    ((title, codes),) = page.groups
    assert title == "The model leaves out a mode near 12 Hz: m"
    assert list(codes) == ["unmodelled_mode", "window_sensitive"]


def test_fit_validation_and_recordings(page):
    (fit,) = section(page, "Fit").tables
    assert list(fit.rows[0]) == ["motion", "m", "5", "none", "500"]
    validation = section(page, "Validation by simulation")
    assert list(validation.charts) == ["validation_1"]
    assert list(validation.tables[0].rows[0]) == ["x", "91.3", "99.0", "none", "well"]
    assert validation.tables[0].rows[1][0] == "y (not judged)"
    (recordings,) = section(page, "Recordings").tables
    assert list(recordings.rows[0]) == ["a.csv", "400", "100", "4"]


def test_residual_tests_in_words(page):
    left = section(page, "What each equation leaves")
    assert left.text == [
        "motion: the error is 4 % of the target; 40 % of its power lies from 10 to 15 Hz, about a "
        "peak near 12 Hz; it follows v (correlation -0.60)."
    ]
    assert left.charts == ["residual_1"]


def test_a_refinement_stands_beside_what_was_identified():
    page = identification_page({**DOCUMENT, "refinement": REFINEMENT})
    table = section(page, "Parameters").tables[0]
    assert list(table.header)[:3] == ["parameter", "identified", "value"]
    assert [row[:3] for row in table.rows] == [["m", "1.9", "2"], ["c", "", "3"]]
    refined = section(page, "Refinement")
    assert refined.text == [
        "Refined by impulses of the equation error: converged (4 steps).",
        "What is left before and after is of impulses over the same windows.",
        "Simulations start from the state as recorded.",
        "At a bound: m.",
        "Refined intervals: bootstrap, 9 blocks of 1 s.",
    ]
    left, fits = refined.tables
    assert list(left.rows[0]) == ["v", "0.2", "none", "m/s"]
    assert list(fits.rows[0]) == ["a.csv (fitted): x", "none", "95.0"]


def test_refined_values_that_were_not_chosen_stand_behind_the_answer():
    channel = {"statistic": 12.0, "chi_squared": 1.5, "share": 0.1}
    refinement = {
        **REFINEMENT,
        "by": {"refine": "output-error"},
        "chosen": False,
        "declined": "what it leaves of v is not white noise",
        "refined": {"m": {"value": 1.7}},
        "whiteness": {
            "white": False,
            "vanishing": False,
            "largest": 12.0,
            "threshold": 2.0,
            "channels": {"v": channel},
        },
    }
    page = identification_page({**DOCUMENT, "refinement": refinement})
    parameters = section(page, "Parameters")
    assert "physical parameters" in parameters.text[0]
    table = parameters.tables[0]
    assert [table.header[1], table.header[-2]] == ["value", "refined"]
    assert [(row[1], row[-2]) for row in table.rows] == [("2", "1.7"), ("3", "")]
    assert list(section(page, "Refinement").tables[0].rows[0])[-2:] == ["12", "1.5"]


def test_a_motion_that_is_followed_to_a_millionth_leaves_no_noise_to_test():
    """Of what the arithmetic leaves the statistic is large, and tells of nothing."""
    channel = {"statistic": 8e3, "chi_squared": 8e3, "share": 4e-8}
    whiteness = {"white": True, "vanishing": True, "largest": 8e3, "threshold": 2.0}
    refinement = {
        **REFINEMENT,
        "by": {"refine": "output-error"},
        "whiteness": {**whiteness, "channels": {"v": channel}},
    }
    page = identification_page({**DOCUMENT, "refinement": refinement})
    said = section(page, "Parameters").text[0]
    assert "follows the motion to 4e-08 of its size" in said
    assert "white noise" not in said


def test_a_refinement_that_was_not_made_says_why():
    nothing = {**dict.fromkeys(REFINEMENT), "chosen": False, "declined": "it would take 40 s"}
    page = identification_page({**DOCUMENT, "refinement": nothing})
    assert section(page, "Parameters").text[0] == "Not refined: it would take 40 s."
    assert "Refinement" not in {each.heading for each in page.sections}


def test_what_was_not_made_has_no_section(page):
    headings = [each.heading for each in page.sections]
    assert "Refinement" not in headings
    assert "Choice of windows" not in headings
    untested = identification_page({**DOCUMENT, "residual_tests": None, "validation": []})
    assert section(untested, "What each equation leaves").tables == []
