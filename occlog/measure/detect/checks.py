"""Checks of detections: cameras without detections, boxes outside the image, static detections."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np
from msgspec import structs

from occlog.array_types import Floats
from occlog.consistency.verdict import exceeds_share
from occlog.ingest.rig import UPRIGHT, tilted_world
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Views
from occlog.records.verdicts import Check, finding, outcome

DETECTOR, DETECTS = "detector", "detections per camera"
TARGETS = "detections per target"
POSES = "camera poses"
INSIDE, STAYS = "detections inside the images", "static detections"
"""Names of checks."""
FEWEST = 50
"""Minimum number of frames of a camera for a check."""
N_COMPARED_FRAMES = 200
"""Frames of a camera in which detections are compared, evenly spread; at most twice as many are kept."""
SAME, STAYING = 0.7, 0.9
"""Boxes with this intersection over union are at one position; one there in so large a share of all frames stays."""
OFTEN = 0.5
"""A camera with detections in this share of its frames shows that there is something to detect."""
OUTSIDE = 0.01
"""Share of boxes wholly outside the image that matters."""


def with_figures(check: Check, frames: int, detections: int) -> Check:
    """Add the numbers of frames and detections to the check of the detector; other or failed checks are unchanged."""
    if check.name != DETECTOR or check.found:
        return check
    return structs.replace(check, figures={**check.figures, "frames": frames, "detections": detections})


class Checked:
    """Accumulates statistics of detections over streams of views and bearings, for checks at the end."""

    def __init__(self, scene: Scene) -> None:
        """Start without detections; image sizes and poses of the cameras come from the scene."""
        self._sizes = {c.name: c.image_size for c in scene.cameras}
        self._rotations = [c.rotation for c in scene.cameras if c.placed]
        self._boxes: Counter[str] = Counter()
        self._outside: Counter[str] = Counter()
        self._frames: Counter[str] = Counter()  # with detections
        self._every: dict[str, int] = {}
        self._kept: dict[str, list[Floats]] = {}  # of each camera the (k, 4) edges in a frame
        self._rows: Counter[int] = Counter()  # of each target
        self._seen: Counter[int] = Counter()

    def add_bearings(self, rows: Bearings) -> None:
        """Count rows and detections of each labelled target; candidates without a label are not counted."""
        for target in np.unique(rows.target_id[rows.target_id >= 0]).tolist():
            own = rows.target_id == target
            self._rows[target] += int(np.count_nonzero(own))
            self._seen[target] += int(np.count_nonzero(own & rows.seen))

    def add(self, views: Views) -> None:
        """Add views; rows recovered by fusion have no box."""
        for name in np.unique(views.sensor).tolist():
            own = views.take((views.sensor == name) & np.isfinite(views.left_px))
            edges = np.column_stack([own.left_px, own.top_px, own.width_px, own.height_px])
            edges[:, 2:] += edges[:, :2]
            self._boxes[name] += len(own)
            if (size := self._sizes.get(name)) is not None:
                out = (edges[:, :2] > size).any(axis=1) | (edges[:, 2:] < 0.0).any(axis=1)
                self._outside[name] += int(np.count_nonzero(out))
            for frame in np.split(edges, np.flatnonzero(np.diff(own.t_ns)) + 1):
                self._see(name, frame)

    def _see(self, name: str, edges: Floats) -> None:
        if not len(edges):
            return
        kept, every = self._kept.setdefault(name, []), self._every.setdefault(name, 1)
        if self._frames[name] % every == 0:
            kept.append(edges)
            if len(kept) > 2 * N_COMPARED_FRAMES:
                self._kept[name], self._every[name] = kept[::2], 2 * every
        self._frames[name] += 1

    def checks(self, frames: Mapping[str, int]) -> tuple[Check, ...]:
        """Return the checks of the detections with their findings.

        Args:
            frames: number of processed frames by camera name; cameras with fewer than `FEWEST` are not checked.
        """
        enough = {name: count for name, count in frames.items() if count >= FEWEST}
        few = "" if enough else f"no camera has {FEWEST} frames"
        boxes = "" if self._boxes else "there are no boxes"
        return (
            *outcome(DETECTS, self._none(enough), unless=few),
            *outcome(INSIDE, self._wide(), unless=boxes),
            *outcome(STAYS, self._staying(enough), unless=few or boxes),
            *self._never_seen(),
            *outcome(POSES, self._without_pose(), unless=boxes),
            *outcome(UPRIGHT, self._tilted(), unless="" if self._rotations else "no camera has a pose"),
        )

    def _without_pose(self) -> Iterator[Check]:
        """Report if no camera of the boxes has a pose."""
        if not self._rotations:
            yield finding(POSES, "cameras-without-pose")

    def _tilted(self) -> Iterator[Check]:
        """Report a world that is not upright."""
        return tilted_world(np.array(self._rotations).reshape(-1, 3, 3))

    def _none(self, frames: Mapping[str, int]) -> Iterator[Check]:
        """Report that nothing is detected at all, or cameras without detections while another one has many.

        `frames` is the number of frames of each camera.
        """
        if frames and not self._boxes:
            yield finding(DETECTS, "nothing-detected", sensors=sorted(frames), frames=sum(frames.values()))
            return
        shares = {name: self._frames[name] / count for name, count in frames.items()}
        often = max(shares, key=lambda name: shares[name], default="")
        for name in (each for each, share in sorted(shares.items()) if not share and shares[often] >= OFTEN):
            yield finding(
                DETECTS, "no-detections", sensors=[name], frames=frames[name], other=often, share=shares[often]
            )

    def _never_seen(self) -> Iterator[Check]:
        """Report targets with at least `FEWEST` rows that no camera detects."""
        never = [target for target, rows in sorted(self._rows.items()) if rows >= FEWEST and not self._seen[target]]
        if never:
            yield finding(TARGETS, "target-never-detected", targets=never, rows=max(self._rows[t] for t in never))

    def _wide(self) -> Iterator[Check]:
        """Report cameras with more than a share `OUTSIDE` of boxes wholly outside the image."""
        for name, count in sorted(self._boxes.items()):
            if exceeds_share(self._outside[name], count, OUTSIDE):
                yield finding(
                    INSIDE,
                    "boxes-outside-image",
                    sensors=[name],
                    count=self._outside[name],
                    boxes=count,
                    share=self._outside[name] / count,
                    allowed=OUTSIDE,
                )

    def _staying(self, frames: Mapping[str, int]) -> Iterator[Check]:
        """Report cameras with a detection at one position in more than a share `STAYING` of the frames (static object).

        `frames` is the number of frames of each camera.
        """
        for name, count in sorted(frames.items()):
            kept = self._kept.get(name, [])
            if self._frames[name] <= STAYING * count or not kept:
                continue
            found = [float(np.mean([_overlaps(box, frame) for frame in kept])) for box in kept[len(kept) // 2]]
            share = max(found) * self._frames[name] / count
            if share > STAYING:
                left, top, right, bottom = kept[len(kept) // 2][int(np.argmax(found))].tolist()
                yield finding(
                    STAYS,
                    "static-detection",
                    sensors=[name],
                    u_px=0.5 * (left + right),
                    v_px=0.5 * (top + bottom),
                    share=share,
                    allowed=STAYING,
                )


def _overlaps(box: Floats, others: Floats) -> bool:
    """Whether any of the boxes `others` (k, 4) has an intersection over union of at least `SAME` with a box (4,).

    Boxes are left, top, right, bottom.
    """
    both = np.prod(np.maximum(np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2]), 0.0), axis=1)
    each = np.prod(others[:, 2:] - others[:, :2], axis=1) + np.prod(box[2:] - box[:2])
    return bool((both >= SAME * (each - both)).any())
