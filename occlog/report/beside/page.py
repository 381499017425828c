"""The page of two runs as HTML: self-contained, with a script of its own and no other."""

from __future__ import annotations

import json

from occlog.console.text import counted
from occlog.report.content.metrics_in_words import number
from occlog.report.drawing.html import script, template
from occlog.report.drawing.plot import Plot, plot
from occlog.report.drawing.style import COLOURS, DARK, house_style

from . import words
from .comparison.identities import Followed
from .model import Beside
from .plots import MOST_LIVES, Life, draw_errors, draw_lives
from .replay import beside_replay

WIDTH = 8.4
SCRIPTS = ("plan.js", "time.js", "beside.js")
MOST_LOSSES = 100


def build_page(found: Beside) -> str:
    """The page of two runs.

    Args:
        found: the runs, laid beside each other.
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
        heading=words.heading(found),
        sentences=words.sentences(found),
        first=None if (first := found.partings.first) is None else words.seconds(found, first[1].t_ns),
        sides=[(letter, side, *words.believed(side)) for letter, side in found.sides],
        figures=words.figure_rows(found),
        basis=words.basis(found),
        own_figures=words.own_figures(found),
        partings=words.parting_rows(found),
        length=number,
        errors=errors,
        lives=lives,
        people=people,
        more_people=more_people,
        changes=changes,
        more_changes=more_changes,
        passing=sum(each.passing for each in words.followed(found)),
        losses=found.losses,
        most_losses=MOST_LOSSES,
        replay=beside_replay(found, words.led_to(found)),
        provenance=json.dumps(found.provenance, indent=2, sort_keys=True, ensure_ascii=False, default=str),
        script=script(*SCRIPTS),
        light=COLOURS,
        dark=DARK,
    )


def _errors(found: Beside) -> Plot | None:
    """Errors over time."""
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


def _lives(found: Beside) -> Plot | None:
    """Who follows whom over time: those of whom tracks change, or else all, as many as fit."""
    truth = found.against_truth
    if truth is not None:
        names = _whose(truth.a, truth.b)
        lives = [Life(f"person {k}", truth.a.of(k), truth.b.of(k)) for k in names]
    else:
        lives = [Life(f"A {k}", (), found.in_b.of(k)) for k in _whose(found.in_b)]
    changing = [life for life in lives if any(len({p.track for p in part}) > 1 for part in (life.a, life.b))]
    shown = (changing or lives)[:MOST_LIVES]
    if not shown:
        return None
    who = "true person" if truth is not None else "track of A"
    caption = (
        f"The tracks that follow each {who}, by their numbers. "
        + (f"{len(changing)} of {len(lives)} have more than one track in a run. " if changing else "")
        + (f"The first {len(shown)} are drawn." if len(shown) < len(changing or lives) else "")
    )
    size = (WIDTH, 1.0 + 0.42 * len(shown))
    return plot("lives", "Who follows whom", caption.strip(), size, lambda f: draw_lives(f, found.time, shown))


def _whose(*followed: Followed) -> list[int]:
    return sorted({piece.who for each in followed for piece in each.pieces})
