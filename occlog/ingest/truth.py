"""Agreement of true positions, true boxes and calibration: projected feet against boxes.

Also restricts true positions to the frames of the recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.errors import InputError, option
from occlog.io.files.timing.frame_times import FrameTimes
from occlog.io.formats.boxes.reader import BoxSurvey
from occlog.io.formats.truth import frames_of_positions
from occlog.records.scene import Scene
from occlog.records.tables import Truth, TruthBoxes

from .plan import IngestPlan

MAX_OFF = 0.5
"""Feet may be this many heights of the box from the middle of its lower edge, in the median of a camera."""
MIN_BOXES = 20
"""Boxes of a camera from which a median is accepted."""


def check_truth_consistency(
    tables: Iterator[Truth | TruthBoxes], scene: Scene, path: Path, note: Callable[[str], None]
) -> Iterator[Truth | TruthBoxes]:
    """Generate the tables unchanged; at the end, compare projected true positions (feet) with the lower edges of boxes.

    The median distance in each camera, in heights of the box, is noted.

    Args:
        tables: true positions first, then true boxes.
        scene: scene with the cameras.
        path: file of the truth, for messages.
        note: called with remarks for the user.

    Raises:
        InputError: the median in a camera is above `MAX_OFF`: the grid of positions, the unit or the camera is another.
    """
    truths: list[Truth] = []
    off: dict[str, list[Floats]] = {}
    for table in tables:
        if isinstance(table, Truth):
            truths.append(table)
        elif truths:
            whole = Truth.merge(truths)
            for camera in (c for c in scene.cameras if c.placed):
                mine = table.take((table.sensor == camera.name) & (table.box >= 0) & (table.target_id >= 0))
                off.setdefault(camera.name, []).append(_off(whole, mine, camera.project))
        yield table
    medians = {}
    for name, parts in off.items():
        values = np.concatenate(parts)
        if len(values) < MIN_BOXES:
            continue
        medians[name] = float(np.median(values))
        if not medians[name] <= MAX_OFF:
            raise InputError(
                f"{path}: camera {name}: true positions are {medians[name]:.2g} box heights off the feet of true boxes "
                f"(median of {len(values)}; limit {MAX_OFF:g}); check the camera's name, and unit and grid of "
                "positions",
                id="incompatible-inputs",
            )
    if medians:
        text = ", ".join(f"{name} {value:.2g}" for name, value in medians.items())
        note(f"true positions, projected, are off the feet of true boxes by (median, in heights of the box): {text}")


def _off(truth: Truth, boxes: TruthBoxes, project: Callable[[Floats], Floats]) -> Floats:
    """(n,) distances of projected feet from the middle of the lower box edge, in heights of the box.

    The n boxes are those with a true position of the same target at the same time. Infinite where the feet are behind
    the camera.

    Args:
        truth: true positions in the world.
        boxes: true boxes of one camera.
        project: converts world positions (n, 3) to pixels (n, 2) of the camera.
    """
    where = {key: row for row, key in enumerate(zip(truth.t_ns.tolist(), truth.target_id.tolist(), strict=True))}
    keys = zip(boxes.t_ns.tolist(), boxes.target_id.tolist(), strict=True)
    pairs = [(row, where[key]) for row, key in enumerate(keys) if key in where]
    if not pairs:
        return np.zeros(0)
    box, index = np.array(pairs, dtype=np.int64).T
    feet = project(np.column_stack([truth.x[index], truth.y[index], np.zeros(len(index))]))
    middle = boxes.left_px[box] + 0.5 * boxes.width_px[box]
    lower = boxes.top_px[box] + boxes.height_px[box]
    away = np.hypot(feet[:, 0] - middle, feet[:, 1] - lower) / boxes.height_px[box]
    return np.where(np.isfinite(away), away, np.inf)


MAX_EXTENTS = 100.0
"""A truth that lasts this many times as long as the boxes may have times in another unit."""
MIN_REPORTED_S = 1.0
"""True positions that begin so long before the first frame, or end so long after the last one, are reported."""


def note_first_frames(plan: IngestPlan, survey: BoxSurvey | None, note: Callable[[str], None]) -> None:
    """Note if boxes count frames from 1 and true positions from 0, or vice versa, and the plan states neither number.

    Args:
        plan: has the files of the truth.
        survey: of the box files; None: there are none, and nothing is noted.
        note: called with the text.
    """
    if survey is None or plan.first_number is not None or plan.truth_first_number is not None:
        return
    for _, path in plan.truth:
        span = frames_of_positions(path) if path.is_file() else None
        if span is not None and {survey.first, span[0]} == {0, 1}:
            first, true = survey.first, span[0]
            note(
                f"boxes begin at frame {first}, true positions ({path.name}) at frame {true}; where both mean the "
                f"first frame, state it: {option('first_number')} {first}, {option('truth_first_number')} {true}"
            )


def span_of(frames: Mapping[str, range], times: Mapping[str, FrameTimes]) -> tuple[int, int] | None:
    """First and last time [ns] of the given frames over all cameras, extended by half a frame interval at both ends.

    None if no camera has frames.

    Args:
        frames: frame numbers, by camera.
        times: frame times, by camera.
    """
    ends: list[tuple[int, int]] = []
    for name, own in frames.items():
        each = times[name]
        own = own if each.count is None else own[: len(range(own.start, each.count, own.step))]
        if not own:
            continue
        first, last = each.at(np.array([own[0], own[-1]], dtype=np.int64)).tolist()
        step = each.interval_ns()
        half = int(step / 2) if math.isfinite(step) else 0
        ends.append((first - half, last + half))
    return (min(a for a, _ in ends), max(b for _, b in ends)) if ends else None


def _note_unlisted(listed: Mapping[str, Sequence[Ints]], note: Callable[[str], None]) -> None:
    """Note how many frames between the first and the last one are not in true boxes, in the usual step of the numbers.

    Args:
        listed: frame numbers in parts, by camera.
        note: called with the text for each camera with such frames.
    """
    for name, parts in listed.items():
        steps = np.diff(np.unique(np.concatenate(parts)))
        if len(steps) and (missing := int(np.sum(steps // steps.min() - 1))):
            frames = missing + len(steps) + 1
            note(
                f"true boxes of camera {name}: {missing} of {frames} frames are not in the file, and count as not "
                "annotated; where no target is in the image, list the frame without a box"
            )


def within_frames(
    tables: Iterator[Truth | TruthBoxes],
    plan: IngestPlan,
    survey: BoxSurvey | None,
    times: Mapping[str, FrameTimes],
    note: Callable[[str], None],
) -> Iterator[Truth | TruthBoxes]:
    """Generate the tables of the truth, true positions restricted to the times of the frames that the plan selects.

    A note states how many were skipped. Without a selection all are kept, and a note states by how much they begin
    before or end after the frames of a detector. Another note states how many frames between the first and the last
    have no rows of true boxes: these count as not annotated.

    Args:
        tables: of the truth; true boxes are unchanged.
        plan: has the selection.
        survey: of the box files; None: there are none.
        times: frame times by camera.
        note: called with remarks for the user.
    """
    chosen = {name: range(*own) for name in times if (own := plan.frames.of(name)) is not None}
    frames = chosen if chosen and len(chosen) == len(times) else None
    if frames is None and survey is not None and not (plan.video or plan.images):
        frames = survey.frames(times)
    span = None if frames is None else span_of(frames, times)
    rows = out = 0
    early = late = 0.0
    listed: dict[str, list[Ints]] = {}
    for table in tables:
        if isinstance(table, TruthBoxes):
            for name in np.unique(table.sensor).tolist():
                listed.setdefault(name, []).append(np.unique(table.frame[table.sensor == name]))
        if span is None or not isinstance(table, Truth) or not len(table):
            yield table
            continue
        inside = (table.t_ns >= span[0]) & (table.t_ns <= span[1])
        rows, out = rows + len(table), out + int((~inside).sum())
        early = max(early, (span[0] - int(table.t_ns.min())) / NS)
        late = max(late, (int(table.t_ns.max()) - span[1]) / NS)
        if not plan.frames:
            yield table
        elif inside.any():
            yield table.take(inside)
    _note_unlisted(listed, note)
    if out and plan.frames:
        note_skipped(out, rows, plan, note)
    elif max(early, late) > MIN_REPORTED_S:
        ends = [f"begin {early:.3g} s before the first"] if early > MIN_REPORTED_S else []
        ends += [f"go on {late:.3g} s after the last"] if late > MIN_REPORTED_S else []
        cause = ""
        if span is not None and late > MAX_EXTENTS * max(span[1] - span[0], NS) / NS:
            cause = "; if its times are in ms, name their column t_ms"
        note(
            f"truth: true positions {' and '.join(ends)} frame with boxes; people at these times count as missed: "
            f"limit both by {option('frames')}, or cut the truth{cause}"
        )


def note_skipped(out: int, rows: int, plan: IngestPlan, note: Callable[[str], None]) -> None:
    """Note that `out` of `rows` true positions are outside the selected frames."""
    note(f"truth: {out} of {rows} true positions are of other frames than {plan.frames}, and skipped")
