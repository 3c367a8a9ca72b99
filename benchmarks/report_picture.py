"""`docs/images/report.png`: the first screen of a report, as the browser shows it.

`python -m benchmarks.report_picture`; needs chromium.
"""

import contextlib
import shutil
import tempfile
from io import BytesIO
from pathlib import Path

from PIL import Image

from riecjax.cli.main import run

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "report.png"
WIDTH, HEIGHT, COLOURS = 1000, 560, 48


EXAMPLE: tuple[str, ...] = (
    "simulate quarter-car-source --input white-noise --seed 1 --out drive.csv",
    "identify drive.csv --model quarter-car --out result",
)
"""The README's commands."""


def first_screen(report: Path) -> bytes:
    """What the browser shows of a page before anyone scrolls, as PNG."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        found = shutil.which("chromium")
        browser = started.chromium.launch(executable_path=found, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.goto(report.as_uri())
        page.wait_for_selector("html.drawn", state="attached", timeout=120_000)
        picture = page.screenshot()
        browser.close()
    return picture


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for command in EXAMPLE:
            run(command.split())
        picture = first_screen(Path(folder) / "result" / "report.html")
    small = Image.open(BytesIO(picture)).convert("RGB").quantize(COLOURS)
    small.save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
