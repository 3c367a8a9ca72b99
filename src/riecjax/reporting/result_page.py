"""The page of an identification, and its folder."""

import tempfile
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from riecjax.assessment.assess import Assessment
from riecjax.reporting import Page, Section, Table, answer_of, identification_figures
from riecjax.reporting import answer as parts
from riecjax.reporting.answer import Answer
from riecjax.reporting.checking import excitation_table
from riecjax.reporting.document import ends_of, number, percents
from riecjax.reporting.identification import (
    choice_in_words,
    fits_of,
    modes_in_words,
    plain_in_words,
    search_in_words,
    settings_in_words,
    words_of,
)
from riecjax.reporting.output import REPORT, require_folder, write_folder
from riecjax.reporting.parameters import parameter_table
from riecjax.shows import show
from riecjax.validation.tests import Test


def identification_page(answer: Answer, tests: Sequence[Test] = ()) -> Page:
    """What `riecjax identify` found; with the charts of
    [`identification_figures`][riecjax.reporting.identification_figures].

    **Arguments:** `tests` that it was put to: findings of your own stand beside what they tell.
    """
    files = ", ".join(dict.fromkeys(_name(record.file) for record in answer.provenance.records))
    sections = [_parameters(answer)]
    for name, make in SECTIONS.items():
        if (part := getattr(answer, name)) is not None:
            sections += make(part)
    findings = {test.name: test.findings() for test in tests}
    further = [
        Section(
            _sentence(name.replace("_", " "))[:-1],
            [
                *(f.message for f in findings.get(name, ())),
                _sentence(plain_in_words(entry) or "no numbers"),
            ],
            charts=(name,),
        )
        for name, entry in (answer.tests or {}).items()
    ]
    # What lies behind some warnings, and what it concerns.
    causes = [
        (_heading(cause), ", ".join(cause.parameters), cause.codes)
        for cause in answer.verdict.causes
    ]
    groups = [
        (phrase if phrase.endswith(names) else f"{phrase}: {names}", codes)
        for phrase, names, codes in causes
    ]
    # What can be trusted, how far, and what to do about the rest.
    columns = ("value", "unit", "doubt", "from .. to", "verdict", "because of")
    estimated = msgspec.structs.replace(answer, known={})
    verdict = Section(
        "Verdict",
        [
            *(
                f"Done: {step.said}, by {' '.join(step.options)}."
                for step in answer.verdict.followed
            ),
            *(
                f"{step.said}: {step.command}" if step.command else f"{step.said}."
                for step in answer.verdict.next
            ),
            f"Where {'; '.join(answer.equations)}.",
        ],
        [parameter_table(estimated, columns, _between)],
    )
    title, lead = f"{answer.model} from {files}", answer.verdict.sentence
    page = [*sections, *further, _recordings(answer.provenance)]
    return Page(title, lead, page, verdict, groups)


def _between(ends: parts.Ends) -> str:
    return " to ".join(ends_of(ends))


def _parameters(answer: Answer) -> Section:
    criterion = answer.criterion
    settings = settings_in_words(criterion)
    by = f"identified by {criterion['name'].upper()}{f' ({settings})' if settings else ''}"
    lines = [
        *([choice_in_words(answer.refinement)] if answer.refinement else []),
        by,
        *words_of(answer, "provenance", "noise"),
    ]
    tables = [
        parameter_table(answer, interval=_between),
        excitation_table(
            answer.excitation,
            "How each is excited: the share of its regressor that no combination of the others "
            "could do as well, and the share that sensors' noise makes up",
        ),
    ]
    return Section("Parameters", [*map(_sentence, lines)], tables, ("correlation",))


def _refinement(refinement: parts.RefinementPart) -> list[Section]:
    if refinement.refined is None:
        return []
    by, *_, intervals = search_in_words(refinement)
    whiteness, caption = refinement.whiteness, ""
    header = ["left, r.m.s.", "before", "after", "unit"]
    left = [
        [name, number(rms.before, 4), number(rms.after, 4), rms.unit]
        for name, rms in refinement.left.items()
    ]
    if whiteness is not None:
        header += ["whiteness", "chi-squared"]
        for row in left:
            channel = whiteness.channels.get(row[0], parts.ChannelWhiteness(None))
            row += [number(channel.statistic, 3), number(channel.chi_squared, 3)]
        caption = (
            f"Whiteness: Ljung-Box over 20 lags, 1 of white noise, which stays below "
            f"{whiteness.threshold:.2g}. Chi-squared: what is left in units of the sensor's "
            f"noise power"
        )
    fits = [
        [
            f"{run.on}{' (fitted)' if run.fitted else ''}: {name}",
            *(_fixed(held.fit(name)) for held in (run.before, run.after)),
        ]
        for run in refinement.simulations
        for name in run.after.signals
    ]
    text = [
        _sentence(by),
        f"What is left before and after is of {refinement.basis}.",
        *(["Simulations start from the state as recorded."] if fits else []),
        *([f"At a bound: {', '.join(refinement.at_bound)}."] if refinement.at_bound else []),
        _sentence(intervals.split("; ")[0]),
    ]
    tables = [
        Table(header, left, caption),
        Table(("simulated, fit", "before / %", "after / %"), fits),
    ]
    return [Section("Refinement", text, tables)]


def _fit(residual: parts.ResidualPart) -> list[Section]:
    cells = {
        "estimates": lambda fit: ", ".join(getattr(fit, "parameters", ())),
        "relative residual / %": lambda fit: _percent(fit.relative_rms),
        "condition number": lambda fit: (
            number(fit.condition_number, 3) if isinstance(fit, parts.StageFit) else ""
        ),
        "rows": lambda fit: str(fit.rows),
    }
    table = Table.of("equation", fits_of(residual), cells)
    return [Section("Fit", tables=[table], charts=("fit",)), Section("Curves", charts=("curves",))]


def held_out_table(run: parts.HeldOutPart) -> Table:
    """How well each signal is predicted."""
    cells = {
        "fit / %": lambda signal: _fixed(signal.fit_percent),
        "variance accounted for / %": lambda signal: _fixed(signal.vaf_percent),
        "error p / %": lambda signal: _fixed(signal.p_percent),
        "predicted": lambda signal: signal.grade,
    }
    signals = run.signals.items()
    named = [(n if signal.judged else f"{n} (not judged)", signal) for n, signal in signals]
    return Table.of("signal", named, cells, run.on or "")


def _validation(runs: Sequence[parts.HeldOutPart]) -> list[Section]:
    text = [f"The model was validated on {run.on}. {run.verdict}" for run in runs]
    charts = [f"validation_{i + 1}" for i in range(len(runs))]
    return [Section("Validation by simulation", text, [*map(held_out_table, runs)], charts)]


def residual_table(tests: Mapping[str, parts.ResidualTest]) -> Table:
    """What each equation leaves, sample by sample."""
    cells = {
        "error / %": lambda test: _percent(test.relative_rms),
        "peak / Hz": lambda test: f"{test.peak.frequency:.3g}" if test.peak else "none",
    }
    return Table.of("equation", tests.items(), cells)


def _residuals(tests: Mapping[str, parts.ResidualTest]) -> list[Section]:
    text = [_residual_in_words(name, test) for name, test in tests.items()]
    charts = [f"residual_{i + 1}" for i in range(len(tests))]
    return [Section("What each equation leaves", text, [residual_table(tests)], charts)]


def _residual_in_words(name: str, test: parts.ResidualTest) -> str:
    peak, windows = test.peak, test.windows
    words = [
        f"{name}: the error is {_percent(test.relative_rms)} % of the target",
        "its spectrum has no peak that chance does not explain"
        if peak is None
        else f"{percents(peak.share, '.0f')} % of its power lies from {peak.low:.3g} to "
        f"{peak.high:.3g} Hz, about a peak near {peak.frequency:.3g} Hz",
    ]
    if windows is not None and windows.p_value is not None and windows.mean_square_ratio:
        ratio = windows.mean_square_ratio**0.5
        words.append(
            f"errors of windows are {ratio:.2g} times as large in the loudest stretch as in the "
            f"quietest (probability of so much by chance: {windows.p_value:.2g})"
        )
    return f"{'; '.join(words)}."


SECTIONS: dict[str, Callable[[Any], list[Section]]] = {
    "refinement": _refinement,
    "residual": _fit,
    "modes": lambda modes: [
        Section("Hidden modes", [*map(_sentence, modes_in_words(modes))], charts=("mode_map",))
    ],
    "validation": _validation,
    "residual_tests": _residuals,
    "window_sweep": lambda _: [Section("Estimates by window length", charts=("window_sweep",))],
}
"""What the page shows of parts of an answer, in this order."""


def _recordings(provenance: parts.Provenance) -> Section:
    records = [
        (msgspec.structs.replace(record, file=_name(record.file)).name, record)
        for record in provenance.records
    ]
    cells = {
        "samples identified from": lambda record: str(record.samples),
        "rate / Hz": lambda record: number(1 / record.time_step),
        "duration / s": lambda record: number(record.samples * record.time_step, 4),
    }
    text = [f"Prepared: {step}" for step in provenance.preparation]
    return Section("Recordings", text, [Table.of("file", records, cells)])


def _heading(cause: parts.CausePart) -> str:
    """Its phrase, capitalised unless it begins with a parameter's name."""
    begins_with_name = cause.phrase.split(maxsplit=1)[0] in cause.parameters
    return cause.phrase if begins_with_name else _sentence(cause.phrase)[:-1]


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
    answer, charts = answer_of(assessment), identification_figures(assessment)
    page = identification_page(answer, assessment.tests)
    write_folder(Path(folder), msgspec.to_builtins(answer), charts, page)


@show.register
def _(assessment: Assessment) -> Path:
    page = Path(tempfile.mkdtemp(prefix="riecjax_")) / REPORT
    write_report(assessment, page.parent)
    webbrowser.open(page.as_uri())
    return page
