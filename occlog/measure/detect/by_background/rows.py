"""Rows of views and bearings from the regions of a camera's frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.measure.regions.regions import ForegroundRegions
from occlog.records.tables import Bearings, Views

from ..bearing import BearingNoise, RegionBearings, shape_covariance, sights
from ..config import LONE_TARGET_ID
from ..track_feedback import inside_gate
from .one_camera import CameraState, FrameRegions, choose, similarities

BORDER_PX = 1.0  # a box that comes this near to the side of the image is cut by it


class _RegionFrames(NamedTuple):
    """Regions of F frames of one camera, concatenated to K rows.

    Times [ns] (F,), frame numbers (F,), and row of each frame's first region, then K (F + 1,).
    """

    t_ns: Ints  # (F,)
    number: Ints  # (F,) of the frames
    first: Ints  # (F + 1,) row of each frame's first region
    regions: ForegroundRegions


def to_tables(state: CameraState, found: Sequence[FrameRegions]) -> tuple[Views, Bearings]:
    """Convert the regions of some frames of one camera to rows of views and bearings.

    Args:
        state: camera, settings and targets; its memory of their positions is updated in place.
        found: regions of each frame, by rising time.

    Returns:
        Views (one row per region) and bearings (one row per frame and target); both empty without frames.
    """
    if not found or state.setup is None:
        return Views.empty(), Bearings.empty()
    frames = _gather(found)
    r = frames.regions
    noise = BearingNoise(state.config.sigma_px, state.config.sigma_scale)
    covs = shape_covariance(r.person, r.fill, _cut(r.boxes, state.setup.shape[1]), noise)
    seen = sights(state.camera, r.means, covs, r.covs, r.person, noise)
    like = similarities(r.appearance, state.targets)
    chosen = _choose(state, frames, like, seen)
    return _views(state, frames, seen, like, chosen), _bearings(state, frames, seen, like, chosen)


def _gather(found: Sequence[FrameRegions]) -> _RegionFrames:
    counts = [len(f.regions.mass) for f in found]
    regions = ForegroundRegions(*(np.concatenate(parts) for parts in zip(*(f.regions for f in found), strict=True)))
    return _RegionFrames(
        np.array([f.t_ns for f in found], dtype=np.int64),
        np.array([f.index for f in found], dtype=np.int64),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        regions,
    )


def _cut(boxes: Floats, width: int) -> Bools:
    """(K,) mask of boxes (K, 4: left, top, width, height [px]) that touch the left or right border of an image.

    `width` is that of the image [px].
    """
    left, right = boxes[:, 0], boxes[:, 0] + boxes[:, 2]
    cut: Bools = (left < BORDER_PX - 0.5) | (right > width - 0.5 - BORDER_PX)
    return cut


def _choose(state: CameraState, frames: _RegionFrames, like: Floats, seen: RegionBearings) -> Ints:
    """(F, T) row of each target's region among all K regions of F frames; -1 if not detected.

    Args:
        state: state of the camera; its memory of the T targets is updated in place.
        frames: regions of the frames.
        like: (K, T) similarities of regions and targets.
        seen: bearings of the regions.
    """
    chosen, may_be = [], _near(state, frames, seen)
    for t_ns, a, b in zip(frames.t_ns.tolist(), frames.first[:-1], frames.first[1:], strict=True):
        mine = ForegroundRegions(*(column[a:b] for column in frames.regions))
        may = None if may_be is None else may_be[a:b]
        one = choose(t_ns, mine, like[a:b], state.memory, state.config.min_similarity, may)
        chosen.append(np.where(one >= 0, one + a, -1))
    rows = np.array(chosen)
    if state.camera.distortion_model == "equidistant" and state.camera.placed:
        # Regions where a wide fisheye is not used give no bearings
        rows = np.where((rows >= 0) & np.isfinite(np.append(seen.sigma, np.nan))[rows], rows, -1)
    return rows


def _near(state: CameraState, frames: _RegionFrames, seen: RegionBearings) -> Bools | None:
    """(K, T) mask of regions within the gate of each target's track; None without track feedback or pose.

    `seen` are the bearings of the K regions.
    """
    near, camera = state.near, state.camera
    if near is None or not camera.placed:
        return None
    t_ns = np.repeat(frames.t_ns, np.diff(frames.first))
    columns = [inside_gate(near, k, camera.ground, t_ns, seen.bearing, seen.sigma) for k in _target_ids(state)]
    return np.column_stack(columns)


def _target_ids(state: CameraState) -> list[int]:
    return [t.target_id for t in state.targets] or [LONE_TARGET_ID]


def _views(state: CameraState, frames: _RegionFrames, seen: RegionBearings, like: Floats, chosen: Ints) -> Views:
    r = frames.regions
    counts = np.diff(frames.first)
    total = len(r.mass)
    target_id = np.full(total, -1, dtype=np.int32)
    shown = like.max(axis=1) if like.shape[1] else np.full(total, np.nan)
    for n, name in enumerate(_target_ids(state)):
        rows = chosen[chosen[:, n] >= 0, n]
        target_id[rows] = name
        if like.shape[1]:
            shown[rows] = like[rows, n]
    return Views.of(
        t_ns=np.repeat(frames.t_ns, counts),
        sensor=np.full(total, state.camera.name),
        frame=np.repeat(frames.number, counts),
        cluster=(np.arange(total) - np.repeat(frames.first[:-1], counts)).astype(np.int32),
        x_px=r.means[:, 0],
        y_px=r.means[:, 1],
        cov_xx_px=r.covs[:, 0],
        cov_xy_px=r.covs[:, 1],
        cov_yy_px=r.covs[:, 2],
        left_px=r.boxes[:, 0],
        top_px=r.boxes[:, 1],
        width_px=r.boxes[:, 2],
        height_px=r.boxes[:, 3],
        area_px=r.mass,
        bearing=seen.bearing,
        sigma=seen.sigma,
        u_px=seen.u_px,
        sigma_px=seen.sigma_px,
        confidence=np.full(total, np.nan),
        similarity=shown,
        target_id=target_id,
        appearance=r.appearance.astype(np.float32),
    )


def _bearings(state: CameraState, frames: _RegionFrames, seen: RegionBearings, like: Floats, chosen: Ints) -> Bearings:
    """Bearings: one row for each frame and target, also if not detected; none for a camera without pose.

    Args:
        state: state of the camera.
        frames: F frames with K regions.
        seen: bearings of the regions.
        like: (K, T) similarities of regions and targets.
        chosen: (F, T) row of each target's region; -1: not detected.
    """
    if not state.camera.placed:
        return Bearings.empty()
    ids = _target_ids(state)
    rows = chosen.ravel()
    found = rows >= 0

    def pick(values: Floats) -> Floats:
        out = np.full(len(rows), np.nan)
        out[found] = values[rows[found]]
        return out

    score = np.full(len(rows), np.nan)
    if like.shape[1]:
        score[found] = like[rows[found], np.tile(np.arange(len(ids)), len(chosen))[found]]
    return Bearings.of(
        t_ns=np.repeat(frames.t_ns, len(ids)),
        sensor=np.full(len(rows), state.camera.name),
        target_id=np.tile(np.array(ids, dtype=np.int32), len(chosen)),
        seen=found,
        bearing=pick(seen.bearing),
        sigma=pick(seen.sigma),
        u_px=pick(seen.u_px),
        sigma_px=pick(seen.sigma_px),
        score=score,
    )
