"""A report as a browser shows it: figures are drawn, nothing is asked of a network."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from reporting_charts import EVERYTHING

from report_browser import assert_drawn, drawn_page, launched, overlaps
from riecjax.reporting.output import write_folder
from riecjax.reporting.page import Page, Section
from riecjax.reporting.tables import Table

WIDTHS = (390, 1280)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with launched() as found:
        yield found


@pytest.fixture(scope="module")
def every_mark(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("marks")
    long = "one heading that is much longer than a telephone is wide, and_a_name_without_gaps" * 2
    page = Page(
        long,
        long,
        [
            Section(long, [long], [Table([long] * 9, [[long] * 9], long)], ["everything"]),
            Section("Last"),
        ],
    )
    document = {"warnings": [{"code": long, "message": long}], "provenance": {"long": long}}
    write_folder(folder / "every", document, {"everything": EVERYTHING}, page)
    return folder / "every"


@pytest.fixture(scope="module", params=WIDTHS)
def width(request) -> int:
    return request.param


@pytest.fixture(scope="module")
def opened(browser, every_mark, width) -> Iterator[Any]:
    """A page with its figures drawn, without complaints or requests; tests only look at it."""
    with drawn_page(browser, every_mark / "report.html", width) as page:
        yield page


def test_every_figure_is_drawn_and_the_page_no_wider_than_the_screen(opened, width):
    assert_drawn(opened, width)


def test_titles_and_legends_of_panels_do_not_cover_each_other(opened):
    assert overlaps(opened) == []


def test_a_point_tells_its_values(opened):
    plot = opened.locator(".js-plotly-plot").last
    plot.scroll_into_view_if_needed()
    # Where Plotly itself draws the first point of a series inside its axes.
    place = plot.evaluate(
        """(plot) => {
            const trace = plot._fullData.find((each) => each.hoverinfo !== 'skip'
                && each.type === 'scatter' && each.x.length > 1 && each.x[1] !== null);
            const x = plot._fullLayout['xaxis' + trace.xaxis.slice(1)];
            const y = plot._fullLayout['yaxis' + trace.yaxis.slice(1)];
            const box = plot.getBoundingClientRect();
            const i = trace.x.findIndex((value, j) => j > 0 && trace.y[j] !== null);
            const [right, down] = [x._offset + x.d2p(trace.x[i]), y._offset + y.d2p(trace.y[i])];
            return [box.left + right, box.top + down];
        }"""
    )
    opened.mouse.move(place[0] + 1, place[1] + 1)
    opened.mouse.move(*place)
    hover = plot.locator(".hoverlayer .hovertext")
    hover.first.wait_for(timeout=5_000)
    assert any(character.isdigit() for character in hover.first.text_content())


@pytest.mark.slow
def test_without_scripts_and_in_print_there_are_pictures(browser, every_mark):
    address = (every_mark / "report.html").as_uri()
    page = browser.new_page(java_script_enabled=False)
    page.goto(address)
    assert page.locator("figure img").is_visible()
    assert not page.locator("figure .plot").is_visible()
    page.close()
    page = browser.new_page()
    page.goto(address)
    page.wait_for_selector("html.drawn", state="attached", timeout=60_000)
    page.emulate_media(media="print")
    assert page.locator("figure img").is_visible()
    assert not page.locator("figure .plot").is_visible()
    page.close()
