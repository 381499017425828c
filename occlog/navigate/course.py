"""What a robot meets: static occluders and walls of a scene, round obstacles, and tracked people who move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.navigation.obstacles import (
    edges,
    least_to_points,
    least_to_segments,
    nearest_on_discs,
    nearest_on_polygons,
    nearest_on_segments,
)
from occlog.core.navigation.potentials import distance
from occlog.core.navigation.steering import Around
from occlog.core.numerics.interpolate import interpolate_positions
from occlog.core.plane.polygons import inside_polygon, pack_polygons
from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.records.tables import Tracks, Truth

from .config import NavigateConfig

BLOCK = 256
"""Steps for which the places of moving obstacles are interpolated at a time."""


class Disc(NamedTuple):
    """A round obstacle that stands."""

    x: float
    y: float
    radius: float = 0.0


class Moment(NamedTuple):
    """Moving obstacles at the start and the end of a step; NaN where one is not there."""

    xy: Floats  # (M, 2)
    radius: Floats  # (M,)
    after: Floats  # (M, 2) a step later
    radius_after: Floats  # (M,)
    move: Floats  # (M, 2) how each moved in the step before; 0 where that is not known


class Moving:
    """Tracked people, interpolated at the times of a robot's steps."""

    def __init__(self, tracks: Tracks | Truth, start_ns: int, config: NavigateConfig) -> None:
        """Gather the rows of each track.

        Args:
            tracks: all rows; those of `Truth` have no covariance.
            start_ns: time of the robot's start.
            config: step, radius of people, `sigmas`, gaps that are bridged.
        """
        self.start_ns, self._config, self._first = start_ns, config, -BLOCK
        self.ids = np.unique(tracks.target_id)
        wide = config.obstacle_radius + config.sigmas * _deviation(tracks)
        columns = np.column_stack([tracks.x, tracks.y, wide])
        own = [tracks.target_id == name for name in self.ids.tolist()]
        self._known = [(tracks.t_ns[rows], columns[rows]) for rows in own]
        self._block = np.empty((0, len(own), 3))

    def at(self, step: int) -> Moment:
        """The obstacles at a step; steps are asked for in rising order."""
        if not self._first <= step < self._first + BLOCK:
            self._first = step
            self._block = self._places(np.arange(step - 1, step + BLOCK + 1))
        before, now, after = self._block[step - self._first : step - self._first + 3]
        return Moment(
            xy=now[:, :2],
            radius=now[:, 2],
            after=after[:, :2],
            radius_after=after[:, 2],
            move=np.nan_to_num(now[:, :2] - before[:, :2]),
        )

    def _places(self, steps: Ints) -> Floats:
        """(T, M, 3) x, y and radius of all obstacles at steps."""
        t_ns = self.start_ns + np.rint(steps * (self._config.step_s * NS)).astype(np.int64)
        limit_ns = round(self._config.max_gap_s * NS)
        places = [interpolate_positions(t_ns, known, columns, limit_ns)[0] for known, columns in self._known]
        return np.stack(places, axis=1) if places else np.empty((len(steps), 0, 3))


def _deviation(tracks: Tracks | Truth) -> Floats:
    """(R,) standard deviation along the widest axis of each row's covariance."""
    if isinstance(tracks, Truth):
        return np.zeros(len(tracks))
    middle, half = 0.5 * (tracks.cov_xx + tracks.cov_yy), 0.5 * (tracks.cov_xx - tracks.cov_yy)
    return np.asarray(np.sqrt(np.maximum(middle + np.hypot(half, tracks.cov_xy), 0.0)))


@dataclass(frozen=True, eq=False)
class Course:
    """Everything that stands in a robot's way, and the people who move there.

    Attributes:
        discs: (D, 3) round obstacles x, y, radius.
        polygons: static occluders.
        circles: (P, 3) the circle about each of them.
        walls: (E, 2, 2) sides of the room.
        names: of discs, polygons, walls and moving obstacles, in this order.
        moving: people; None: nobody moves.
        repelling: whether walls repel.
        round_shapes: whether the circles repel, and not the polygons' nearest points.
        bordered: whether distances are from the borders of discs and people, and not from their centres.
        ahead: steps for which people are thought to go on.
    """

    discs: Floats
    polygons: tuple[Floats, ...]
    circles: Floats
    walls: Floats
    names: tuple[str, ...]
    moving: Moving | None
    repelling: bool
    round_shapes: bool
    bordered: bool
    ahead: float

    def moment(self, step: int) -> Moment:
        """Moving obstacles at a step; none if nobody moves."""
        if self.moving is None:
            none, flat = np.empty((0, 2)), np.empty(0)
            return Moment(none, flat, after=none, radius_after=flat, move=none)
        return self.moving.at(step)

    def around(self, xy: Floats, moment: Moment) -> Around:
        """Obstacles as robots at (N, 2) places meet them."""
        there = np.isfinite(moment.xy[:, 0])
        # People are where they come nearest within the time ahead, on the way they have taken in the last step
        soon = moment.xy[there] + self.ahead * moment.move[there]
        people = nearest_on_segments(xy, np.stack([moment.xy[there], soon], axis=1))
        circles, own = self.circles, moment.radius[there]
        core = self.discs[:, 2] * self.bordered, own * self.bordered
        nearest = [
            nearest_on_discs(xy, self.discs[:, :2], core[0]),
            nearest_on_discs(xy, circles[:, :2], circles[:, 2])
            if self.round_shapes
            else nearest_on_polygons(xy, *pack_polygons(self.polygons)),
            nearest_on_segments(xy, self.walls if self.repelling else self.walls[:0]),
            nearest_on_discs(xy, people, core[1]),
        ]
        walls = np.zeros(nearest[2].shape[1])
        fixed = np.zeros(nearest[0].shape[1] + nearest[1].shape[1] + len(walls))
        way = np.hypot(moment.move[there, 0], moment.move[there, 1])
        return Around(
            nearest=np.concatenate(nearest, axis=1),
            radius=np.concatenate([self.discs[:, 2] - core[0], np.zeros(len(circles)), walls, own - core[1]]),
            size=np.concatenate([self.discs[:, 2], circles[:, 2], walls, own]),
            way=np.concatenate([fixed, way]),
        )

    def clearance(self, start: Floats, end: Floats, radius: float, moment: Moment) -> Floats:
        """(N, K) least distance, border to border, of robots from each obstacle in `names` during a step.

        A robot that runs into a polygon or a wall has minus its radius; infinite where a person is not there.

        Args:
            start: (N, 2) places before the step.
            end: (N, 2) places after it.
            radius: of the robots.
            moment: people at the start and the end of the step.
        """
        first = np.where(np.isfinite(moment.xy), moment.xy, moment.after)
        last = np.where(np.isfinite(moment.after), moment.after, moment.xy)
        wide = np.fmax(moment.radius, moment.radius_after)
        people = least_to_points(start, end, first, last) - wide
        parts = [
            least_to_points(start, end, self.discs[:, :2], self.discs[:, :2]) - self.discs[:, 2],
            *(least_to_segments(start, end, edges(p)).min(axis=1, keepdims=True) for p in self.polygons),
            least_to_segments(start, end, self.walls),
            np.where(np.isfinite(people), people, np.inf),
        ]
        return np.concatenate(parts, axis=1) - radius

    def check_place(self, what: str, xy: Floats, config: NavigateConfig) -> None:
        """InputError unless a robot can be at a (2,) place, the start or the goal."""
        at = f"the {what} ({xy[0]:g}, {xy[1]:g})"
        here = xy[None]
        for name, polygon in zip(self.names[len(self.discs) :], self.polygons, strict=False):
            if inside_polygon(here, polygon)[0]:
                raise InputError(f"{at} is inside {name}; give a place on the floor")
        if len(self.walls) and not inside_polygon(here, self.walls[:, 0])[0]:
            raise InputError(f"{at} is outside the room; give a place on the floor")
        gaps = self.clearance(here, here, config.radius, self.moment(0))[0]
        if what == "goal":
            gaps = gaps[: len(gaps) - (0 if self.moving is None else len(self.moving.ids))]
        if len(gaps) and (worst := int(np.argmin(gaps))) >= 0 and gaps[worst] < 0.0:
            away = gaps[worst] + config.radius
            if away < 0.0:
                raise InputError(f"{at} is inside {self.names[worst]}; give a place on the floor")
            raise InputError(
                f"{at} is {away:.4g} from {self.names[worst]}, nearer than the robot's radius {config.radius:g}"
            )
        if self.round_shapes and len(self.circles):
            apart = distance(here, self.circles[:, :2]) - self.circles[:, 2]
            if apart.min() <= 0.0:
                name = self.names[len(self.discs) + int(np.argmin(apart))]
                raise InputError(f"{at} is inside the circle about {name}, which repels robots; take shape polygon")


def course_of(scene: Scene, discs: Sequence[Disc], moving: Moving | None, config: NavigateConfig) -> Course:
    """The course of a scene with further round obstacles and people."""
    polygons = tuple(o.polygon for o in scene.occluders)
    walls = np.empty((0, 2, 2)) if scene.room is None else edges(scene.room)
    names = [f"obstacle {n + 1}" for n in range(len(discs))]
    names += [f"static occluder {o.name}" for o in scene.occluders]
    names += [f"wall {n + 1}" for n in range(len(walls))]
    names += [] if moving is None else [f"person {name}" for name in moving.ids.tolist()]
    return Course(
        discs=np.array(discs, dtype=np.float64).reshape(-1, 3),
        polygons=polygons,
        circles=np.array([_circle(p) for p in polygons]).reshape(-1, 3),
        walls=walls,
        names=tuple(names),
        moving=moving,
        repelling=config.walls,
        round_shapes=config.shape == "circle",
        bordered=config.origin == "border",
        ahead=config.ahead_s / config.step_s,
    )


def _circle(polygon: Floats) -> tuple[float, float, float]:
    """Centre and radius of a circle about a (K, 2) polygon, about the middle of its bounding box."""
    x, y = 0.5 * (polygon.min(axis=0) + polygon.max(axis=0))
    return float(x), float(y), float(distance(polygon, np.array([x, y])).max())
