"""What the site needs beyond its plugins: the notebooks, and nothing from elsewhere."""

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


@event_priority(100)  # before the plugin that turns notebooks into pages
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The notebooks stand beside `docs`, and appear in the site under `notebooks/`."""
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        name = path.relative_to(ROOT).as_posix()
        files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_content(html: str, **_: object) -> str:
    """No notebook has formulas to set, so none loads what would set them."""
    return MATHJAX.sub("", html)


def on_post_page(output: str, page: object, **_: object) -> str:
    """A page that would fetch anything from another host fails the build."""
    if found := FETCHED.search(output):
        raise PluginError(f"{page} would fetch {found.group(1) or found.group(2)}.")
    return output
