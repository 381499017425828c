"""Where a paper makes a statement, and in which words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from .model import Verdict


class Source(NamedTuple):
    """A place in a paper."""

    place: str  # figure, table, equation or section
    words: str = ""  # of the paper; empty: its text does not make the statement, or only prints a number
    page: int | None = None  # of the figure, or where the section begins; only the text of [Lee] has page numbers


OWN = Source("of this project")
"""A statement that no paper makes."""
Sources = Mapping[str, Source]
"""Sources by the beginning of a verdict's id, up to a hyphen; the longest that fits counts."""


def source_of(key: str, sources: Sources) -> Source | None:
    """Return the source of the verdict with this id; None where no beginning of the id is known."""
    parts = key.split("-")
    for n in range(len(parts), 0, -1):
        found = sources.get("-".join(parts[:n]))
        if found is not None:
            return found
    return None


def attributed(verdicts: Sequence[Verdict], sources: Sources) -> list[Verdict]:
    """Return the verdicts with place, page and words of the paper; those that have a place keep it."""
    out = []
    for verdict in verdicts:
        source = None if verdict.place else source_of(verdict.id, sources)
        out.append(verdict if source is None else replace(verdict, **source._asdict()))
    return out
