"""What the script of a page of two runs is given: both plans in the same moments, and who is whom.

The rule: of the common frames every k-th is kept, with the smallest k by which not more than `MOST_MOMENTS` of them,
`MOST_SHOWN` estimates of both runs together and as many true places are left; beside them those that the page leads to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.records.tables import Tracks, Truth
from occlog.report.content.model import ReportInput
from occlog.report.content.thinned import MOST_MOMENTS, MOST_SHOWN
from occlog.report.plots.floorplan import plan_limits
from occlog.report.replay.build import MOST_BOXES, MOST_EVENTS, Layer, plan_values, safe_json
from occlog.report.replay.moments import Moments
from occlog.report.replay.pack import NONE, packed

from .model import Beside, Side
from .words import followed

COLOURS = 6
"""Of targets; they repeat."""


@dataclass(frozen=True, eq=False)
class CommonMoments(Moments):
    """Moments of a run that are those of the other run, too.

    Attributes:
        common: (M,) their times.
    """

    common: Ints

    @cached_property
    def kept(self) -> Ints:
        """(M,) the times that are kept."""
        return self.common

    @cached_property
    def same(self) -> bool:
        """Tracks are known by their own numbers, whatever those of the truth are."""
        return False


@dataclass(frozen=True)
class BesideReplay:
    """The moments of two runs for the page.

    Attributes:
        json: what the script is given, safe inside a `<script>` element.
        words: what is shown and what was left out, in sentences.
        people: what can be switched off: name, number, colour (-1: none).
        layers: what can be shown.
    """

    json: str
    words: str
    people: list[tuple[str, int, int]]
    layers: list[Layer]


def beside_replay(found: Beside, led_to: list[int]) -> BesideReplay | None:
    """The moments of two runs; None where there are fewer than two.

    Args:
        found: the runs.
        led_to: times [ns] that the page leads to.
    """
    times = found.times
    truth = found.a.data.truth
    rows = len(found.a.laid.frame) + len(found.b.laid.frame)
    true = 0 if truth is None else len(truth)
    every = max(1, -(-len(times) // MOST_MOMENTS), -(-rows // MOST_SHOWN), -(-true // MOST_SHOWN))
    kept = np.union1d(times[::every], times[np.isin(times, led_to)])
    if len(kept) < 2:
        return None
    drawn = [_drawn(side, times, truth if letter == "A" else None) for letter, side in found.sides]
    limits = _both(plan_limits(drawn[0]), plan_limits(drawn[1]))
    moments = [CommonMoments(data, limits, kept) for data in drawn]
    parts = [plan_values(each.data, each)[::2] for each in moments]
    colours = _colours(found)
    for (values, _), (letter, _), data in zip(parts, found.sides, drawn, strict=True):
        numbers = {label: k for k, person in enumerate(found.pairs.people) for label in getattr(person, letter.lower())}
        values["person"] = [numbers[label] for label in data.targets]
        values["colours"] = [colours[numbers[label]] for label in data.targets]
    start = found.time.start_ns
    frames = np.searchsorted(times, kept)
    values = {
        "second": found.time.ns_per_unit / NS,
        "times": packed("f8", (kept - start) / NS),
        "a": parts[0][0],
        "b": parts[1][0],
        "partner": _partners(found, moments[0]),
        "apart": packed("f8", _most(found.partings.apart, frames).round(6)),
        "alone": packed("u4", _most(found.partings.alone, frames).astype(np.int64)),
        "changes": _changes(found, start),
    }
    layers = list(dict.fromkeys([*parts[0][1], *parts[1][1]]))
    people = [(name_of(person), k, colours[k]) for k, person in enumerate(found.pairs.people[:MOST_BOXES])]
    return BesideReplay(safe_json(values), _words(found, kept, every, moments[0].step), people, layers)


def name_of(person: Any) -> str:
    """Tracks of a person: `A 3, 7 · B 5`."""
    sides = (("A", person.a), ("B", person.b))
    return " · ".join(f"{letter} {', '.join(map(str, labels))}" for letter, labels in sides if labels)


def _drawn(side: Side, times: Ints, truth: Truth | None) -> ReportInput:
    """What is drawn of a run: its estimates in the common frames, and what it was told of occluders."""
    table: Tracks = side.laid.table(side.tracks, times)
    return replace(
        side.data, tracks=table, truth=truth, bearings=None, errors=None, bound=None, events=None, gathered=None
    )


def _both(a: Floats, b: Floats) -> Floats:
    """(2, 2) corners of what holds both plans."""
    return np.array([np.minimum(a[0], b[0]), np.maximum(a[1], b[1])])


def _colours(found: Beside) -> list[int]:
    """Number of each person's colour; -1: one run alone has them."""
    out, k = [], 0
    for person in found.pairs.people:
        both = bool(person.a and person.b)
        out.append(k % COLOURS if both else -1)
        k += both
    return out


def _partners(found: Beside, moments: Moments) -> Any:
    """Of each of A's estimates at the kept moments the number of its partner among B's targets; NONE: it has none."""
    partner = np.full(len(found.a.laid.frame), NONE, dtype=np.int64)
    targets = np.unique(found.b.laid.label)
    partner[found.pairs.a] = np.searchsorted(targets, found.b.laid.label[found.pairs.b])
    rows, _ = moments.at(found.times[found.a.laid.frame])
    return packed("u2", partner[rows])


def _most(values: np.ndarray, frames: Ints) -> np.ndarray:
    """(M,) the largest value since the frame that was kept before."""
    return np.asarray(np.maximum.reduceat(values, np.concatenate([[0], frames[:-1] + 1])))


def _changes(found: Beside, start: int) -> list[float]:
    """Times [s] at which somebody is another one in one of the runs; evenly taken where there are many."""
    changes = [change for each in followed(found) for change in each.changes]
    times = np.unique(np.array([change.t_ns for change in changes], dtype=np.int64))
    some = times[np.unique(np.linspace(0, len(times) - 1, min(len(times), MOST_EVENTS)).round().astype(int))]
    return [round(float(t - start) / NS, 6) for t in some]


def _words(found: Beside, kept: Ints, every: int, step: float) -> str:
    count = f"{len(kept):,}"
    out = [f"{count} of {len(found.times):,} moments: every {every}-th." if every > 1 else f"{count} moments."]
    out.append("The same colour is the same person, as far as the runs agree; grey: one run alone has them.")
    out.append("A dashed ring is a target that no sensor sees, or of which something is doubtful.")
    out += ["A cross is where one truly is."] if found.a.data.truth is not None else []
    out.append(
        "The strip shows the largest distance of partners; orange below it: one run alone has somebody; "
        "red: somebody is followed by another track."
    )
    out.append(f"Positions are rounded to {step:.1g} {found.unit}.")
    return " ".join(out)
