"""Visual hull of one time step: where objects can be, given the foreground of all cameras.

A run is an interval of azimuths in which a camera sees foreground; its cone is the part of the ground within it. A
position is in the hull if every camera that can see it has a run there (N of N). For otherwise unexplained runs,
positions at which up to `misses` cameras have none (N-1 of N) are included, for a camera that missed an object.

Polygons of the hull are tracked over time, and phantoms removed: where the cones of two objects cross, the hull has
polygons without an object, which are transient, or with all runs explained by others. A polygon has *evidence* at
a time if it alone explains one of its runs. It is confirmed if it has existed long enough, and had recent evidence or
is needed to explain a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from occlog.array_types import Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.core.numerics.assignment import assign
from occlog.records.scene import Camera, Scene

Run = tuple[int, int]
"""A camera's position in the list of frames, and the number of its run."""


STEP = np.pi / 6
"""Largest angle between neighbouring corners of the far side of a wedge."""


class HullCamera(NamedTuple):
    """A camera, the part of the room in which it can see objects, and a distance from it beyond the room [length]."""

    camera: Camera
    visible: shapely.Geometry
    far: float  # beyond everything, seen from the camera


def hull_camera(camera: Camera, scene: Scene) -> HullCamera:
    """Find the region of the room that a camera can see: field of view and range, without shadows of occluders."""
    room = shapely.Polygon(scene.region)
    far = 1.0 + 2.0 * float(np.hypot(*(scene.region - camera.ground).T).max())
    visible = shapely.intersection(room, wedge(camera.ground, camera.yaw, camera.fov, far))
    if np.isfinite(camera.range):
        visible = shapely.intersection(visible, shapely.Point(camera.ground).buffer(camera.range, quad_segs=32))
    for wall in scene.blockers(camera.ground):
        visible = shapely.difference(visible, shadow(camera.ground, wall, far))
    return HullCamera(camera, visible, far)


def wedge(origin: Floats, axis: float, width: float, far: float) -> shapely.Geometry:
    """Sector, as a polygon, of directions within `width` / 2 of `axis` [rad] from `origin` (2,) on the ground.

    It reaches to a distance of at least `far` [length]; a width of 2 pi or more gives a polygon around the origin.
    """
    width = min(width, 2.0 * np.pi)
    n = max(int(np.ceil(width / STEP)), 1)
    angles = axis + np.linspace(-0.5 * width, 0.5 * width, n + 1)
    rim = origin + far / np.cos(0.5 * width / n) * np.column_stack([np.cos(angles), np.sin(angles)])
    if width >= 2.0 * np.pi:
        return shapely.Polygon(rim[:-1])
    return shapely.make_valid(shapely.Polygon(np.vstack([origin, rim])))


def shadow(origin: Floats, wall: Floats, far: float) -> shapely.Geometry:
    """Union of a wall and its shadow seen from `origin` (2,) outside it, up to a distance of at least `far` [length].

    `wall` (K, 2) are the corners of the polygon.
    """
    parts = [shapely.Polygon(wall)]
    for a, b in zip(wall, np.roll(wall, -1, axis=0), strict=True):
        rays = np.array([a, b]) - origin
        distance = np.hypot(*rays.T)
        if distance.min() == 0.0:
            continue
        # Both rays are made so long that the line between their ends is beyond `far`.
        cosine = np.clip(rays[0] @ rays[1] / distance.prod(), -1.0, 1.0)
        half = np.sqrt(max(0.5 * (1.0 + cosine), 1e-6))
        ends = origin + rays / distance[:, None] * (far / half)
        parts.append(shapely.make_valid(shapely.Polygon([a, b, ends[1], ends[0]])))
    return shapely.union_all(parts)


def runs(boxes: Floats, camera: Camera, dilate: float) -> Floats:
    """(B, 2) azimuth of the middle and width [rad] of the intervals that boxes cover, dilated on both sides.

    Azimuths in the world are those of the box edges at half the height of each box.

    Args:
        boxes: (B, 4) left, top, width, height [px].
        camera: camera with a pose.
        dilate: angle added to either side [rad].
    """
    middle = boxes[:, 1] + 0.5 * boxes[:, 3]
    left = camera.bearings(np.column_stack([boxes[:, 0], middle]))
    right = camera.bearings(np.column_stack([boxes[:, 0] + boxes[:, 2], middle]))
    half = 0.5 * wrap_angle(left - right)
    return np.column_stack([wrap_angle(right + half), 2.0 * (np.abs(half) + dilate)])


def cones(view: HullCamera, of_runs: Floats) -> list[shapely.Geometry]:
    """Cones of runs `of_runs` (B, 2: azimuth of the middle, width [rad]) within the region that a camera sees.

    Overlapping runs make one cone.
    """
    parts = [wedge(view.camera.ground, centre, width, view.far) for centre, width in _merged(of_runs)]
    return [shapely.intersection(part, view.visible) for part in parts]


def _merged(of_runs: Floats) -> list[tuple[float, float]]:
    """Union of the intervals `of_runs` (B, 2: centre, width) of angles [rad], as pairs of centre and width.

    Sorted by lower end; intervals may join across +-pi, and are at most 2 pi wide.
    """
    spans = sorted((float(c - 0.5 * w), float(c + 0.5 * w)) for c, w in of_runs)
    out: list[list[float]] = []
    for low, high in spans:
        if out and low <= out[-1][1]:
            out[-1][1] = max(out[-1][1], high)
        else:
            out.append([low, high])
    # The last may reach around to the first.
    while len(out) > 1 and out[-1][1] - 2.0 * np.pi >= out[0][0]:
        first = out.pop(0)
        out[-1][1] = max(out[-1][1], first[1] + 2.0 * np.pi)
    return [(0.5 * (low + high), min(high - low, 2.0 * np.pi)) for low, high in out]


class CameraCones(NamedTuple):
    """Polygons on the ground of one camera at one time: where it can decide whether an object is present, and cones.

    A cone is the visible part of the ground behind an interval of foreground.
    """

    visible: shapely.Geometry  # where it can decide whether an object is present
    cones: list[shapely.Geometry]  # of its runs


class Polygon(NamedTuple):
    """A polygon of the visual hull, with the cones that contain it.

    Attributes:
        shape: the polygon on the ground.
        runs: sorted pairs (index of the camera, index of its cone) of cones that contain it.
        missed: number of cameras that can see it and have no foreground there.
    """

    shape: shapely.Polygon
    runs: tuple[Run, ...]
    missed: int


class _Cell(NamedTuple):
    shape: shapely.Geometry
    runs: tuple[Run, ...]
    missed: int


def hull(views: Sequence[CameraCones], room: Floats, least: int, misses: int, smallest: float) -> list[Polygon]:
    """Polygons of the visual hull at one time, in a deterministic order.

    First those that no camera contradicts, i.e. can see without having foreground there. Then, for cones in none of
    these, polygons that 1 to `misses` cameras contradict, few of them (greedy set cover).

    Args:
        views: cones of the cameras.
        room: (K, 2) corners of the region in which objects can be.
        least: minimum number of cameras with foreground at a position; at least 2 where a camera contradicts.
        misses: maximum number of cameras that contradict a polygon.
        smallest: polygons of a smaller area are skipped [length^2].
    """
    # Hull of all cameras (N of N): positions that no camera contradicts
    whole = _Cell(shapely.Polygon(room), (), 0)
    found = _polygons(_cells(views, whole, 0), least, smallest)
    # Runs without such a position: positions that one more camera overlooked (N-1 of N)
    for allowed in range(1, misses + 1):
        explained = sorted({r for p in found for r in p.runs})
        missing = [(i, b) for i, view in enumerate(views) for b in range(len(view.cones)) if (i, b) not in explained]
        if not missing:
            break
        more = _polygons(_cells(views, whole, allowed), max(least, 2), smallest)
        wanted = [p for p in more if p.missed and any(r in missing for r in p.runs)]
        found += _best(wanted, missing)
    return found


def _best(candidates: list[Polygon], missing: list[Run]) -> list[Polygon]:
    """Greedy set cover: select candidates until all runs in `missing` that any of them explains are explained.

    The order, by the number of missing runs explained, is fixed at the beginning; a candidate that explains no
    further run is skipped.
    """
    left, out = list(missing), []
    for p in sorted(candidates, key=lambda p: (-sum(r in missing for r in p.runs), -p.shape.area, p.runs)):
        if any(r in left for r in p.runs):
            out.append(p)
            left = [r for r in left if r not in p.runs]
    return out


def _cells(views: Sequence[CameraCones], whole: _Cell, allowed: int) -> list[_Cell]:
    """Partition the room (the cell `whole`) by cones and visible regions of the views.

    Cells that more than `allowed` cameras contradict (they can see it and have no cone there) are omitted.
    """
    cells = [whole]
    for i, view in enumerate(views):
        rest = _union(view.cones)
        off = shapely.difference(view.visible, rest)
        cells = [part for cell in cells for part in _cut(cell, i, view, off, allowed)]
    return cells


def _cut(cell: _Cell, i: int, view: CameraCones, off: shapely.Geometry, allowed: int) -> Iterator[_Cell]:
    shapes = np.array([*view.cones, off, cell.shape], dtype=object)
    meets = shapely.intersects(shapes, cell.shape)
    for b in range(len(view.cones)):
        if meets[b]:
            yield from _kept(shapely.intersection(cell.shape, view.cones[b]), (*cell.runs, (i, b)), cell.missed)
    if cell.missed < allowed and meets[-2]:
        yield from _kept(shapely.intersection(cell.shape, off), cell.runs, cell.missed + 1)
    yield from _kept(shapely.difference(cell.shape, view.visible), cell.runs, cell.missed)


def _kept(shape: shapely.Geometry, runs: tuple[Run, ...], missed: int) -> Iterator[_Cell]:
    if shape.area > 0.0:
        yield _Cell(shape, runs, missed)


def _polygons(cells: list[_Cell], least: int, smallest: float) -> list[Polygon]:
    """Connected parts of the hull: cells that enough cones contain, joined with their neighbours, without holes.

    A cone is the part of the floor in which one camera sees foreground. Only cells that as many cameras missed are
    joined.

    Args:
        cells: partition of the room.
        least: minimum number of cones that contain a cell.
        smallest: area below which a part is dropped [length^2].
    """
    good = [c for c in cells if len(c.runs) >= least]
    out: list[Polygon] = []
    for missed in sorted({c.missed for c in good}):
        mine = [c for c in good if c.missed == missed]
        for part in _parts(_union([c.shape for c in mine])):
            if part.area < smallest or part.area == 0.0:
                continue
            core = part.buffer(-1e-9 * np.sqrt(part.area))
            touching = [c for c in mine if c.shape.intersects(core)]
            runs = tuple(sorted({r for c in touching for r in c.runs}))
            out.append(Polygon(part, runs, missed))
    return out


def _union(shapes: Sequence[shapely.Geometry]) -> shapely.Geometry:
    return shapely.union_all(list(shapes)) if shapes else shapely.Polygon()


def _parts(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """Polygons of a shape without holes, from left to right."""
    parts = [shapely.Polygon(p.exterior) for p in shapely.get_parts(shape) if p.geom_type == "Polygon"]
    return sorted(parts, key=lambda p: p.bounds)


class HullRules(NamedTuple):
    """Rules for confirming and deleting polygons; lengths in the scene's unit, times in ns.

    `persist_ns`: minimum age of a confirmed polygon; `memory_ns`: time for which evidence counts; `lost_ns`: an
    identity not found for longer is deleted; `hold_ns`: time for which a missing polygon with evidence is still
    reported; `speed` [length/s] and `reach` [length] limit the movement of a centre.
    """

    persist_ns: int  # it must have been there for so long
    memory_ns: int  # evidence counts for so long
    lost_ns: int  # an identity that is not seen for so long is forgotten
    hold_ns: int  # one that had evidence keeps its last polygon for so long
    speed: float  # of the fastest object, per second
    reach: float  # a polygon's centre may move by this also


class TrackedPolygon(NamedTuple):
    """A polygon with its identity at its last time step, its centroid (2,), and times [ns].

    `first_ns` and `last_ns` are those of its first and last time step; `evidence_ns` the last one at which it alone
    explained a foreground run, None for never.
    """

    identity: int
    polygon: Polygon  # the last one
    centre: Floats  # (2,)
    first_ns: int
    last_ns: int
    evidence_ns: int | None  # when it last had evidence; None: never


class HullMemory(NamedTuple):
    """Tracked polygons after previous time steps, sorted by identity, and the next new identity."""

    known: tuple[TrackedPolygon, ...] = ()
    next_identity: int = 0


class ConfirmedPolygon(NamedTuple):
    """A polygon that is reported, with its identity."""

    identity: int
    polygon: Polygon


def track_polygons(
    memory: HullMemory, t_ns: int, polygons: Sequence[Polygon], rules: HullRules
) -> tuple[HullMemory, list[ConfirmedPolygon]]:
    """Assign identities to the polygons of a time step; return the updated memory and the confirmed polygons.

    Args:
        memory: result of the last time step; `HullMemory()` initially.
        t_ns: time [ns], later than that of the last time step.
        polygons: polygons of this time step.
        rules: when polygons are confirmed and deleted.

    Returns:
        Memory, and confirmed polygons by identity; among them missing ones that had evidence recently.
    """
    old = [k for k in memory.known if t_ns - k.last_ns <= rules.lost_ns]
    current = _identities(old, memory.next_identity, t_ns, polygons, rules)
    seen = [k.identity for k in current]
    gone = [k for k in old if k.identity not in seen]
    newest = max([memory.next_identity, *(i + 1 for i in seen)])
    after = HullMemory(tuple(sorted([*current, *gone], key=lambda k: k.identity)), newest)
    held = [k for k in gone if _lately(k, t_ns, rules) and t_ns - k.last_ns <= rules.hold_ns]
    confirmed = [k for k in _needed(current, t_ns, rules) + held if k.last_ns - k.first_ns >= rules.persist_ns]
    return after, [ConfirmedPolygon(k.identity, k.polygon) for k in sorted(confirmed, key=lambda k: k.identity)]


def evidence(polygons: Sequence[Polygon]) -> list[bool]:
    """Mask of polygons that alone explain at least one of their foreground runs."""
    count: dict[tuple[int, int], int] = {}
    for p in polygons:
        for r in p.runs:
            count[r] = count.get(r, 0) + 1
    return [any(count[r] == 1 for r in p.runs) for p in polygons]


def _identities(
    old: list[TrackedPolygon], fresh: int, t_ns: int, polygons: Sequence[Polygon], rules: HullRules
) -> list[TrackedPolygon]:
    """Give polygons their identities, one to one: that of a nearby known polygon, or a new one.

    Args:
        old: known polygons.
        fresh: next new identity.
        t_ns: time [ns].
        polygons: polygons at this time.
        rules: how far polygons may move.
    """
    centres = np.array([[p.shape.centroid.x, p.shape.centroid.y] for p in polygons]).reshape(-1, 2)
    mine: dict[int, TrackedPolygon] = {}
    if old and len(centres):
        there = np.array([k.centre for k in old])
        away = np.hypot(*(centres[:, None] - there[None]).transpose(2, 0, 1))
        ages = np.array([t_ns - k.last_ns for k in old]) * 1e-9
        rows, columns = assign(away / (rules.reach + rules.speed * ages), 1.0)
        mine = {i: old[j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True)}
    out = []
    for i, (p, centre, sure) in enumerate(zip(polygons, centres, evidence(polygons), strict=True)):
        before = mine.get(i) or TrackedPolygon(fresh, p, centre, t_ns, t_ns, None)
        fresh += i not in mine
        proof = t_ns if sure else before.evidence_ns
        out.append(before._replace(polygon=p, centre=centre, last_ns=t_ns, evidence_ns=proof))
    return out


def _lately(known: TrackedPolygon, t_ns: int, rules: HullRules) -> bool:
    """Whether a polygon had evidence (alone explained a run) within `rules.memory_ns` before `t_ns` [ns]."""
    return known.evidence_ns is not None and t_ns - known.evidence_ns <= rules.memory_ns


def _needed(current: list[TrackedPolygon], t_ns: int, rules: HullRules) -> list[TrackedPolygon]:
    """Select the polygons with recent evidence at `t_ns` [ns], and those that explain the remaining foreground.

    Foreground of a camera is explained by a polygon in its cone. Of the latter, those that explain more of it are
    selected first; equal ones are all selected.

    Args:
        current: tracked polygons.
        t_ns: time [ns].
        rules: how recent evidence has to be.
    """
    chosen = [k for k in current if _lately(k, t_ns, rules)]
    rest = [k for k in current if not _lately(k, t_ns, rules)]
    explained = {r: True for k in chosen for r in k.polygon.runs}
    while True:
        gains = [sum(r not in explained for r in k.polygon.runs) for k in rest]
        most = max(gains, default=0)
        if most == 0:
            return chosen
        taken = [k for k, gain in zip(rest, gains, strict=True) if gain == most]
        chosen += taken
        rest = [k for k, gain in zip(rest, gains, strict=True) if 0 < gain < most]
        explained |= {r: True for k in taken for r in k.polygon.runs}
