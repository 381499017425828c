"""The words and tables of two runs as Markdown, for pull requests."""

from __future__ import annotations

from occlog.report.markdown import MOST_LOSSES, plain, table_lines

from . import words
from .model import Beside
from .words import Cell


def build_markdown(found: Beside) -> str:
    """The verdict, what is not to be believed, figures, partings and identities; no pictures."""
    out = [f"# {plain(found.title)}", "", f"**{plain(words.heading(found))}.**", ""]
    out += [f"- {plain(f'{letter}: {side.name}')}" for letter, side in found.sides]
    out += ["", *(f"- {plain(sentence)}" for sentence in words.sentences(found)), ""]
    for letter, side in found.sides:
        said, _ = words.believed(side)
        out += [f"**{letter}: {plain(said)}.**", ""]
        out += [f"- **{plain(check.id)}** ({stage}): {plain(check.text)}" for stage, check in side.data.findings]
        out += [""] if side.data.findings else []
    if rows := words.figure_rows(found):
        head = ("Figure", "A", "B", "B - A", "95 % interval", "p", "Verdict")
        cells = ((r.name, r.a, r.b, r.difference, r.interval, r.p, r.verdict) for r in rows)
        out += ["## Figures", "", *table_lines(head, cells, "lrrrrrl"), plain(words.basis(found)), ""]
    out += ["## Where they part", ""]
    parted = ((r.what, _when(r.seconds), r.who, r.distance, r.often) for r in words.parting_rows(found))
    out += table_lines(("What", "When", "Tracks", "Apart", "In all"), parted, "lrlrr")
    people, more = words.identity_rows(found)
    if people:
        out += ["## Who follows whom", ""]
        out += table_lines(("Who", "A", "B"), ((p.who, _cells(p.a), _cells(p.b)) for p in people), "lll")
        out += [f"and {more} more.", ""] if more else []
    changes, more = words.change_rows(found)
    if changes:
        rows_of_changes = ((_when(c.seconds), c.run, c.who, c.before, c.after, c.other) for c in changes)
        out += table_lines(("When", "Run", "Who", "From", "To", "The other run"), rows_of_changes, "rlllll")
        out += [f"and {more} more.", ""] if more else []
    if found.losses:
        out += ["## Input that was lost", ""]
        lost = ((w, x.source, x.place, x.what, str(x.count or "")) for w, x in found.losses[:MOST_LOSSES])
        out += table_lines(("Run", "Source", "Where", "What", "Items"), lost, "llllr")
    return "\n".join(out)


def _cells(cells: list[Cell]) -> str:
    return ", ".join(cell.text for cell in cells)


def _when(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.2f} s"
