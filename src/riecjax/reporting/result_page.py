"""The page of an identification, and its folder."""

from collections.abc import Mapping
from pathlib import Path

from riecjax.assessment.assessment import Assessment
from riecjax.reporting.checking import excitation_table, named
from riecjax.reporting.document import Document, ends_of, number
from riecjax.reporting.estimate import parameter_table, several
from riecjax.reporting.identification import (
    choice_in_words,
    identification_document,
    modes_in_words,
    search_in_words,
    windows_in_words,
)
from riecjax.reporting.output import require_folder, write_folder
from riecjax.reporting.page import Page, Section
from riecjax.reporting.result_figures import identification_figures
from riecjax.reporting.tables import Table
from riecjax.reporting.verdict import doubt_in_words

BETWEEN = "{} to {}"
"""An interval in words."""


def identification_page(document: Document) -> Page:
    """What `riecjax identify` found, from its document; with the charts of
    [`identification_figures`][riecjax.reporting.identification_figures]."""
    files = ", ".join(dict.fromkeys(_name(r["file"]) for r in document["provenance"]["records"]))
    sections = [
        _parameters(document),
        _refinement(document["refinement"]),
        _fit(document),
        Section("Curves", charts=("curves",)),
        Section(
            "Hidden modes",
            [_sentence(line) for line in modes_in_words(document["modes"])],
            charts=("mode_map",) if document["modes"] else (),
        ),
        _validation(document["validation"]),
        _residuals(document["residual_tests"] or {}),
        Section("Estimates by window length", charts=("window_sweep",)),
        _choice(document["window_choice"]),
        _recordings(document),
    ]
    groups = []  # what lies behind some warnings, and what it concerns
    for cause in document["verdict"]["causes"]:
        names, said = ", ".join(cause["parameters"]), _sentence(cause["phrase"])[:-1]
        groups.append((said if said.endswith(names) else f"{said}: {names}", cause["codes"]))
    return Page(
        f"{document['model']} from {files}",
        document["verdict"]["sentence"],
        [section for section in sections if section is not None],
        _answer(document),
        groups,
    )


def _answer(document: Document) -> Section:
    """The verdict: what can be trusted, how far, and what to do about the rest."""
    verdict = document["verdict"]
    rows = []
    for name, entry in document["parameters"].items():
        judged = verdict["parameters"][name]
        rows.append(
            (
                *(name, number(entry["value"]), entry["unit"], doubt_in_words(judged["share"])),
                BETWEEN.format(*ends_of(judged["doubt"])),
                *(judged["level"], judged["reason"]),
            )
        )
    header = ("parameter", "value", "unit", "doubt", "from .. to", "verdict", "because of")
    return Section(
        "Verdict",
        text=[
            *(
                f"{step['words']}: {step['command']}" if step["command"] else f"{step['words']}."
                for step in verdict["next"]
            ),
            f"Where {'; '.join(document['equations'])}.",
        ],
        tables=[Table(header, rows)],
    )


def _parameters(document: Document) -> Section:
    refinement = document["refinement"] or {}
    said = [choice_in_words(refinement)] if refinement else []
    criterion = document["criterion"]
    settings = ", ".join(f"{key} {value}" for key, value in criterion.items() if key != "name")
    by = f"identified by {criterion['name'].upper()}{f' ({settings})' if settings else ''}"
    return Section(
        "Parameters",
        text=[_sentence(line) for line in (*said, by, *windows_in_words(document))],
        tables=[
            parameter_table(document, BETWEEN),
            excitation_table(
                document["excitation"],
                "How each is excited: the share of its regressor that no combination of the others "
                "could do as well, and the share that sensors' noise makes up",
            ),
        ],
        charts=("correlation",),
    )


def _refinement(entries: Document | None) -> Section | None:
    if entries is None or entries["refined"] is None:
        return None
    by, *_, intervals = search_in_words(entries)
    header, channels, caption = ["left, r.m.s.", "before", "after", "unit"], {}, ""
    if (whiteness := entries["whiteness"]) is not None:
        header += ["whiteness", "chi-squared"]
        channels = whiteness["channels"]
        caption = (
            f"Whiteness: Ljung-Box over 20 lags, 1 of white noise, which stays below "
            f"{whiteness['threshold']:.2g}. Chi-squared: what is left in units of the sensor's "
            f"noise power"
        )
    left = [
        (
            *(name, number(one["before"], 4), number(one["after"], 4), one["unit"]),
            *(number(channels[name][key], 3) for key in ("statistic", "chi_squared") if channels),
        )
        for name, one in entries["left"].items()
    ]
    fits = [
        (
            f"{run['on']}{' (fitted)' if run['fitted'] else ''}: {name}",
            *(
                _fixed((run[when]["signals"].get(name) or {}).get("fit_percent"))
                for when in ("before", "after")
            ),
        )
        for run in entries["simulations"]
        for name in run["after"]["signals"]
    ]
    tables = [Table(header, left, caption)]
    tables.append(Table(("simulated, fit", "before / %", "after / %"), fits))
    at_bound = entries["at_bound"]
    return Section(
        "Refinement",
        text=[
            _sentence(by),
            f"What is left before and after is of {entries['basis']}.",
            *(["Simulations start from the state as recorded."] if fits else []),
            *([f"At a bound: {', '.join(at_bound)}."] if at_bound else []),
            _sentence(intervals.split("; ")[0]),
        ],
        tables=tables,
    )


def _fit(document: Document) -> Section:
    residual, rows = document["residual"], []
    for stage in residual["stages"]:
        rows.append(
            (
                stage["equation"],
                ", ".join(stage["parameters"]),
                _percent(stage["relative_rms"]),
                number(stage["condition_number"], 3),
                str(stage["rows"]),
            )
        )
        for name in several(stage):
            left = residual["equations"][name]
            rows.append((name, "", _percent(left["relative_rms"]), "", str(left["rows"])))
    header = ("equation", "estimates", "relative residual / %", "condition number", "rows")
    return Section("Fit", tables=[Table(header, rows)], charts=("fit",))


def _validation(runs: list[Document]) -> Section | None:
    if not runs:
        return None
    header = ("signal", "fit / %", "variance accounted for / %", "error p / %", "predicted")
    tables = [
        Table(
            header,
            [
                (
                    name if one["judged"] else f"{name} (not judged)",
                    _fixed(one["fit_percent"]),
                    _fixed(one["vaf_percent"]),
                    _fixed(one["p_percent"]),
                    one["grade"],
                )
                for name, one in run["signals"].items()
            ],
            run["on"],
        )
        for run in runs
        if run["signals"]
    ]
    return Section(
        "Validation by simulation",
        text=[f"The model was validated on {run['on']}. {run['verdict']}" for run in runs],
        tables=tables,
        charts=[f"validation_{i + 1}" for i in range(len(runs))],
    )


def _residuals(tests: Mapping[str, Document]) -> Section:
    rows = []
    for name, one in tests.items():
        strongest = ("none", "", "", "")
        if one["follows"]:
            first = one["follows"][0]
            correlation, bound = (f"{first[key]:.2f}" for key in ("correlation", "bound"))
            strongest = (first["signal"], correlation, bound, number(first["lag_s"], 3))
        peak = "none" if one["peak"] is None else f"{one['peak']['frequency']:.3g}"
        left, alike = _percent(one["relative_rms"]), number(one["correlation_time_s"], 2)
        rows.append((name, left, peak, *strongest, alike))
    header = (
        "equation",
        "error / %",
        "peak / Hz",
        "follows",
        "correlation",
        "by chance up to",
        "later by / s",
        "alike for / s",
    )
    return Section(
        "What each equation leaves",
        text=[_residual_in_words(name, one) for name, one in tests.items()],
        tables=[Table(header, rows)] if rows else [],
        charts=[f"residual_{i + 1}" for i in range(len(tests))],
    )


def _residual_in_words(name: str, one: Document) -> str:
    said = [f"{name}: the error is {_percent(one['relative_rms'])} % of the target"]
    if (peak := one["peak"]) is not None:
        said.append(
            f"{100 * peak['share']:.0f} % of its power lies from {peak['low']:.3g} to "
            f"{peak['high']:.3g} Hz, about a peak near {peak['frequency']:.3g} Hz"
        )
    else:
        said.append("its spectrum has no peak that chance does not explain")
    if one["follows"]:
        first = one["follows"][0]
        if abs(first["correlation"]) > first["bound"]:
            said.append(f"it follows {first['signal']} (correlation {first['correlation']:.2f})")
        else:
            said.append("it follows no signal more than by chance")
    windows = one["windows"]
    if windows is not None and windows["p_value"] is not None:
        ratio = windows["mean_square_ratio"] ** 0.5
        said.append(
            f"errors of windows are {ratio:.2g} times as large in the loudest stretch as in the "
            f"quietest (probability of so much by chance: {windows['p_value']:.2g})"
        )
    return f"{'; '.join(said)}."


def _choice(choice: Document | None) -> Section | None:
    if choice is None:
        return None
    rows = [
        (
            name,
            _percent(one["current_error_share"]),
            _percent(one["least_error_share"]),
            number(one["best_length_s"], 3),
        )
        for name, one in choice["equations"].items()
    ]
    header = ("equation", "error in the windows in use / %", "least error / %", "at length / s")
    return Section(
        "Choice of windows",
        text=[choice["reason"]],
        tables=[Table(header, rows)],
        charts=("window_choice",),
    )


def _recordings(document: Document) -> Section:
    provenance = document["provenance"]
    rows = [
        (
            named({**record, "file": _name(record["file"])}),
            str(record["samples"]),
            number(1 / record["time_step"]),
            number(record["samples"] * record["time_step"], 4),
        )
        for record in provenance["records"]
    ]
    return Section(
        "Recordings",
        text=[f"Prepared: {step}" for step in provenance["preparation"]],
        tables=[Table(("file", "samples identified from", "rate / Hz", "duration / s"), rows)],
    )


def _sentence(line: str) -> str:
    return f"{line[0].upper()}{line[1:].rstrip('.')}."


def _percent(share: float | None, digits: int = 3) -> str:
    return number(None if share is None else 100 * share, digits)


def _fixed(percent: float | None) -> str:
    return "none" if percent is None else f"{percent:.1f}"


def _name(file: str) -> str:
    return file.replace("\\", "/").rsplit("/", 1)[-1]


def write_report(assessment: Assessment, folder: str | Path) -> None:
    """Write results.json, figures and report.html to a folder, as `riecjax identify --out` does.

    **Raises:** `DataError` if the folder cannot be written, or without a package for reports.
    """
    require_folder(Path(folder))
    document = identification_document(assessment)
    charts = identification_figures(assessment)
    write_folder(Path(folder), document, charts, identification_page(document))
