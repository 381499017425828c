"""Floor plan next to the images, and tracks in the world drawn into the images of cameras with poses."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import cv2
import numpy as np

from occlog.array_types import NS, Bytes, Floats
from occlog.errors import InputError
from occlog.examine.viewers.drawings.people import (
    DiagnosticsDrawing,
    Palette,
    PeopleDrawing,
    PersonEstimate,
    body_in_image,
    corners,
    feet_in_image,
    name_of,
    people_of,
)
from occlog.examine.viewers.drawings.shapes import rim
from occlog.examine.viewers.drawings.world import placed
from occlog.examine.viewers.inputs import chunks_of_equal_time
from occlog.io.open import check_unit, open_input
from occlog.records.columns import ColumnTable
from occlog.records.declared.people import PeopleTracks
from occlog.records.declared.views import ViewTracks
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Diagnostics, Tracks, Truth, whole_times
from occlog.track.methods.images.initiation.births import anchors

from .draw import WHITE, Box, LineDrawing, bar, colour_of, draw_way, label

GROUND, FLOOR, WALL, PILLAR = (24, 24, 24), (44, 42, 40), (170, 165, 160), (96, 92, 88)
MARGIN = 0.06
"""Margin of the floor plan around the drawing, as a share of its size."""
MARK = 7.0
"""Size of a camera's mark [px]."""


class PlanRenderer:
    """Draws the plan of a scene in pictures of one size."""

    def __init__(
        self, scene: Scene, shown: Floats, metres: float, size: tuple[int, int], ranks: Mapping[int, int]
    ) -> None:
        """Draw the static parts: floor, walls, occluders, sensors.

        Args:
            scene: room, occluders and sensors.
            shown: (K, 2) points that the plan must contain, in the scene's unit, in addition to the sensors.
            metres: metres per unit of length.
            size: width and height of the picture without its title bar [px].
            ranks: index of the colour of each target.
        """
        self._ranks, self._metres = ranks, metres
        everything = metres * np.vstack([shown, *(sensor.position[:2] for sensor in placed(scene))])
        low, high = everything.min(axis=0), everything.max(axis=0)
        free = (1.0 - 2.0 * MARGIN) * np.array(size)
        self._scale = float((free / np.maximum(high - low, 1e-9)).min())
        self._middle, self._centre = 0.5 * (low + high), 0.5 * np.array(size) - 0.5
        self._sensors = {sensor.name: self._at(metres * sensor.position[:2]) for sensor in placed(scene)}
        self._still, self._names = self._draw_still(scene, size)

    def draw(self, crowd: PeopleDrawing, truth: Sequence[Floats], t_ns: int, seconds: float) -> Bytes:
        """Return the picture (BAR + height, width, 3), BGR, of the plan at a time, under a bar with the elapsed time.

        Args:
            crowd: estimates with trails.
            truth: (2,) true positions [m].
            t_ns: the time [ns].
            seconds: time since the start [s].
        """
        picture, taken = self._still.copy(), list(self._names)
        people = crowd.at(t_ns)
        for person in people:
            self._draw_sight(picture, person)
        for person in people:
            colour = colour_of(self._ranks.get(person.target, person.target))
            trail = crowd.trail(person.target)
            if len(trail) > 1:
                draw_way(picture, LineDrawing(self._at(trail), person.target, 1), 1.0, colour)
            if np.isfinite(person.covariance).all():
                ring = self._at(rim(person.xy, person.covariance))
                draw_way(picture, LineDrawing(ring, person.target, 2, person.unsure), 1.0, colour)
        for position in truth:
            cv2.drawMarker(picture, _pixel(self._at(position)), WHITE, cv2.MARKER_TILTED_CROSS, 9, 1, cv2.LINE_AA)
        for person in people:
            colour = colour_of(self._ranks.get(person.target, person.target))
            x, y = self._at(person.xy).tolist()
            cv2.circle(picture, _pixel(self._at(person.xy)), 4, colour, cv2.FILLED, cv2.LINE_AA)
            label(picture, name_of(person), (x, y - 8), colour, taken)
        return np.vstack([bar(f"plan   {seconds:.1f} s", picture.shape[1]), picture])

    def _draw_sight(self, picture: Bytes, person: PersonEstimate) -> None:
        colour = colour_of(self._ranks.get(person.target, person.target))
        dim = tuple(round(0.45 * c + 0.55 * g) for c, g in zip(colour, FLOOR, strict=True))
        for name in sorted(person.seen_by or ()):
            if name in self._sensors:
                ends = np.array([self._sensors[name], self._at(person.xy)])
                draw_way(picture, LineDrawing(ends, person.target, 1), 1.0, (dim[0], dim[1], dim[2]))

    def _at(self, points: Floats) -> Floats:
        """Convert positions [m] to pixels of the plan; y points up."""
        return np.asarray(self._centre + self._scale * (points - self._middle) * [1.0, -1.0])

    def _draw_still(self, scene: Scene, size: tuple[int, int]) -> tuple[Bytes, list[Box]]:
        """Return the picture (height, width, 3) of floor, occluders and sensors, and the boxes of the sensors' names.

        `size`: width and height [px].
        """
        picture = np.full((size[1], size[0], 3), GROUND, dtype=np.uint8)
        shapes = [(scene.room, FLOOR)] if scene.room is not None else []
        shapes += [(occluder.polygon, PILLAR) for occluder in scene.occluders]
        for polygon, colour in shapes:
            corners = np.rint(self._at(self._metres * polygon)).astype(np.int32)[:, None]
            cv2.fillPoly(picture, [corners], colour, cv2.LINE_AA)
            cv2.polylines(picture, [corners], True, WALL, 1, cv2.LINE_AA)
        taken: list[Box] = []
        for sensor in placed(scene):
            at = self._sensors[sensor.name]
            if isinstance(sensor, Camera):
                corners = np.rint(at + _mark(sensor.yaw)).astype(np.int32)[:, None]
                cv2.fillPoly(picture, [corners], WALL, cv2.LINE_AA)
            else:
                cv2.circle(picture, _pixel(at), 4, WALL, cv2.FILLED, cv2.LINE_AA)
            label(picture, sensor.name, (float(at[0]), float(at[1]) - 6), FLOOR, taken)
        return picture, taken


def _mark(yaw: float) -> Floats:
    """Return the corners (3, 2) [px] of the triangle that marks a camera, relative to its position.

    It opens in the direction `yaw` [rad] in the world; y of pixels points down.
    """
    c, s = math.cos(yaw), -math.sin(yaw)
    ahead, aside = np.array([c, s]), np.array([-s, c])
    return MARK * np.array([0.0 * ahead, ahead + 0.6 * aside, ahead - 0.6 * aside])


def _pixel(at: Floats) -> tuple[int, int]:
    return round(float(at[0])), round(float(at[1]))


T = TypeVar("T", bound=ColumnTable)


class Latest(Generic[T]):
    """Reads a table once, in the order of time, and hands out the rows of one time after another."""

    def __init__(self, path: Path, table: type[T], unit: str | None) -> None:
        """Open the table; InputError if its lengths are in another unit than `unit` (None: any)."""
        opened = open_input(path)
        if unit is not None:
            check_unit(opened, unit, "the scene", InputError)
        self._pieces: Iterator[T] = (
            piece for rows in whole_times(opened.rows(table)) for piece in chunks_of_equal_time(rows)
        )
        self._next = next(self._pieces, None)
        self.used = 0

    def until(self, t_ns: int) -> Iterator[T]:
        """Generate the rows of each time since the last call, up to `t_ns`."""
        while self._next is not None and int(self._next.t_ns[0]) <= t_ns:  # type: ignore[attr-defined]
            piece, self._next = self._next, next(self._pieces, None)
            self.used += len(piece)
            yield piece


class OverlayTables(NamedTuple):
    """Files with tracks on the ground, filter diagnostics, and true positions (None: missing).

    `unit`: required unit of their lengths; None: any.
    """

    tracks: Path
    diagnostics: Path | None = None
    truth: Path | None = None
    unit: str | None = None


class GroundTrackPositions:
    """Positions of targets on the ground, and true ones, at frame times, which must not decrease."""

    def __init__(self, sources: OverlayTables, metres: float, ranks: Mapping[int, int], trail_s: float) -> None:
        """Open the tables.

        Args:
            sources: tracks, and diagnostics and truth if there are any.
            metres: metres per unit of length.
            ranks: index of the colour of each target.
            trail_s: length of trails [s].
        """
        tracks, diagnostics, truth, unit = sources
        self._tracks = Latest(tracks, PeopleTracks, unit)
        self._diagnostics = None if diagnostics is None else Latest(diagnostics, Diagnostics, unit)
        self._diagnostics_drawing = DiagnosticsDrawing()
        self._truth = Latest(truth, Truth, unit) if truth is not None and open_input(truth).has(Truth) else None
        self._metres, self._trail_ns = metres, round(trail_s * NS)
        self.crowd = PeopleDrawing(Palette(ranks), self._trail_ns)
        self.true: list[Floats] = []

    @property
    def used(self) -> int:
        """Number of rows of tracks used so far."""
        return self._tracks.used

    def move(self, t_ns: int) -> None:
        """Read the tables up to the time `t_ns` [ns], which must not decrease."""
        for diagnostics in self._diagnostics.until(t_ns) if self._diagnostics is not None else ():
            self._diagnostics_drawing.add(diagnostics)
        for rows in self._tracks.until(t_ns):
            self.crowd.add(people_of(rows, self._metres, self._diagnostics_drawing))
        for true in self._truth.until(t_ns) if self._truth is not None else ():
            own = true.role == "target"
            self.true = list(self._metres * np.column_stack([true.x[own], true.y[own]]))

    def ways(self, camera: Camera, t_ns: int) -> list[LineDrawing]:
        """Return body outlines, ellipses on the floor and trails of all targets, projected into a camera's image [px].

        Outlines and ellipses are dashed if the target is uncertain, or not detected by the camera. `t_ns`: the time
        [ns].
        """
        out = []
        for person in self.crowd.at(t_ns):
            box = body_in_image(person, camera, self._metres)
            if box is None:
                continue
            unseen = person.unsure or (person.seen_by is not None and camera.name not in person.seen_by)
            out.append(LineDrawing(corners(box), person.target, 2, unseen, name_of(person)))
            feet = feet_in_image(person, camera, self._metres)
            if feet is not None:
                out.append(LineDrawing(feet, person.target, 1, unseen))
            trail = self.crowd.trail(person.target)
            if camera.above_floor and len(trail) > 1:
                floor = np.column_stack([trail, np.full(len(trail), person.floor)])
                pixels = camera.project(floor / self._metres)
                if np.isfinite(pixels).all():
                    out.append(LineDrawing(pixels, person.target, 1))
        return out


class Trails:
    """Trails of targets' feet (lowest points of their ellipses) in the images of one camera."""

    def __init__(self, trail_s: float) -> None:
        """Create trails of the last `trail_s` seconds, without targets."""
        self._keep_ns = round(trail_s * NS)
        self._positions: dict[int, deque[tuple[int, Floats]]] = {}

    def ways(self, rows: ViewTracks, t_ns: int) -> list[LineDrawing]:
        """Add the rows of a frame at the time `t_ns` [ns]; return the trails of the targets in it."""
        ellipses = np.column_stack([rows.x_px, rows.y_px, rows.a_px, rows.b_px, rows.rho])
        for target, foot in zip(rows.target_id.tolist(), anchors(ellipses, True), strict=True):
            self._positions.setdefault(target, deque()).append((t_ns, foot))
        out = []
        for target, positions in list(self._positions.items()):
            while positions and positions[0][0] < t_ns - self._keep_ns:
                positions.popleft()
            if not positions:
                del self._positions[target]
            elif len(positions) > 1 and positions[-1][0] == t_ns:
                out.append(LineDrawing(np.array([position for _, position in positions]), target, 1))
        return out


def targets_of(paths: Mapping[Path, type[Tracks] | type[ViewTracks]]) -> dict[int, int]:
    """Return the rank of each target identity among all identities of some tables, by a pass over their rows.

    `paths`: type of the table by file.
    """
    found = (rows for path, table in paths.items() for rows in open_input(path).rows(table))
    names = {target for rows in found for target in np.unique(rows.target_id).tolist()}
    return {target: rank for rank, target in enumerate(sorted(names))}


def extent_of(tracks: Path) -> Floats:
    """Return lower and upper corner (2, 2) of the ground positions within three standard deviations of their mean.

    Shape (0, 2) if the table has no rows.
    """
    total, squares, count = np.zeros(2), np.zeros(2), 0
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for rows in open_input(tracks).rows(Tracks):
        xy = np.column_stack([rows.x, rows.y])
        low, high = np.minimum(low, xy.min(axis=0, initial=np.inf)), np.maximum(high, xy.max(axis=0, initial=-np.inf))
        total, squares, count = total + xy.sum(axis=0), squares + (xy**2).sum(axis=0), count + len(xy)
    if not count:
        return np.zeros((0, 2))
    mean = total / count
    spread = 3.0 * np.sqrt(np.maximum(squares / count - mean**2, 0.0))
    return np.vstack([np.maximum(low, mean - spread), np.minimum(high, mean + spread)])
