"""The page of an identification, and its folder."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from riecjax.assessment.assessment import Assessment
from riecjax.reporting import Page, Section, Table, identification_figures
from riecjax.reporting.checking import excitation_table, named
from riecjax.reporting.document import Document, ends_of, number
from riecjax.reporting.estimate import fits_of, parameter_table, settings_in_words
from riecjax.reporting.identification import (
    choice_in_words,
    identification_document,
    modes_in_words,
    search_in_words,
    windows_in_words,
)
from riecjax.reporting.output import require_folder, write_folder


def identification_page(document: Document) -> Page:
    """What `riecjax identify` found, from its document; with the charts of
    [`identification_figures`][riecjax.reporting.identification_figures]."""
    files = ", ".join(dict.fromkeys(_name(r["file"]) for r in document["provenance"]["records"]))
    runs, residual_tests = document["validation"], document["residual_tests"] or {}
    refinement, choice = document["refinement"], document["window_choice"]
    sections = [
        _parameters(document),
        *([_refinement(refinement)] if refinement and refinement["refined"] is not None else []),
        _fit(document["residual"]),
        Section("Curves", charts=("curves",)),
        Section(
            "Hidden modes",
            [_sentence(line) for line in modes_in_words(document["modes"])],
            charts=("mode_map",) if document["modes"] else (),
        ),
        *([_validation(runs)] if runs else []),
        Section(
            "What each equation leaves",
            [_residual_in_words(name, tests) for name, tests in residual_tests.items()],
            [_residuals(residual_tests)],
            [f"residual_{i + 1}" for i in range(len(residual_tests))],
        ),
        Section("Estimates by window length", charts=("window_sweep",)),
        *([_choice(choice)] if choice else []),
        _recordings(document["provenance"]),
    ]
    # What lies behind some warnings, and what it concerns.
    causes = [
        (_sentence(cause["phrase"])[:-1], ", ".join(cause["parameters"]), cause["codes"])
        for cause in document["verdict"]["causes"]
    ]
    groups = [
        (phrase if phrase.endswith(names) else f"{phrase}: {names}", codes)
        for phrase, names, codes in causes
    ]
    # What can be trusted, how far, and what to do about the rest.
    columns = ("value", "unit", "doubt", "from .. to", "verdict", "because of")
    answer = Section(
        "Verdict",
        [
            *(
                f"{step['words']}: {step['command']}" if step["command"] else f"{step['words']}."
                for step in document["verdict"]["next"]
            ),
            f"Where {'; '.join(document['equations'])}.",
        ],
        [parameter_table({**document, "known": {}}, columns, _between)],
    )
    title, lead = f"{document['model']} from {files}", document["verdict"]["sentence"]
    return Page(title, lead, sections, answer, groups)


def _between(ends: Sequence[float | None]) -> str:
    return " to ".join(ends_of(ends))


def _parameters(document: Document) -> Section:
    refinement, criterion = document["refinement"], document["criterion"]
    settings = settings_in_words(criterion)
    by = f"identified by {criterion['name'].upper()}{f' ({settings})' if settings else ''}"
    lines = [
        *([choice_in_words(refinement)] if refinement else []),
        by,
        *windows_in_words(document),
    ]
    tables = [
        parameter_table(document, interval=_between),
        excitation_table(
            document["excitation"],
            "How each is excited: the share of its regressor that no combination of the others "
            "could do as well, and the share that sensors' noise makes up",
        ),
    ]
    return Section("Parameters", [*map(_sentence, lines)], tables, ("correlation",))


def _refinement(entries: Document) -> Section:
    by, *_, intervals = search_in_words(entries)
    channels, caption = {}, ""
    cells = {
        "before": lambda left: number(left["before"], 4),
        "after": lambda left: number(left["after"], 4),
        "unit": lambda left: left["unit"],
    }
    if (whiteness := entries["whiteness"]) is not None:
        channels = whiteness["channels"]
        cells["whiteness"] = lambda left: number(left.get("statistic"), 3)
        cells["chi-squared"] = lambda left: number(left.get("chi_squared"), 3)
        caption = (
            f"Whiteness: Ljung-Box over 20 lags, 1 of white noise, which stays below "
            f"{whiteness['threshold']:.2g}. Chi-squared: what is left in units of the sensor's "
            f"noise power"
        )
    left = {name: each | channels.get(name, {}) for name, each in entries["left"].items()}
    fits = [
        (f"{run['on']}{' (fitted)' if run['fitted'] else ''}: {name}", (run, name))
        for run in entries["simulations"]
        for name in run["after"]["signals"]
    ]

    def fit(when: str) -> Callable[[tuple[Document, str]], str]:
        return lambda pair: _fixed(pair[0][when]["signals"].get(pair[1], {}).get("fit_percent"))

    simulated = {"before / %": fit("before"), "after / %": fit("after")}
    at_bound = entries["at_bound"]
    text = [
        _sentence(by),
        f"What is left before and after is of {entries['basis']}.",
        *(["Simulations start from the state as recorded."] if fits else []),
        *([f"At a bound: {', '.join(at_bound)}."] if at_bound else []),
        _sentence(intervals.split("; ")[0]),
    ]
    tables = [
        Table.of("left, r.m.s.", left.items(), cells, caption),
        Table.of("simulated, fit", fits, simulated),
    ]
    return Section("Refinement", text, tables)


def _fit(residual: Document) -> Section:
    cells = {
        "estimates": lambda fit: ", ".join(fit.get("parameters", ())),
        "relative residual / %": lambda fit: _percent(fit["relative_rms"]),
        "condition number": lambda fit: (
            number(fit["condition_number"], 3) if "condition_number" in fit else ""
        ),
        "rows": lambda fit: str(fit["rows"]),
    }
    table = Table.of("equation", fits_of(residual), cells)
    return Section("Fit", tables=[table], charts=("fit",))


def _validation(runs: Sequence[Document]) -> Section:
    cells = {
        "fit / %": lambda signal: _fixed(signal["fit_percent"]),
        "variance accounted for / %": lambda signal: _fixed(signal["vaf_percent"]),
        "error p / %": lambda signal: _fixed(signal["p_percent"]),
        "predicted": lambda signal: signal["grade"],
    }

    def table(run: Document) -> Table:
        signals = run["signals"].items()
        named = [(n if one["judged"] else f"{n} (not judged)", one) for n, one in signals]
        return Table.of("signal", named, cells, run["on"])

    text = [f"The model was validated on {run['on']}. {run['verdict']}" for run in runs]
    charts = [f"validation_{i + 1}" for i in range(len(runs))]
    return Section("Validation by simulation", text, [*map(table, runs)], charts)


def _residuals(tests: Mapping[str, Document]) -> Table:
    def followed(form: Callable[[Document], str], none: str = "") -> Callable[[Document], str]:
        return lambda test: form(test["follows"][0]) if test["follows"] else none

    cells = {
        "error / %": lambda test: _percent(test["relative_rms"]),
        "peak / Hz": lambda test: f"{test['peak']['frequency']:.3g}" if test["peak"] else "none",
        "follows": followed(lambda first: first["signal"], "none"),
        "correlation": followed(lambda first: f"{first['correlation']:.2f}"),
        "by chance up to": followed(lambda first: f"{first['bound']:.2f}"),
        "later by / s": followed(lambda first: number(first["lag_s"], 3)),
        "alike for / s": lambda test: number(test["correlation_time_s"], 2),
    }
    return Table.of("equation", tests.items(), cells)


def _residual_in_words(name: str, tests: Document) -> str:
    peak, windows = tests["peak"], tests["windows"]
    words = [
        f"{name}: the error is {_percent(tests['relative_rms'])} % of the target",
        "its spectrum has no peak that chance does not explain"
        if peak is None
        else f"{100 * peak['share']:.0f} % of its power lies from {peak['low']:.3g} to "
        f"{peak['high']:.3g} Hz, about a peak near {peak['frequency']:.3g} Hz",
        *(
            f"it follows {first['signal']} (correlation {first['correlation']:.2f})"
            if abs(first["correlation"]) > first["bound"]
            else "it follows no signal more than by chance"
            for first in tests["follows"][:1]
        ),
    ]
    if windows is not None and windows["p_value"] is not None:
        ratio = windows["mean_square_ratio"] ** 0.5
        words.append(
            f"errors of windows are {ratio:.2g} times as large in the loudest stretch as in the "
            f"quietest (probability of so much by chance: {windows['p_value']:.2g})"
        )
    return f"{'; '.join(words)}."


def _choice(choice: Document) -> Section:
    cells = {
        "error in the windows in use / %": lambda one: _percent(one["current_error_share"]),
        "least error / %": lambda one: _percent(one["least_error_share"]),
        "at length / s": lambda one: number(one["best_length_s"], 3),
    }
    table = Table.of("equation", choice["equations"].items(), cells)
    return Section("Choice of windows", [choice["reason"]], [table], ("window_choice",))


def _recordings(provenance: Document) -> Section:
    records = [
        (named({**record, "file": _name(record["file"])}), record)
        for record in provenance["records"]
    ]
    cells = {
        "samples identified from": lambda record: str(record["samples"]),
        "rate / Hz": lambda record: number(1 / record["time_step"]),
        "duration / s": lambda record: number(record["samples"] * record["time_step"], 4),
    }
    text = [f"Prepared: {step}" for step in provenance["preparation"]]
    return Section("Recordings", text, [Table.of("file", records, cells)])


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
