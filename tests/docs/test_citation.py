"""How to cite occlog agrees with its version, its licence and the papers that it implements."""

from __future__ import annotations

import re
import tomllib

import yaml
from places import ROOT

from occlog import __version__
from occlog.papers.catalogue import TITLES

CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


def words(text: str) -> str:
    """A title without the case and the punctuation of its source."""
    return " ".join(re.findall(r"\w+", text.lower()))


def test_citation_is_of_this_version_and_licence() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["version"] == __version__
    assert CITATION["license"] == project["license"]
    assert [author["name"] for author in CITATION["authors"]] == [author["name"] for author in project["authors"]]


def test_every_paper_of_the_catalogue_is_cited() -> None:
    """The catalogue writes authors, year and title as one text."""
    for text in TITLES.values():
        (cited,) = [r for r in CITATION["references"] if r["authors"][0]["family-names"] == text.split()[0].strip(",")]
        assert str(cited["year"]) in text
        title = words(text.split(str(cited["year"]))[1])
        assert words(cited["title"]).startswith(title)


def test_changelog_has_a_section_for_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## \[(.+?)\]", text, re.MULTILINE)
    assert sections[0] == "Unreleased"
    assert __version__ in sections
