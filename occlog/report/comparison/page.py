"""HTML page (self-contained), Markdown and summary of the comparison of two runs."""

from __future__ import annotations

import json
import math

from occlog.array_types import NS
from occlog.console.text import counted
from occlog.evaluate.compare.text import ComparisonRow
from occlog.records.verdicts import all_plausible
from occlog.records.verdicts import summary_of as verdict_summary
from occlog.report.content.metrics_in_words import number
from occlog.report.drawing import COLOURS, DARK, Plot, house_style, plot, script, template
from occlog.report.page import MAX_LOSSES, plain, table_lines
from occlog.report.request import RunComparisonRequest

from . import words
from .matching.divergences import RunComparisonStep
from .plots import MAX_LIVES, PersonLifeline, beside_replay, draw_errors, draw_lives
from .words import Cell, RunComparisonPage

WIDTH = 8.4
SCRIPTS = ("plan.js", "time.js", "beside.js")
MAX_LISTED_LOSSES = 100


def build_page(found: RunComparisonPage) -> str:
    """Build the HTML page.

    Args:
        found: the runs, aligned.
    """
    with house_style():
        errors, lives = _errors(found), _lives(found)
    people, more_people = words.identity_rows(found)
    changes, more_changes = words.change_rows(found)
    return template("beside.html.j2").render(
        title=found.title,
        unit=found.unit,
        start=found.time.start,
        found=found,
        heading=words.comparison_heading(found),
        sentences=words.sentences(found),
        first=None if (first := found.frame_divergences.first) is None else words.seconds(found, first[1].t_ns),
        sides=[(letter, side, *words.verdict_words(side)) for letter, side in found.sides],
        figures=words.figure_rows(found),
        basis=words.basis_sentence(found),
        own_figures=words.stored_metrics(found),
        frame_divergences=words.divergence_rows(found),
        length=number,
        errors=errors,
        lives=lives,
        people=people,
        more_people=more_people,
        changes=changes,
        more_changes=more_changes,
        passing=sum(each.passing for each in words.followed(found)),
        losses=found.losses,
        most_losses=MAX_LISTED_LOSSES,
        replay=beside_replay(found, words.consequence_of_change(found)),
        provenance=json.dumps(found.provenance, indent=2, sort_keys=True, ensure_ascii=False, default=str),
        script=script(*SCRIPTS),
        light=COLOURS,
        dark=DARK,
    )


def _errors(found: RunComparisonPage) -> Plot | None:
    """Return the figure of errors over time of both runs."""
    truth = found.against_truth
    if truth is None or not truth.over_time.both:
        return None
    over = truth.over_time
    caption = (
        f"Root mean square distance from the truth, in each of {counted(over.both, 'true frame')}, of the targets that "
        f"both have found within {number(found.near)} {found.unit}; below it B less A, below zero where B is nearer; "
        "lowest how many targets each run has not found."
    )
    size = (WIDTH, 4.6)
    return plot(
        "errors", "Errors over time", caption, size, lambda f: draw_errors(f, found.time, over, found.near, found.unit)
    )


def _lives(found: RunComparisonPage) -> Plot | None:
    """Figure of matched tracks over time: people with changing tracks, or else all, as many as fit."""
    truth = found.against_truth
    if truth is not None:
        names = words.matched_people(truth.a, truth.b)
        lives = [PersonLifeline(f"person {k}", truth.a.of(k), truth.b.of(k)) for k in names]
    else:
        lives = [PersonLifeline(f"A {k}", (), found.in_b.of(k)) for k in words.matched_people(found.in_b)]
    changing = [life for life in lives if any(len({p.track for p in part}) > 1 for part in (life.a, life.b))]
    shown = (changing or lives)[:MAX_LIVES]
    if not shown:
        return None
    who = "true person" if truth is not None else "track of A"
    caption = (
        f"Tracks matched to each {who}, by their numbers. "
        + (f"{len(changing)} of {len(lives)} have more than one track in a run. " if changing else "")
        + (f"The first {len(shown)} are drawn." if len(shown) < len(changing or lives) else "")
    )
    size = (WIDTH, 1.0 + 0.42 * len(shown))
    return plot("lives", "Matched tracks", caption.strip(), size, lambda f: draw_lives(f, found.time, shown))


def build_markdown(found: RunComparisonPage) -> str:
    """Build the Markdown: verdict, unreliable results, figures, divergences and identities, without pictures."""
    out = [f"# {plain(found.title)}", "", f"**{plain(words.comparison_heading(found))}.**", ""]
    out += [f"- {plain(f'{letter}: {side.name}')}" for letter, side in found.sides]
    out += ["", *(f"- {plain(sentence)}" for sentence in words.sentences(found)), ""]
    for letter, side in found.sides:
        reported, _ = words.verdict_words(side)
        out += [f"**{letter}: {plain(reported)}.**", ""]
        out += [f"- **{plain(check.id)}** ({stage}): {plain(check.text)}" for stage, check in side.data.findings]
        out += [""] if side.data.findings else []
    if rows := words.figure_rows(found):
        head = ("Figure", "A", "B", "B - A", "95 % interval", "p", "Verdict")
        cells = ((r.name, r.a, r.b, r.difference, r.interval, r.p, r.verdict) for r in rows)
        out += ["## Figures", "", *table_lines(head, cells, "lrrrrrl"), plain(words.basis_sentence(found)), ""]
    out += ["## Where they part", ""]
    diverged = ((r.what, _when(r.seconds), r.who, r.distance, r.often) for r in words.divergence_rows(found))
    out += table_lines(("What", "When", "Tracks", "Apart", "In all"), diverged, "lrlrr")
    people, more = words.identity_rows(found)
    if people:
        out += ["## Matched tracks", ""]
        out += table_lines(("Who", "A", "B"), ((p.who, _cells(p.a), _cells(p.b)) for p in people), "lll")
        out += [f"and {more} more.", ""] if more else []
    changes, more = words.change_rows(found)
    if changes:
        rows_of_changes = ((_when(c.seconds), c.run, c.who, c.before, c.after, c.other) for c in changes)
        out += table_lines(("When", "Run", "Who", "From", "To", "The other run"), rows_of_changes, "rlllll")
        out += [f"and {more} more.", ""] if more else []
    if found.losses:
        out += ["## Input that was lost", ""]
        lost = ((w, x.source, x.place, x.what, str(x.count or "")) for w, x in found.losses[:MAX_LOSSES])
        out += table_lines(("Run", "Source", "Where", "What", "Items"), lost, "llllr")
    return "\n".join(out)


def _cells(cells: list[Cell]) -> str:
    return ", ".join(cell.text for cell in cells)


def _when(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.2f} s"


def summary_of(found: RunComparisonPage, request: RunComparisonRequest) -> dict[str, object]:
    """Return the summary of the command: files written, whether the runs differ, divergences, identity changes."""
    first, truth = found.frame_divergences.first, found.against_truth
    out: dict[str, object] = {"page": request.output}
    out |= {} if request.markdown is None else {"markdown": request.markdown}
    out |= {letter.lower(): side.name for letter, side in found.sides}
    out |= {"heading": words.comparison_heading(found), "same": found.same, "frames": found.frame_divergences.frames}
    out |= {
        "frames_diverged": found.frame_divergences.diverged,
        "tolerance": found.tolerance,
        "length_unit": found.unit,
    }
    if first is not None:
        out["first_divergence"] = {"kind": first[0], **_step(found, first[1])}
    out["changes"] = {letter: len(each.changes) for letter, each in zip("ab", words.followed(found), strict=True)}
    if truth is not None:
        out["switches"] = dict(zip("ab", truth.switches, strict=True))
        out["true_frames"] = truth.comparison.frames  # which figures are of, as those of `compare`
        out["figures"] = {row.figure: _figure(row) for row in truth.comparison.rows}
    out |= {"notes": list(found.notes)} if found.notes else {}
    judged = {letter.lower(): side.data.verdicts for letter, side in found.sides}
    if any(judged.values()):
        out["plausible"] = all_plausible([each for verdicts in judged.values() for each in verdicts])
        out["warnings"] = [
            {"run": letter, **warning}
            for letter, verdicts in judged.items()
            for warning in verdict_summary(verdicts).get("warnings", [])  # type: ignore[attr-defined]
        ]
    return out


def _figure(row: ComparisonRow) -> dict[str, object]:
    """Return the values of a figure in both runs, its difference with interval and p, and the verdict."""
    d = row.found
    values = {"a": d.a, "b": d.b, "difference": d.difference, "low": d.low, "high": d.high, "p": row.holm}
    return {name: value for name, value in values.items() if math.isfinite(value)} | {"verdict": row.verdict}


def _step(found: RunComparisonPage, step: RunComparisonStep) -> dict[str, object]:
    """Return time, tracks and distance of a divergence by name, as far as known."""
    values: dict[str, object] = {"seconds": (step.t_ns - found.time.start_ns) / NS, "t_ns": step.t_ns}
    values |= {name: label for name, label in (("a", step.a), ("b", step.b)) if label is not None}
    return values | ({"distance": step.distance} if math.isfinite(step.distance) else {})
