"""The words and figures of a report as Markdown, for pull requests and notes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from occlog.report.content.metrics_in_words import groups
from occlog.report.content.model import ReportInput

from .summary import check_counts, check_rows, headline, row_counts, verdict_heading

SPECIAL = "\\`*_{}[]<>()#+-!|&~"
MOST_LOSSES = 20


def build_markdown(data: ReportInput) -> str:
    """The verdict, what was lost, and all figures; no pictures."""
    out = [f"# {plain(data.title)}", ""]
    if data.tracks is not None or data.verdicts:
        out += [f"**{plain(verdict_heading(data.verdicts))}.**", ""]
        out += [f"- **{plain(check.id)}** ({stage}): {plain(check.text)}" for stage, check in data.findings]
        out += [""] if data.findings else []
    out += table_lines(
        ("Figure", "Value", "Unit", "Note"), ((f.name, f.value, f.unit, f.note) for f in headline(data)), "lrll"
    )
    if data.losses:
        out += ["## Input that was lost", ""]
        lost = ((loss.source, loss.place, loss.what, str(loss.count or "")) for loss in data.losses[:MOST_LOSSES])
        out += table_lines(("Source", "Where", "What", "Items"), lost, "lllr")
        if len(data.losses) > MOST_LOSSES:
            out += [f"and {len(data.losses) - MOST_LOSSES} more.", ""]
    for group in groups(data.metrics, data.unit):
        out += [f"## {plain(group.title)}", ""]
        if group.figures:
            rows = ((f.name, f.value, f.unit, f.note) for f in group.figures)
            out += table_lines(("Figure", "Value", "Unit", "Meaning"), rows, "lrll")
        for table in group.breakdowns:
            cells = ((name, *values) for name, values in table.rows)
            out += table_lines((table.kind.capitalize(), *table.columns), cells, "l" + "r" * len(table.columns))
    if checks := check_rows(data.verdicts):
        out += ["## Checks", "", f"{check_counts(data.verdicts)}.", ""]
        out += table_lines(("Check", "Stage", "Result", "Sensors, targets", "Figures"), checks, "lllll")
    out += ["## Tables read", ""]
    out += table_lines(("Table", "Rows", "Time"), ((r.name, r.value, r.note) for r in row_counts(data)), "lrl")
    return "\n".join(out)


def table_lines(head: Sequence[str], rows: Iterable[Sequence[object]], sides: str) -> list[str]:
    """A table; `sides` says of each column whether it is to the left (l) or the right (r)."""
    lines = [_row(head), "|" + "|".join("---:" if side == "r" else "---" for side in sides) + "|"]
    return [*lines, *(_row(row) for row in rows), ""]


def _row(cells: Sequence[object]) -> str:
    return "| " + " | ".join(plain(cell) for cell in cells) + " |"


def plain(value: object) -> str:
    """Text in which nothing is markup, in one line."""
    plain = " ".join(str(value).split())
    return "".join(f"\\{c}" if c in SPECIAL else c for c in plain)
