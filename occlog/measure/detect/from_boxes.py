"""Conversion of person detector boxes to views and candidate bearings.

With identities, boxes are labelled, and missed detections of targets are added.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.errors import InputError, option
from occlog.measure.detections import Detections
from occlog.records.scene import Camera, Scene
from occlog.records.tables import APPEARANCE_BINS, UNLABELLED, Bearings, Boxes, Views

from .bearing import BearingNoise, RegionBearings, shape_covariance, sights
from .config import GLOBAL, DetectConfig


@dataclass
class LabelMap:
    """Map from identities of boxes to targets.

    Attributes:
        scope: `GLOBAL` (identities are equal in all cameras) or `CAMERA` (each camera has its own).
        number: target by camera and identity; the camera is empty text where identities are global.
        span: first and last time [ns] by target at which it has a box of sufficient confidence.
    """

    scope: str
    number: dict[tuple[str, int], int] = field(default_factory=dict)
    span: dict[int, tuple[int, int]] = field(default_factory=dict)

    def of(self, sensor: str, ids: Ints32) -> Ints32:
        """(n,) targets of the box identities `ids` (n,) in the camera `sensor`; `UNLABELLED` if unknown."""
        known = {i: self.number.get(self.key(sensor, i), UNLABELLED) for i in np.unique(ids).tolist()}
        return np.array([known[i] for i in ids.tolist()], dtype=np.int32)

    def missed(self, sensor: str, frames: Ints, t_ns: Ints, target: Ints32) -> tuple[Ints, Ints32]:
        """Times (k,) [ns] and targets (k,) of a camera's frames in which a target has no box, sorted by time.

        Only times between the first and last box of the target in the recording count: in any camera if identities are
        global, else in this one.

        Args:
            sensor: name of the camera.
            frames: (F,) times of its frames [ns].
            t_ns: (n,) times of its boxes [ns].
            target: (n,) their targets.
        """
        times, missing = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int32)]
        for (owner, _), k in self.number.items():
            if owner not in ("", sensor):
                continue
            first, last = self.span[k]
            there = frames[(frames >= first) & (frames <= last)]
            empty = np.setdiff1d(there, t_ns[target == k])
            times.append(empty)
            missing.append(np.full(len(empty), k, dtype=np.int32))
        found, targets = np.concatenate(times), np.concatenate(missing)
        order = np.lexsort((targets, found))
        return found[order], targets[order]

    def key(self, sensor: str, identity: int) -> tuple[str, int]:
        """Key (camera, identity) in `number` of a box in a camera; the camera is empty if identities are global."""
        return ("" if self.scope == GLOBAL else sensor, identity)


def counted(boxes: Boxes, config: DetectConfig) -> Bools:
    """(R,) mask of rows that are boxes with sufficient or unknown confidence."""
    with np.errstate(invalid="ignore"):
        return (boxes.box >= 0) & ~(boxes.confidence < config.min_confidence)


def scan_labels(chunks: Iterable[Boxes], scope: str, config: DetectConfig) -> LabelMap:
    """Scan all boxes for targets, and the time range of each.

    With the scope `GLOBAL` a target has the number of the identity. With `CAMERA` the identities of all cameras are
    numbered from 0, in the order of time, camera and identity.

    Raises:
        InputError: no box has an identity, or two boxes of a frame have the same one.
    """
    labels = LabelMap(scope)
    for chunk in chunks:
        rows = chunk.take(counted(chunk, config) & (chunk.target_id != UNLABELLED)).sorted()
        order = np.lexsort((rows.target_id, rows.sensor, rows.t_ns))
        keys = [
            (int(rows.t_ns[k]), str(rows.sensor[k]), int(rows.target_id[k]), int(rows.frame[k])) for k in order.tolist()
        ]
        for before, after in pairwise(keys):
            if before[:3] == after[:3]:
                raise InputError(
                    f"camera {after[1]}: frame {after[3]}: two boxes have the identity {after[2]}; one target has one "
                    f"box in a frame: correct the identities, or leave {option('label_scope')} out",
                    id="duplicate-row",
                )
        for t_ns, sensor, identity, _ in keys:
            key = labels.key(sensor, identity)
            target = labels.number.setdefault(key, identity if scope == GLOBAL else len(labels.number))
            labels.span[target] = (labels.span.get(target, (t_ns, t_ns))[0], t_ns)
    if not labels.number:
        raise InputError(
            f"no box has an identity that could be a target's; leave {option('label_scope')} out", id="missing-labels"
        )
    return labels


def detect_boxes(
    boxes: Iterable[Boxes], scene: Scene, config: DetectConfig | None = None, labels: LabelMap | None = None
) -> Iterator[Detections]:
    """Generate views and bearings of detector boxes, chunk by chunk.

    Each box with sufficient or unknown confidence is a view (with its identity as `tracklet_id`) and an unlabelled
    candidate bearing (`target_id` -1, `score` its confidence). A frame without such a box has one bearing row
    without detection. Cameras without pose give views only. With `labels`, boxes with an identity are labelled with
    its target, and a target without a box in a frame, between its first and last box, has a bearing row without
    detection.

    Args:
        boxes: chunks in the order of time; rows of one frame must not be split between chunks.
        scene: scene with the cameras.
        config: its `min_confidence`, `sigma_px` and `sigma_scale` are used; None: the defaults.
        labels: targets of the boxes' identities (`scan_labels`); None: no labels.
    """
    config = config or DetectConfig()
    for chunk in boxes:
        views, bearings = [], []
        for name in np.unique(chunk.sensor).tolist():
            mine = chunk.take(chunk.sensor == name)
            v, b = _of_camera(scene.camera(name), mine, config, labels)
            views.append(v)
            bearings.append(b)
        frames = len(np.unique(np.rec.fromarrays([chunk.t_ns, chunk.sensor])))
        yield Detections(Views.merge(views), Bearings.merge(bearings), (), frames, 0)


def _of_camera(camera: Camera, boxes: Boxes, config: DetectConfig, labels: LabelMap | None) -> tuple[Views, Bearings]:
    good = boxes.take(counted(boxes, config))
    target = np.full(len(good), UNLABELLED, np.int32) if labels is None else labels.of(camera.name, good.target_id)
    centres = np.column_stack([good.left_px + 0.5 * good.width_px, good.top_px + 0.5 * good.height_px])
    spreads = np.column_stack([good.width_px**2, np.zeros(len(good)), good.height_px**2]) / 12.0
    noise = BearingNoise(config.sigma_px, config.sigma_scale)
    covs = shape_covariance(spreads, np.ones(len(good)), _cut(camera, good), noise)
    seen = sights(camera, centres, covs, spreads, spreads, noise)
    views, bearings = _views(good, centres, spreads, seen, target), _bearings(camera, boxes, good, seen, target)
    if labels is None or not camera.placed:
        return views, bearings
    missed, missing = labels.missed(camera.name, np.unique(boxes.t_ns), good.t_ns, target)
    nothing = np.full(len(missed), np.nan)
    unseen = _rows(camera, missed, False, RegionBearings(nothing, nothing, nothing, nothing), nothing, missing)
    return views, Bearings.merge([bearings, unseen])


def _cut(camera: Camera, boxes: Boxes) -> Bools:
    """(n,) mask of boxes that touch the left or right border of the image; False if the image size is unknown."""
    if camera.image_size is None:
        return np.zeros(len(boxes), dtype=np.bool_)
    right = camera.image_size[0] - 1.5
    cut: Bools = (boxes.left_px < 0.5) | (boxes.left_px + boxes.width_px > right)
    return cut


def _views(boxes: Boxes, centres: Floats, spreads: Floats, seen: RegionBearings, target: Ints32) -> Views:
    n = len(boxes)
    area = boxes.width_px * boxes.height_px
    return Views.of(
        t_ns=boxes.t_ns,
        sensor=boxes.sensor,
        frame=boxes.frame,
        cluster=_ranks(boxes, area),
        x_px=centres[:, 0],
        y_px=centres[:, 1],
        cov_xx_px=spreads[:, 0],
        cov_xy_px=spreads[:, 1],
        cov_yy_px=spreads[:, 2],
        left_px=boxes.left_px,
        top_px=boxes.top_px,
        width_px=boxes.width_px,
        height_px=boxes.height_px,
        area_px=area,
        bearing=seen.bearing,
        sigma=seen.sigma,
        u_px=seen.u_px,
        sigma_px=seen.sigma_px,
        confidence=boxes.confidence,
        similarity=np.full(n, np.nan),
        target_id=target,
        appearance=np.full((n, APPEARANCE_BINS), np.nan, dtype=np.float32),
        tracklet_id=boxes.target_id,
    ).sorted()


def _ranks(boxes: Boxes, area: Floats) -> np.ndarray[tuple[int], np.dtype[np.int32]]:
    """(n,) number of each box in its frame, from 0, by decreasing `area` (n,); boxes are of one camera."""
    order = np.lexsort((boxes.box, -area, boxes.t_ns))
    t_ns = boxes.t_ns[order]
    starts = np.flatnonzero(np.concatenate([[True], t_ns[1:] != t_ns[:-1]])) if len(t_ns) else np.empty(0, int)
    within = np.arange(len(t_ns)) - np.repeat(starts, np.diff(np.append(starts, len(t_ns))))
    ranks = np.empty(len(t_ns), dtype=np.int32)
    ranks[order] = within
    return ranks


def _bearings(camera: Camera, boxes: Boxes, good: Boxes, seen: RegionBearings, target: Ints32) -> Bearings:
    if not camera.placed:
        return Bearings.empty()
    if camera.distortion_model == "equidistant":  # boxes where a wide fisheye is not used give no bearings
        kept = np.isfinite(seen.sigma)
        good, target = good.take(kept), target[kept]
        seen = RegionBearings(*(column[kept] for column in seen))
    if np.isnan(seen.bearing).any():
        row = int(np.flatnonzero(np.isnan(seen.bearing))[0])
        raise InputError(
            f"camera {camera.name}: frame {good.frame[row]}: a box is where the lens model does not hold (no line of "
            "sight); check the distortion, or the boxes"
        )
    empty = np.setdiff1d(boxes.t_ns, good.t_ns)
    nothing, unlabelled = np.full(len(empty), np.nan), np.full(len(empty), UNLABELLED, dtype=np.int32)
    return Bearings.merge(
        [
            _rows(camera, good.t_ns, True, seen, good.confidence, target),
            _rows(camera, empty, False, RegionBearings(nothing, nothing, nothing, nothing), nothing, unlabelled),
        ]
    )


def _rows(camera: Camera, t_ns: Ints, found: bool, seen: RegionBearings, score: Floats, target: Ints32) -> Bearings:
    n = len(t_ns)
    return Bearings.of(
        t_ns=t_ns,
        sensor=np.full(n, camera.name),
        target_id=target,
        seen=np.full(n, found),
        bearing=seen.bearing,
        sigma=seen.sigma,
        u_px=seen.u_px,
        sigma_px=seen.sigma_px,
        score=score,
    )
