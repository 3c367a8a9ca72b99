"""Every picture of the gallery is one that a notebook keeps or a script has made."""

import re
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[2]
ENTRIES = re.findall(
    r"^- \[!\[([^]]+)\]\(([^)]+)\)[^]]*\]\(([^)]+)\)\n  (\S.*)$",
    (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)


def slug(heading: str) -> str:
    """The anchor that the site gives a heading."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


def test_the_gallery_has_some_pictures():
    text = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert 8 <= len(ENTRIES) <= 14
    assert len(ENTRIES) == text.count("![")


@pytest.mark.parametrize(("picture", "link"), [(each[1], each[2]) for each in ENTRIES])
def test_picture_and_link_are_there(picture, link):
    if picture.startswith("images/"):
        assert (ROOT / "docs" / picture).is_file()
    else:
        _, notebook, cell = picture.removesuffix(".png").split("/")
        read = nbformat.read(ROOT / "notebooks" / f"{notebook}.ipynb", as_version=4)
        (shown,) = (each.outputs for each in read.cells if each.id == cell)
        assert any("image/png" in output.get("data", {}) for output in shown)
    page, _, anchor = link.partition("#")
    file = ROOT / page if page.startswith("notebooks/") else ROOT / "docs" / page
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".ipynb":
        text = "\n".join(cell.source for cell in nbformat.reads(text, as_version=4).cells)
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    assert not anchor or anchor in map(slug, headings)
