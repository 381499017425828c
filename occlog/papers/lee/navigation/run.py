"""Run of `occlog navigate`: scene, tracks and positions in; path, picture and summary out.

How a robot fared, in figures and in words.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from occlog.array_types import Floats
from occlog.core.navigation.forces import distance
from occlog.core.navigation.steering import STATES, SteeringState
from occlog.errors import UsageError, option
from occlog.io.files.limits import naming
from occlog.io.open import load_scene, open_input
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import RobotPath, Tracks, Truth
from occlog.runner import Job
from occlog.scans.occluder_priors import moving_people
from occlog.settings import configure
from occlog.simulate.config import START_NS

from .config import NavigateConfig
from .obstacle_course import Course, Disc, course_of, people_of
from .request import NavigateRequest
from .stage import Drive, End, PathRows, drive


class RobotVerdict:
    """Outcome of one robot of a drive, with words, remedy and figures for the summary."""

    def __init__(self, robots: Drive, number: int, goal: Floats, names: Sequence[str], config: NavigateConfig) -> None:
        """Judge a robot when the drive is over.

        Args:
            robots: outcomes of all robots of the drive.
            number: index of the robot.
            goal: (2,) its goal.
            names: names of the obstacles.
            config: settings of the drive.
        """
        self.end = End(int(robots.end[number]))
        self._steps, self._config = int(robots.steps[number]), config
        self._states, self._length = robots.states[number], float(robots.length[number])
        self._recognised = int(robots.recognised[number])
        self._stays = self.end == End.ENDLESS or bool(robots.caught[number])
        self._prevented = bool(robots.prevented[number])
        self._clearance = float(robots.clearance[number])
        self._nearest = names[int(robots.nearest[number])] if robots.nearest[number] >= 0 else ""
        self._left = float(distance(robots.xy[number], goal))
        x, y = robots.xy[number]
        self._at = f"({x:.4g}, {y:.4g})"

    @property
    def reached(self) -> bool:
        """Whether the robot reached its goal without a collision."""
        return self.end == End.REACHED

    @property
    def trap(self) -> bool:
        """Whether forces, or the collision guard, hold the robot in place without oscillation prevention."""
        return self._stays and not self._prevented

    def words(self) -> str:
        """How the path ended, in words."""
        if self.end == End.REACHED:
            return "goal reached"
        if self.end == End.COLLIDED:
            return f"collided with {self._nearest} in step {self._steps}"
        if self._stays and self._states[SteeringState.GUARDED]:
            return f"caught at {self._at} before {self._nearest}, where the guard holds it back"
        if self.trap:
            return f"caught at {self._at}, where goal and obstacles pull and push equally (a local minimum)"
        if self._stays:
            return f"oscillates for ever before {self._nearest}, at {self._at}"
        return f"all {self._steps} steps done, {self._left:.4g} from the goal"

    def warning(self) -> str:
        """A line about a goal that was not reached, with a remedy; empty if it was."""
        if self.reached:
            return ""
        return f"the robot did not reach its goal: {self.words()}; {self._remedy()}"

    def _remedy(self) -> str:
        """What the user may change so that the robot reaches its goal, in words."""
        if self.end == End.COLLIDED:
            return (
                "take "
                + ("" if self._config.collision_guard else "the guard, ")
                + "shorter steps or a larger repulsion"
            )
        if self.trap:
            return "take a smaller influence or repulsion, or intermediate goals"
        if self._stays:
            return "take escape inside" if self._config.escape != "inside" else "take intermediate goals"
        return "take more steps"

    def figures(self) -> dict[str, object]:
        """Figures of the summary by name.

        reached: without a collision.  length: of the path, without steps that the guard skipped.
        least_clearance: from obstacles, border to border, also between steps; None without obstacles.
        oscillation: whether it was recognised at any step.  trap: a local minimum, or the guard, holds the robot.
        states: numbers of steps by what determined them.
        """
        return {
            "reached": self.reached,
            "end": self.words(),
            "steps": self._steps,
            "seconds": self._steps * self._config.step_s,
            "length": self._length,
            "to_goal": self._left,
            "least_clearance": self._clearance if math.isfinite(self._clearance) else None,
            "nearest": self._nearest,
            "collision": self.end == End.COLLIDED,
            "oscillation": self._recognised > 0,
            "oscillating_steps": self._recognised,
            "trap": self.trap,
            "states": {name: int(n) for name, n in zip(STATES, self._states, strict=True) if n},
        }


def run_navigate(request: NavigateRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Drive the robot and write its path and picture; return the summary, and the losses of the tracks of people.

    UsageError for a start delay without people; InputError if the robot does not fit at start or goal.
    """
    if request.start_delay_s and request.obstacles is None:
        raise UsageError(
            f"{option('start_delay')} counts from the first row of {option('obstacles')}; give that too",
            id="missing-option",
        )
    discs = tuple(map(disc_of, request.disc_obstacles))
    scene = load_scene(request.scene, None, request.scene)
    config = configure(NavigateConfig.in_unit(scene.length_unit), request.settings)
    opened = None if request.obstacles is None else open_input(request.obstacles, Tracks, Truth)
    moving = (
        None if opened is None else moving_people(opened, scene.length_unit, request.start_delay_s, people_of(config))
    )
    course = course_of(scene, discs, moving, config)
    with naming(request.scene):
        for what, position in (("start", request.start), ("goal", request.goal)):
            course.check_position(what, np.array(position), config)
    parameters = asdict(config) | {
        "start": list(request.start),
        "goal": list(request.goal),
        "disc_obstacles": [list(d) for d in discs],
        "start_s": request.start_delay_s,
    }
    losses = () if opened is None else opened.losses
    robots, goal = Drive.at(np.array([request.start])), np.array([request.goal])
    start_ns = START_NS if moving is None else moving.clock.start_ns
    rows = PathRows(course.names, start_ns, config.step_s)
    steps = job.progress(drive(robots, goal, course, config), "navigate")
    kept: list[RobotPath] = []
    with job.tables(job.provenance(parameters, losses), scene.length_unit) as tables:
        for part in rows.tables(steps):
            tables.write(output=part)
            kept += [part] if request.picture is not None else []
        verdict = RobotVerdict(robots, 0, goal[0], course.names, config)
        if request.picture is not None:
            drawn = _picture(scene, course, RobotPath.concat(kept), request, config, verdict)
            tables.write_bytes("picture", drawn)
    if verdict.warning():
        job.note(f"warning: {verdict.warning()}")
    summary: dict[str, object] = {"path": str(request.output)}
    summary |= {} if request.picture is None else {"picture": str(request.picture)}
    return {**summary, **verdict.figures()}, losses


def disc_of(text: str) -> Disc:
    """Parse `X,Y` or `X,Y,RADIUS` to a round obstacle; UsageError for other texts."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not 2 <= len(numbers) <= 3 or not all(map(math.isfinite, numbers)):
        raise UsageError(f"{option('obstacle')} {text}: expected X,Y or X,Y,RADIUS")
    if len(numbers) > 2 and numbers[2] < 0.0:
        raise UsageError(f"{option('obstacle')} {text}: the radius must be at least 0")
    return Disc(*numbers)


def _picture(
    scene: Scene,
    course: Course,
    path: RobotPath,
    request: NavigateRequest,
    config: NavigateConfig,
    verdict: RobotVerdict,
) -> bytes:
    """PNG of the path in the scene, with the words of its `verdict`."""
    from .picture import PathPicture, path_png

    goal = np.array(request.goal)
    return path_png(PathPicture(scene=scene, course=course, path=path, goal=goal, config=config, end=verdict.words()))
