"""What the site needs beyond its plugins: the notebooks, their pictures, nothing from elsewhere."""

import base64
import json
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
ELSEWHERE = r"""(?:https?:)?//[^"'\s>]+"""
FETCHED = re.compile(
    rf"""<(?:script|img|iframe|source)\b[^>]*\bsrc=["']?({ELSEWHERE})"""
    rf"""|<link\b(?![^>]*\brel=["']?(?:canonical|alternate))[^>]*\bhref=["']?({ELSEWHERE})"""
)
MATHJAX = re.compile(
    r"<!-- Load mathjax -->.*?<!-- End of mathjax configuration -->", flags=re.DOTALL
)

PICTURE = re.compile(r"\bgallery/(\w+)/([\w-]+)\.png")
"""A notebook's picture, as pages name it: by the notebook and the cell that draws it."""


@event_priority(100)  # before the plugin that turns notebooks into pages
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The notebooks stand beside `docs`, and appear in the site under `notebooks/`.

    Of their pictures those that the gallery names appear under `gallery/`.
    """
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        name = path.relative_to(ROOT).as_posix()
        files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for notebook, cell in sorted(set(PICTURE.findall(gallery))):
        name = f"gallery/{notebook}/{cell}.png"
        files.append(File.generated(config, name, content=picture_of(notebook, cell)))
    return files


def picture_of(notebook: str, cell: str) -> bytes:
    """The picture that a notebook keeps of a cell, as PNG."""
    file = ROOT / "notebooks" / f"{notebook}.ipynb"
    for each in json.loads(file.read_text(encoding="utf-8"))["cells"]:
        for output in each.get("outputs", []) if each["id"] == cell else []:
            if (png := output.get("data", {}).get("image/png")) is not None:
                return base64.b64decode("".join(png))
    raise PluginError(f"cell '{cell}' of {file.name} shows no picture.")


def on_page_content(html: str, **_: object) -> str:
    """No notebook has formulas to set, so none loads what would set them."""
    return MATHJAX.sub("", html)


def on_post_page(output: str, page: object, **_: object) -> str:
    """A page that would fetch anything from another host fails the build."""
    if found := FETCHED.search(output):
        raise PluginError(f"{page} would fetch {found.group(1) or found.group(2)}.")
    return output
