"""The site of these pages, by Sphinx: `make docs` writes `build/site/index.html`, with search.

Its front is the README; pages stand in the order of `docs/index.md`, whose headings and links are the navigation.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from sphinx.application import Sphinx

project = html_title = "occlog"
extensions = ["myst_parser"]
root_doc = "README"
include_patterns = ["*.md", "docs/*.md", "docs/**/*.md"]
myst_heading_anchors = 4
html_theme = "furo"
html_copy_source = html_show_copyright = False


def navigation(index: str) -> Iterator[str]:
    """A toctree for each heading of the index, of the pages that it names."""
    for section in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        heading, _, text = section.partition("\n")
        links = re.findall(r"\]\(([\w./-]+)\.md\)", text)
        pages = [f"/{link[3:]}" if link.startswith("../") else f"/docs/{link}" for link in links]
        yield "\n".join(["```{toctree}", ":hidden:", f":caption: {heading}", "", *dict.fromkeys(pages), "```", ""])


def add_navigation(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the navigation below the text of the README."""
    if name == app.config.root_doc:
        index = Path(app.srcdir, "docs", "index.md").read_text(encoding="utf-8")
        all_pages = "```{toctree}\n:hidden:\n\nAll pages </docs/index>\n```\n"
        source[0] = "\n".join([source[0], all_pages, *navigation(index)])


def enter_by_index(app: Sphinx, error: Exception | None) -> None:
    """Give the front page the name that web servers look for."""
    if error is None and app.builder.format == "html":
        shutil.copy(Path(app.outdir, f"{app.config.root_doc}.html"), Path(app.outdir, "index.html"))


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", add_navigation)
    app.connect("build-finished", enter_by_index)
