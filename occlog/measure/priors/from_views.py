"""Priors of moving occluders from views: visual hull of all cameras at each time step."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely

from occlog.array_types import Floats, Ints32
from occlog.core.occlusion.priors import polygon_priors
from occlog.errors import InputError, abridged
from occlog.io.files.timing.utc import time_words
from occlog.records.scene import Scene, map_origin, scene_from
from occlog.records.tables import Bearings, Hulls, Occluders, Views
from occlog.scans.occluder_priors import none_at

from .config import HullConfig
from .hull import (
    CameraCones,
    ConfirmedPolygon,
    HullCamera,
    HullMemory,
    HullRules,
    Polygon,
    cones,
    hull,
    hull_camera,
    runs,
    track_polygons,
)

STEPS_PER_CHUNK = 256


class HullPriors(NamedTuple):
    """Priors of occluders for several time steps.

    Attributes:
        hulls: polygons of the visual hull.
        occluders: Gaussians with the polygons' means and covariances.
        n_steps: number of time steps.
        candidates: number of polygons before phantoms were removed.
    """

    hulls: Hulls
    occluders: Occluders
    n_steps: int
    candidates: int


class _Frame(NamedTuple):
    """Rows of one camera at one time: `views`, empty if it detected no people, time `t_ns` [ns] and name `sensor`."""

    t_ns: int
    sensor: str
    views: Views


def hull_priors(
    views: Iterable[Views], scene: Scene, config: HullConfig, frames: Iterable[Bearings] | None = None
) -> Iterator[HullPriors]:
    """Generate polygons and Gaussians that contain the moving occluders, by visual hulls, chunk by chunk.

    Clusters of a target (`target_id` >= 0) are not occluders, unless `exclude_targets` is off; the region behind
    them is invisible to the camera. Cameras without pose are not used.

    Args:
        views: clusters in the order of time.
        scene: scene with the cameras.
        config: settings.
        frames: bearings made along with the views: their rows state which cameras delivered a frame, also one without a
            cluster; None: such a frame counts as missing.

    Raises:
        InputError: a camera that the scene does not have, or times that go back.
    """
    placed = [c for c in scene.cameras if c.placed]
    origin = map_origin(placed) if placed else np.zeros(2)
    scene = scene_from(scene, origin)
    cameras: dict[str, HullCamera] = {}
    rules = _rules(config)
    memory = HullMemory()
    held: list[tuple[int, list[ConfirmedPolygon]]] = []
    candidates = 0
    for t_ns, step in _time_steps(views, frames, scene, round(config.window_s * 1e9)):
        # Cones of what each camera sees, then their visual hull
        camera_views = [_camera_cones(f, cameras, scene, config) for f in step]
        found = (
            hull(camera_views, scene.region, config.min_views, config.max_missed_views, config.min_area)
            if camera_views
            else []
        )
        # Identities over time; phantoms are skipped
        memory, seen = track_polygons(memory, t_ns, found, rules)
        candidates += len(found)
        held.append((t_ns, seen))
        if len(held) >= STEPS_PER_CHUNK:
            yield _on_map(_tables(held, candidates), origin)
            held, candidates = [], 0
    if held:
        yield _on_map(_tables(held, candidates), origin)


def _on_map(found: HullPriors, origin: Floats) -> HullPriors:
    """Translate positions relative to `origin` (2,) to the coordinates of the map."""
    x, y = origin
    return found._replace(
        hulls=replace(found.hulls, x=found.hulls.x + x, y=found.hulls.y + y),
        occluders=replace(found.occluders, x=found.occluders.x + x, y=found.occluders.y + y),
    )


def _rules(config: HullConfig) -> HullRules:
    """Rules for the identities of polygons from the settings; times in nanoseconds."""
    return HullRules(
        persist_ns=round(1e9 * config.confirmation_time_s),
        memory_ns=round(1e9 * config.evidence_memory_s),
        lost_ns=round(1e9 * config.deletion_time_s),
        hold_ns=round(1e9 * config.coasting_s),
        speed=config.max_speed,
        reach=config.max_jump,
    )


def _time_steps(
    views: Iterable[Views], frames: Iterable[Bearings] | None, scene: Scene, window_ns: int
) -> Iterator[tuple[int, list[_Frame]]]:
    """Generate time steps of at most `window_ns` [ns]: time of the last frame, and a frame per camera, sorted by name.

    `frames` (bearings) add frames without clusters; cameras without pose are skipped.
    """
    unplaced = [c.name for c in scene.cameras if not c.placed]
    group: dict[str, _Frame] = {}
    first = last = 0
    for frame in _frames(views, frames, scene):
        if frame.sensor in unplaced:
            continue
        before = group.get(frame.sensor)
        if group and (frame.t_ns - first > window_ns or (before is not None and before.t_ns != frame.t_ns)):
            yield last, [group[name] for name in sorted(group)]
            group, before = {}, None
        if not group:
            first = frame.t_ns
        last = frame.t_ns
        if before is None or not len(before.views):
            group[frame.sensor] = frame
    if group:
        yield last, [group[name] for name in sorted(group)]


def _frames(views: Iterable[Views], frames: Iterable[Bearings] | None, scene: Scene) -> Iterator[_Frame]:
    """Generate the frames of views and of bearings by nondecreasing time.

    A frame in both tables occurs twice, first with its clusters.

    Args:
        views: clusters in frames, in the order of time.
        frames: bearings, of which only time and camera are used: there was a frame; None: not given.
        scene: scene with the cameras.
    """
    streams = [_split(views, scene)]
    if frames is not None:
        streams.append(_split(frames, scene))
    yield from heapq.merge(*streams, key=lambda frame: frame.t_ns)


def _split(chunks: Iterable[Views] | Iterable[Bearings], scene: Scene) -> Iterator[_Frame]:
    """Generate the frames of a table, by time and camera; those of bearings are empty.

    InputError for a camera that is not in the scene, or times that go back.
    """
    names = [c.name for c in scene.cameras]
    arrays = [a.name for a in scene.arrays]
    rest: Views | Bearings | None = None
    for chunk in chunks:
        if not len(chunk):
            continue
        for name in np.unique(chunk.sensor).tolist():
            if name not in names and name not in arrays:
                raise InputError(
                    f"{chunk.NAME}: no camera {name!r} in the scene; it has: {abridged(names)}",
                    id="unknown-sensor",
                )
        if rest is not None and chunk.t_ns[0] < rest.t_ns[-1]:
            raise InputError(
                f"{chunk.NAME}: time {time_words(chunk.t_ns[0])} is earlier than the preceding "
                f"{time_words(rest.t_ns[-1])}; sort by t_ns",
                id="unsorted-times",
            )
        table = chunk if rest is None else type(chunk).concat([rest, chunk])  # type: ignore[list-item]
        cut = int(np.searchsorted(table.t_ns, table.t_ns[-1]))
        yield from _split_complete(table.take(slice(0, cut)), names)
        # The last time may go on in the next chunk.
        rest = table.take(slice(cut, None))
    if rest is not None:
        yield from _split_complete(rest, names)


def _split_complete(table: Views | Bearings, names: list[str]) -> Iterator[_Frame]:
    if not len(table):
        return
    table = table.take(np.lexsort([table.sensor, table.t_ns]))
    fresh = (np.diff(table.t_ns) != 0) | (table.sensor[1:] != table.sensor[:-1])
    for a, b in pairwise([0, *(np.flatnonzero(fresh) + 1).tolist(), len(table)]):
        if str(table.sensor[a]) in names:
            rows = table.take(slice(a, b)) if isinstance(table, Views) else Views.empty()
            yield _Frame(int(table.t_ns[a]), str(table.sensor[a]), rows)


def _camera_cones(frame: _Frame, cameras: dict[str, HullCamera], scene: Scene, config: HullConfig) -> CameraCones:
    """Cones of a camera's clusters in one frame that are of no target, and the region in which it decides on presence.

    That region is the visible one less what targets hide. `cameras` caches the camera with its visible region by
    name, and is updated in place.
    """
    if frame.sensor not in cameras:
        cameras[frame.sensor] = hull_camera(scene.camera(frame.sensor), scene)
    view, v = cameras[frame.sensor], frame.views
    boxes = np.column_stack([v.left_px, v.top_px, v.width_px, v.height_px])
    of_runs = runs(boxes, view.camera, config.dilation + 2.0 * view.camera.sigma_yaw)
    own = (v.target_id >= 0) & config.exclude_targets
    others = cones(view, of_runs[~own])
    visible = view.visible
    if own.any():
        # Behind the target the camera sees nothing, except where another run overlaps
        hidden = shapely.difference(shapely.union_all(cones(view, of_runs[own])), shapely.union_all(others))
        visible = shapely.difference(visible, hidden)
    return CameraCones(visible, others)


def _tables(steps: list[tuple[int, list[ConfirmedPolygon]]], candidates: int) -> HullPriors:
    empty = np.array([t for t, found in steps if not found], dtype=np.int64)
    none = none_at(empty)
    rows = [(t, k, _corners(p)) for t, found in steps for k, p in found]
    sizes = [len(c) for _, _, c in rows]
    t_ns = np.array([t for t, _, _ in rows], dtype=np.int64)
    identity: Ints32 = np.array([k for _, k, _ in rows], dtype=np.int32)
    corners = np.concatenate([np.empty((0, 2)), *(c for _, _, c in rows)])
    number = np.concatenate([np.empty(0, dtype=np.int32), *(np.arange(n, dtype=np.int32) for n in sizes)])
    hulls = Hulls(
        t_ns=np.repeat(t_ns, sizes),
        occluder_id=np.repeat(identity, sizes),
        corner=number,
        x=corners[:, 0],
        y=corners[:, 1],
    )
    no_hulls = Hulls(
        t_ns=empty, occluder_id=none.occluder_id, corner=np.zeros(len(empty), dtype=np.int32), x=none.x, y=none.y
    )
    gaussians = Occluders.merge([_gaussians(t_ns, identity, [c for _, _, c in rows]), none])
    return HullPriors(Hulls.merge([hulls, no_hulls]), gaussians, len(steps), candidates)


def _corners(polygon: Polygon) -> Floats:
    """(K, 2) corners of a polygon, counter-clockwise."""
    ring = shapely.geometry.polygon.orient(polygon.shape).exterior
    return np.asarray(ring.coords)[:-1]


def _gaussians(t_ns: np.ndarray[tuple[int], np.dtype[np.int64]], identity: Ints32, corners: list[Floats]) -> Occluders:
    """Gaussian priors with the mean and covariance of uniform distributions over polygons.

    Args:
        t_ns: (n,) times [ns].
        identity: (n,) identities of the occluders.
        corners: n polygons (K, 2) with any number of corners.
    """
    p = polygon_priors(corners, 1.0)
    c, s = p.axis[:, 0], p.axis[:, 1]
    major, minor = p.sigma**2, p.minor**2
    return Occluders(
        t_ns=t_ns,
        occluder_id=identity,
        x=p.mean[:, 0],
        y=p.mean[:, 1],
        cov_xx=major * c**2 + minor * s**2,
        cov_xy=(major - minor) * c * s,
        cov_yy=major * s**2 + minor * c**2,
    )
