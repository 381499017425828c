"""The visual hull of one moment: where objects can be, given the runs of all cameras' scan lines.

A place belongs to the hull if every camera that can see it has a run there (N of N).  For
runs that no such place explains, places count, too, at which up to `misses` of the cameras
have none (N-1 of N): an object that a camera overlooked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from occlog.array_types import Floats

Run = tuple[int, int]
"""A camera's place in the list of looks, and the number of its run."""


class CameraCones(NamedTuple):
    """Evidence of one camera."""

    visible: shapely.Geometry  # where it can tell whether there is an object
    cones: list[shapely.Geometry]  # of its runs


class Polygon(NamedTuple):
    """A part of the hull."""

    shape: shapely.Polygon
    runs: tuple[Run, ...]  # whose cones hold it, rising
    missed: int  # cameras that can see it and have no run there


class _Cell(NamedTuple):
    shape: shapely.Geometry
    runs: tuple[Run, ...]
    missed: int


def hull(looks: Sequence[CameraCones], room: Floats, least: int, misses: int, smallest: float) -> list[Polygon]:
    """The polygons of the hull, in an order that depends on the looks only.

    Args:
        looks: of the cameras, at one time.
        room: (K, 2).
        least: cameras that must have a run at a place.
        misses: cameras that may have none at a place that they can see.
        smallest: polygons of a smaller area are left out.
    """
    # Hull of all cameras (N of N): places that no camera contradicts
    whole = _Cell(shapely.Polygon(room), (), 0)
    found = _polygons(_cells(looks, whole, 0), least, smallest)
    # Runs without such a place: places that one more camera overlooked (N-1 of N)
    for allowed in range(1, misses + 1):
        explained = sorted({r for p in found for r in p.runs})
        missing = [(i, b) for i, look in enumerate(looks) for b in range(len(look.cones)) if (i, b) not in explained]
        if not missing:
            break
        more = _polygons(_cells(looks, whole, allowed), max(least, 2), smallest)
        wanted = [p for p in more if p.missed and any(r in missing for r in p.runs)]
        found += _best(wanted, missing)
    return found


def _best(candidates: list[Polygon], missing: list[Run]) -> list[Polygon]:
    """Choose candidates greedily: the one that explains most missing runs first, while runs are left."""
    left, out = list(missing), []
    for p in sorted(candidates, key=lambda p: (-sum(r in missing for r in p.runs), -p.shape.area, p.runs)):
        if any(r in left for r in p.runs):
            out.append(p)
            left = [r for r in left if r not in p.runs]
    return out


def _cells(looks: Sequence[CameraCones], whole: _Cell, allowed: int) -> list[_Cell]:
    """The room cut up by what the cameras saw, without cells that more cameras than allowed contradict."""
    cells = [whole]
    for i, look in enumerate(looks):
        rest = _union(look.cones)
        off = shapely.difference(look.visible, rest)
        cells = [part for cell in cells for part in _cut(cell, i, look, off, allowed)]
    return cells


def _cut(cell: _Cell, i: int, look: CameraCones, off: shapely.Geometry, allowed: int) -> Iterator[_Cell]:
    shapes = np.array([*look.cones, off, cell.shape], dtype=object)
    meets = shapely.intersects(shapes, cell.shape)
    for b in range(len(look.cones)):
        if meets[b]:
            yield from _kept(shapely.intersection(cell.shape, look.cones[b]), (*cell.runs, (i, b)), cell.missed)
    if cell.missed < allowed and meets[-2]:
        yield from _kept(shapely.intersection(cell.shape, off), cell.runs, cell.missed + 1)
    yield from _kept(shapely.difference(cell.shape, look.visible), cell.runs, cell.missed)


def _kept(shape: shapely.Geometry, runs: tuple[Run, ...], missed: int) -> Iterator[_Cell]:
    if shape.area > 0.0:
        yield _Cell(shape, runs, missed)


def _polygons(cells: list[_Cell], least: int, smallest: float) -> list[Polygon]:
    """Connected parts of the hull; neighbours that differ in who can see them only are one."""
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
    """The polygons of a shape without their holes, left to right."""
    parts = [shapely.Polygon(p.exterior) for p in shapely.get_parts(shape) if p.geom_type == "Polygon"]
    return sorted(parts, key=lambda p: p.bounds)
