"""Alignment of two runs: tables to page content."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from occlog.array_types import Ints
from occlog.core.metrics.mot.clear_mot import match
from occlog.core.metrics.mot.frame_pairs import of_points
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.figures import RULES
from occlog.evaluate.mot.on_ground import points_in_true_frames, times_of
from occlog.records.scene import Scene
from occlog.records.tables import Tracks, Truth
from occlog.report.content.model import TimeAxis

from .matching.divergences import ErrorsOverTime, Paired, over_time
from .matching.pairs import EACH_FRAME, MatchedRuns, tracks_by_target

MOVED = 1e-6
"""Sensors that are farther than this share of a unit of length from their former positions count as moved."""


def matched_by_truth(
    a: Tracks, b: Tracks, truth: Truth, near: float, unit: str, lasting_ns: int
) -> tuple[MatchedRuns, MatchedRuns, tuple[int, int], ErrorsOverTime]:
    """Compare both runs with the truth in all true frames.

    Args:
        a: tracks of run A.
        b: tracks of run B.
        truth: with targets.
        near: match threshold.
        unit: unit of lengths.
        lasting_ns: shorter pieces of tracks on a target are skipped [ns].

    Returns:
        The tracks of each run matched to each true target over time, identity switches of each run as CLEAR-MOT counts
        them, and errors over time.
    """
    config, limit = MultiTargetConfig(match_distance=near), EvaluateConfig().limit_ns
    times: Ints = times_of(a, truth)
    pairs: list[Paired] = []
    switches = []
    for tracks in (a, b):
        points = points_in_true_frames(tracks, truth, times, config, limit, unit)
        frames = of_points(points.truth, points.tracks, near)
        pairs.append((frames, match(frames, EACH_FRAME)))
        switches.append(int(match(frames, RULES[config.clear_rule]).switch.sum()))
    of_a, of_b = (tracks_by_target(*each, times, lasting_ns) for each in pairs)
    return of_a, of_b, (switches[0], switches[1]), over_time(pairs[0], pairs[1], times)


def notes_on_time(a: Tracks, b: Tracks, *, truth: bool) -> Iterator[str]:
    """Generate notes on times that only one of both runs covers; `truth`: whether there are figures against a truth."""
    spans = [(int(t.t_ns[0]), int(t.t_ns[-1])) for t in (a, b)]
    step = max(int(np.median(np.diff(np.unique(t.t_ns)))) if len(t) > 1 else 0 for t in (a, b))
    start, end = max(s for s, _ in spans), min(e for _, e in spans)
    parts = []
    for letter, (own_start, own_end) in zip(("A", "B"), spans, strict=True):
        if start - own_start > step:
            parts.append(f"{letter} begins {TimeAxis(own_start, start).duration} earlier")
        if own_end - end > step:
            parts.append(f"{letter} goes on for {TimeAxis(end, own_end).duration} longer")
    if parts:
        statement = f"{' and '.join(parts)}: the runs are aligned in their common time"
        more = "; figures are of all true frames, in which a run that is not there misses its people" if truth else ""
        yield statement + more


def notes_on_truth(found: ErrorsOverTime, near: float, unit: str) -> Iterator[str]:
    """Generate notes on runs with tracks that are never within the match threshold `near` [unit] of a true target."""
    for letter, unmatched in zip(("A", "B"), found.on_unmatched, strict=True):
        if unmatched:
            yield (
                f"no track of {letter} is ever within {near:g} {unit} of a true target: is {letter} of the recording "
                "that the truth is of?"
            )


def recordings_of(made: Mapping[str, object]) -> dict[str, str]:
    """Return the names, by SHA-256, of the recordings that a run was made from; empty if not stated.

    `made`: provenance of each of its tables, as JSON-ready values.
    """
    each = [inputs for one in made.values() if isinstance(one, Mapping) for inputs in one.get("inputs", ())]
    return {one["sha256"]: one["name"] for one in each if one["name"].endswith(".mcap")}


def notes_on_recordings(a: Mapping[str, str], b: Mapping[str, str]) -> Iterator[str]:
    """Generate a note if the runs were made from different recordings, so that differences may not be due to methods.

    Args:
        a: names of the recordings of A by SHA-256.
        b: names of the recordings of B by SHA-256.
    """
    if a and b and not set(a) & set(b):
        texts = (", ".join(f"{name} ({sha[:8]})" for sha, name in sorted(each.items())) for each in (a, b))
        yield "A was made of {}, B of another recording, {}: differences may be those of the recordings".format(*texts)


def notes_on_scenes(a: Scene | None, b: Scene | None) -> Iterator[str]:
    """Generate notes on sensors in one scene only, and on sensors with different positions; None: scene unknown."""
    if a is None or b is None:
        return
    own, other = ({s.name: s for s in scene.sensors} for scene in (a, b))
    for letter, one, two in (("A", own, other), ("B", other, own)):
        if names := [name for name in one if name not in two]:
            yield f"{letter} alone has the sensors {', '.join(names)}"
    moved = [
        name
        for name in own
        if name in other and not np.allclose(own[name].position, other[name].position, atol=MOVED, equal_nan=True)
    ]
    if moved:
        yield f"sensors have other positions in B: {', '.join(moved)}"


def same_room(a: Scene | None, b: Scene | None) -> bool:
    """Return whether two scenes can be of one site: by equal rooms, else by a common sensor; True if one is unknown."""
    if a is None or b is None:
        return True
    if a.room is not None and b.room is not None:
        return a.room.shape == b.room.shape and bool(np.allclose(a.room, b.room, atol=MOVED))
    names = [{s.name for s in scene.sensors} for scene in (a, b)]
    return not all(names) or bool(names[0] & names[1])
