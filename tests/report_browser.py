"""A report in a headless browser: what must be true of every one."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
LOCAL = ("file:", "data:", "blob:")


@contextmanager
def launched() -> Iterator[Any]:
    """A browser; skips the test, with the reason, where none is installed."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no browser is installed: none of {', '.join(BROWSERS)}")
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=found, args=list(OPTIONS))
        yield opened
        opened.close()


@contextmanager
def drawn_page(browser: Any, report: Path, width: int) -> Iterator[Any]:
    """The page with its figures drawn; fails on any complaint or request."""
    page = browser.new_page(viewport={"width": width, "height": 900})
    problems: list[str] = []
    page.on("console", lambda message: problems.append(message.text))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("request", lambda r: None if r.url.startswith(LOCAL) else problems.append(r.url))
    page.goto(report.as_uri())
    page.wait_for_selector("html.drawn", state="attached", timeout=120_000)
    yield page
    page.close()
    assert problems == []


def assert_drawn(page: Any, width: int) -> None:
    """Every figure shows its marks, and nothing is wider than the screen."""
    figures = page.locator("figure")
    assert figures.count() >= 1
    for i in range(figures.count()):
        figure = figures.nth(i)
        assert figure.locator(".js-plotly-plot .main-svg").count() > 0
        assert figure.locator("path.js-line, path.point, .errorbar, .hm image").count() > 0
        assert not figure.locator("img").is_visible()
    wide, seen = page.evaluate(
        "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"
    )
    assert wide <= seen == width


def overlaps(page: Any) -> list[str]:
    """Titles and entries of legends that are cut off or cover one another."""
    return page.evaluate(
        """() => [...document.querySelectorAll('.js-plotly-plot')].flatMap((plot) => {
            const boxes = [...plot.querySelectorAll('.annotation-text, .legendtext')]
                .map((each) => [each.textContent, each.getBoundingClientRect()]);
            const edge = plot.getBoundingClientRect();
            const cut = boxes.filter(([, a]) => a.left < edge.left || a.top < edge.top
                || a.right > edge.right || a.bottom > edge.bottom).map(([name]) => name);
            const meet = boxes.flatMap(([name, a], i) => boxes.slice(i + 1)
                .filter(([, b]) => a.left < b.right - 1 && b.left < a.right - 1
                    && a.top < b.bottom - 1 && b.top < a.bottom - 1)
                .map(([other]) => name + ' / ' + other));
            return [...cut, ...meet];
        })"""
    )
