"""Run of `occlog navigate`: scene, tracks and places in; path, picture and summary out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from occlog import console
from occlog.io.files.atomic import Together, open_output
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import load_scene, open_input
from occlog.records.tables import RobotPath, Tracks, Truth
from occlog.scans.moving_people import moving_people
from occlog.settings import configure
from occlog.simulate.config import START_NS

from .config import NavigateConfig
from .course import Course, Disc, course_of, people_of
from .rows import PathRows
from .stage import Drive, drive
from .verdict import Verdict

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene


@dataclass(frozen=True)
class NavigateRequest:
    """What is asked for.

    Attributes:
        scene: file with the scene.
        start, goal: x, y.
        discs: round obstacles besides those of the scene.
        obstacles: file with tracks, or with the truth, of people who move; None: nobody moves.
        start_s: when the robot starts, after the first row of the tracks [s].
        output: the path.
        picture: PNG of the path; None: none.
        overwrite: whether outputs may be replaced.
    """

    scene: Path
    start: tuple[float, float]
    goal: tuple[float, float]
    discs: tuple[Disc, ...]
    obstacles: Path | None
    start_s: float
    output: Path
    picture: Path | None
    overwrite: bool

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        return [path for path in (self.scene, self.obstacles) if path is not None]


def run_navigate(
    request: NavigateRequest, values: Mapping[str, object], *, quiet: bool
) -> tuple[dict[str, object], tuple[Loss, ...], bool]:
    """Drive the robot and write its path; the summary, what was lost before, and whether the goal was reached."""
    scene = load_scene(request.scene, None, request.scene)
    config = configure(NavigateConfig.in_unit(scene.length_unit), values)
    opened = None if request.obstacles is None else open_input(request.obstacles, Tracks, Truth)
    moving = None if opened is None else moving_people(opened, scene.length_unit, request.start_s, people_of(config))
    course = course_of(scene, request.discs, moving, config)
    for what, place in (("start", request.start), ("goal", request.goal)):
        course.check_place(what, np.array(place), config)
    parameters = asdict(config) | {
        "start": list(request.start),
        "goal": list(request.goal),
        "discs": [list(d) for d in request.discs],
        "start_s": request.start_s,
    }
    losses = () if opened is None else opened.losses
    provenance = Provenance("navigate", parameters, None, hash_inputs(request.inputs), losses)
    robots, goal = Drive.at(np.array([request.start])), np.array([request.goal])
    start_ns = START_NS if moving is None else moving.clock.start_ns
    rows = PathRows(course.names, start_ns, config.step_s)
    steps = console.progress(drive(robots, goal, course, config), "navigate", quiet=quiet)
    unit = scene.length_unit
    kept: list[RobotPath] = []
    with (
        Together() as together,
        TableWriter(
            request.output, RobotPath, provenance, overwrite=request.overwrite, length_unit=unit, together=together
        ) as writer,
    ):
        for part in rows.tables(steps):
            writer.write(part)
            kept += [part] if request.picture is not None else []
        verdict = Verdict(robots, 0, goal[0], course.names, config)
        if request.picture is not None:
            path = RobotPath.concat(kept)
            with open_output(request.picture, request.overwrite, together) as file:
                file.write(_picture(scene, course, path, request, config, verdict))
    if verdict.warning():
        console.note(f"warning: {verdict.warning()}", quiet)
    summary: dict[str, object] = {"path": str(request.output)}
    summary |= {} if request.picture is None else {"picture": str(request.picture)}
    return {**summary, **verdict.figures()}, losses, verdict.reached


def _picture(
    scene: Scene, course: Course, path: RobotPath, request: NavigateRequest, config: NavigateConfig, verdict: Verdict
) -> bytes:
    """PNG of the path in the scene."""
    from .picture import PathPicture, path_png

    goal = np.array(request.goal)
    return path_png(PathPicture(scene=scene, course=course, path=path, goal=goal, config=config, end=verdict.words()))
