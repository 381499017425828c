"""Obstacles of a robot: static occluders and walls of a scene, round obstacles, and tracked people who move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.navigation.forces import ROUNDING, distance
from occlog.core.navigation.obstacles import (
    MovingObstacles,
    MovingObstacleTracks,
    edges,
    least_to_points,
    least_to_segments,
    nearest_on_discs,
    nearest_on_polygons,
    nearest_on_segments,
)
from occlog.core.navigation.steering import NearbyObstacles
from occlog.core.plane import inside_polygon, pack_polygons
from occlog.errors import InputError, option
from occlog.records.scene import Scene
from occlog.scans.occluder_priors import PeopleAsObstacles

from .config import NavigateConfig


class Disc(NamedTuple):
    """Static round obstacle: position and radius [length]; a radius of 0 is a point."""

    x: float
    y: float
    radius: float = 0.0


@dataclass(frozen=True, eq=False)
class Course:
    """All static obstacles of a robot, and moving people.

    Attributes:
        discs: (D, 3) round obstacles x, y, radius.
        polygons: outlines of P static occluders.
        circles: (P, 3) x, y, radius of the circle around each of them.
        walls: (E, 2, 2) sides of the room: ends, coordinates.
        names: names of discs, polygons, walls and people, in this order.
        moving: people; None: none.
        repelling: whether walls repel.
        round_shapes: whether static occluders repel as their circles, instead of by their nearest points.
        bordered: whether distances are from the borders of discs and people, instead of their centres.
        ahead: number of steps for which people are predicted.
    """

    discs: Floats
    polygons: tuple[Floats, ...]
    circles: Floats
    walls: Floats
    names: tuple[str, ...]
    moving: MovingObstacleTracks | None
    repelling: bool
    round_shapes: bool
    bordered: bool
    ahead: float

    def obstacles_at(self, step: int) -> MovingObstacles:
        """People at a step, by its number from 0; empty if there are none."""
        if self.moving is None:
            none, flat = np.empty((0, 2)), np.empty(0)
            return MovingObstacles(none, flat, after=none, radius_after=flat, move=none)
        return self.moving.at(step)

    def around(self, xy: Floats, obstacles: MovingObstacles) -> NearbyObstacles:
        """Nearest points, radii and movements of all obstacles, as seen from robots at positions `xy` (N, 2).

        People are at their nearest predicted positions.
        """
        there = np.isfinite(obstacles.xy[:, 0])
        # People are where they come nearest within the time ahead, on their course of the last step
        soon = obstacles.xy[there] + self.ahead * obstacles.move[there]
        people = nearest_on_segments(xy, np.stack([obstacles.xy[there], soon], axis=1))
        circles, own = self.circles, obstacles.radius[there]
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
        way = np.hypot(obstacles.move[there, 0], obstacles.move[there, 1])
        return NearbyObstacles(
            nearest=np.concatenate(nearest, axis=1),
            radius=np.concatenate([self.discs[:, 2] - core[0], np.zeros(len(circles)), walls, own - core[1]]),
            size=np.concatenate([self.discs[:, 2], circles[:, 2], walls, own]),
            way=np.concatenate([fixed, way]),
        )

    def clearance(self, start: Floats, end: Floats, radius: float, obstacles: MovingObstacles) -> Floats:
        """(N, K) least distance, border to border, of N robots from each obstacle in `names` during a step.

        A robot that runs into a polygon or a wall has minus its radius; infinite for an absent person.

        Args:
            start: (N, 2) positions before the step.
            end: (N, 2) positions after it.
            radius: radius of the robots.
            obstacles: people at the start and the end of the step.
        """
        first = np.where(np.isfinite(obstacles.xy), obstacles.xy, obstacles.after)
        last = np.where(np.isfinite(obstacles.after), obstacles.after, obstacles.xy)
        wide = np.fmax(obstacles.radius, obstacles.radius_after)
        people = least_to_points(start, end, first, last) - wide
        parts = [
            least_to_points(start, end, self.discs[:, :2], self.discs[:, :2]) - self.discs[:, 2],
            *(least_to_segments(start, end, edges(p)).min(axis=1, keepdims=True) for p in self.polygons),
            least_to_segments(start, end, self.walls),
            np.where(np.isfinite(people), people, np.inf),
        ]
        return np.concatenate(parts, axis=1) - radius

    def check_position(self, what: str, xy: Floats, config: NavigateConfig) -> None:
        """InputError unless the robot fits at the position `xy` (2,) without contact.

        `what` is `start` or `goal`, for messages; at the goal people are not considered.
        """
        at = f"the {what} ({xy[0]:g}, {xy[1]:g})"
        here = xy[None]
        for name, polygon in zip(self.names[len(self.discs) :], self.polygons, strict=False):
            if inside_polygon(here, polygon)[0]:
                raise InputError(f"{at} is inside {name}; give a position on the floor")
        if len(self.walls) and not inside_polygon(here, self.walls[:, 0])[0]:
            raise InputError(f"{at} is outside the room; give a position on the floor")
        gaps = self.clearance(here, here, config.radius, self.obstacles_at(0))[0]
        if what == "goal":
            gaps = gaps[: len(gaps) - (0 if self.moving is None else len(self.moving.ids))]
        worst = int(np.argmin(gaps)) if len(gaps) else 0
        if len(gaps) and gaps[worst] <= ROUNDING * config.way:
            away = gaps[worst] + config.radius
            if away < 0.0:
                raise InputError(f"{at} is inside {self.names[worst]}; give a position on the floor")
            raise InputError(
                f"{at} is {away:.4g} from {self.names[worst]}; expected more than the robot's radius "
                f"{config.radius:g}: move it"
            )
        if self.round_shapes and len(self.circles):
            separation = distance(here, self.circles[:, :2]) - self.circles[:, 2]
            if separation.min() <= 0.0:
                name = self.names[len(self.discs) + int(np.argmin(separation))]
                raise InputError(
                    f"{at} is inside the circle about {name}, which repels robots; give {option('shape')} polygon"
                )


def people_of(config: NavigateConfig) -> PeopleAsObstacles:
    """Settings by which people become obstacles: radius, inflation by their covariance, gaps and steps."""
    return PeopleAsObstacles(
        radius=config.obstacle_radius,
        sigmas=config.inflation_sigmas,
        max_gap_s=config.max_gap_s,
        step_s=config.step_s,
        steps=config.max_steps,
    )


def course_of(
    scene: Scene, discs: Sequence[Disc], moving: MovingObstacleTracks | None, config: NavigateConfig
) -> Course:
    """Course of a scene with additional round obstacles and people.

    `moving` are tracks of people; None: none.
    """
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
        ahead=config.prediction_horizon_s / config.step_s,
    )


def _circle(polygon: Floats) -> tuple[float, float, float]:
    """Centre x, y and radius of a circle around a polygon (K, 2), centred on its bounding box."""
    x, y = 0.5 * (polygon.min(axis=0) + polygon.max(axis=0))
    return float(x), float(y), float(distance(polygon, np.array([x, y])).max())
