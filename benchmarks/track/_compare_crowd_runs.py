"""Tracks of the crowd of WILDTRACK, many times over: with other errors of the boxes, by `jipda` and by a worse one.

Each is made once and kept in a folder.  Seeds are of `degrade_boxes.py`; hidden people are left out and feet are cut
before boxes are missed and made up at random, so that the slow part is done once for each setting.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.track._crowd_baseline import followed, fused
from benchmarks.track._crowd_cases import AREA, DEGREES, Case, columns
from benchmarks.track._single_people import STEP_NS, annotations, scene_of
from occlog.array_types import Floats
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_points
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.interface import NO_ID, FrameDetections
from occlog.track.people.stage import JIPDA

FRAMES, STRETCH = 200, 40
"""Frames of the crowd, and of one of five stretches of 20 s."""
CAMERAS = 7
SURE = 0.9
"""Confidence of boxes."""
GIVES_UP = 0.3
"""`jipda` gives people up below this probability that they exist (default 0.01): some 2 points of IDF1 worse."""
MOVED_PX = 0.5
"""Standard deviation by which edges of the same boxes are moved, for runs that differ by next to nothing."""


def jipda(case: Case, **settings: float) -> Floats:
    """(N, 4) frame, identity, x, y of method `jipda`."""
    scene = scene_of(_folder())
    state, rows = JIPDA.begin(scene, scene.cameras, JipdaConfig(**settings)), [np.zeros((0, 4))]  # type: ignore[arg-type]
    for frame in range(case.frames):
        now = case.boxes[case.boxes[:, 0] == frame]
        looks = []
        for camera in range(len(scene.cameras)):
            boxes = now[now[:, 1] == camera, 2:6]
            n = len(boxes)
            hint, score = np.full(n, NO_ID), np.full(n, SURE)
            looks.append(FrameDetections(frame * STEP_NS, camera, boxes, score, hint, np.zeros((n, 0)), np.arange(n)))
        state, reported = JIPDA.step(state, looks)
        rows.append(np.column_stack([np.full(len(reported.ids), frame), reported.ids, reported.mean[:, :2]]))
    return np.concatenate(rows)


TRACKERS: dict[str, Callable[[Case], Floats]] = {
    "jipda": jipda,
    "early": lambda case: jipda(case, die=GIVES_UP),
    "base": lambda case: followed(fused(case), case)[:, :4],
}
"""`jipda`, the same that gives people up early, and the baseline."""


def tracks(tracker: str, level: str, seed: int, folder: Path, moved: int = 0) -> Floats:
    """(N, 4) frame, identity, x, y; made if they are not there yet.

    Args:
        tracker: of `TRACKERS`.
        level: of `DEGREES`.
        seed: of the errors of boxes.
        folder: keeps them.
        moved: 1 or 2: edges of the boxes of this seed are moved by a little, each time anew; 0: they are not.
    """
    path = folder / f"{tracker}_{level}_{seed}{f'_j{moved}' if moved else ''}.npz"
    if not path.exists():
        case = degraded(level, seed, folder)
        if moved:
            boxes = case.boxes.copy()
            boxes[:, 2:] += np.random.default_rng([1000 * seed + moved, 77]).normal(0, MOVED_PX, boxes[:, 2:].shape)
            case = case._replace(boxes=boxes)
        draft = path.with_suffix(".draft.npz")
        np.savez_compressed(draft, TRACKERS[tracker](case))
        draft.rename(path)
    return np.asarray(np.load(path)["arr_0"])


def degraded(level: str, seed: int, folder: Path) -> Case:
    """The crowd with boxes as a detector could have reported them."""
    data, given = _folder(), list(DEGREES[level])
    tool = data.parents[1] / "tools" / "crowd" / "degrade_boxes.py"
    hidden = [word for k, word in enumerate(given) if word in ("--hide", "--cut") or given[k - 1] == "--hide"]
    boxes = data / "boxes_true.csv"
    if hidden:
        still = folder / f"still_{level}.csv"
        if not still.exists():
            _run(tool, boxes, "-o", still, *hidden)
        boxes = still
    noise = [word for k, word in enumerate(given) if word not in ("--hide", "--cut") and given[k - 1] != "--hide"]
    made = folder / f"boxes_{level}_{seed}.csv"
    _run(tool, boxes, "-o", made, *noise, "--seed", seed)
    found = columns(made, "frame", "camera", "left", "top", "right", "bottom")
    made.unlink()
    found[:, 1] -= 1
    matrices = np.array([np.loadtxt(data / "calibration" / f"cam{n + 1}_P.txt") for n in range(CAMERAS)])
    return Case(f"wildtrack-{level}", 2.0, (1920, 1080), matrices, found, _truth(), AREA, FRAMES)


def frames_of(rows: Floats, segment: int | None) -> MatchedFrames:
    """Truth and tracks of a stretch of 20 s, or of all 100 s."""
    first, end = (0, FRAMES) if segment is None else (segment * STRETCH, (segment + 1) * STRETCH)
    return of_points(_objects(_truth(), first, end), _objects(rows, first, end), 1.0)


def _objects(rows: Floats, first: int, end: int) -> Objects:
    own = rows[(rows[:, 0] >= first) & (rows[:, 0] < end)]
    return Objects(own[:, 0].astype(np.int64) - first, own[:, 1].astype(np.int64), own[:, 2:4])


@cache
def _truth() -> Floats:
    return columns(_folder() / "truth.csv", "frame", "id", "x", "y")


def _folder() -> Path:
    folder = annotations()
    if folder is None:
        raise SystemExit("wildtrack_annotations is not there; OCCLOG_SHARED_DATA names the folder that holds it")
    return folder


def _run(tool: Path, *arguments: str | Path | int) -> None:
    subprocess.run([sys.executable, tool, *map(str, arguments)], check=True, capture_output=True)
