"""Run of `occlog navigate`: scene, tracks and places in; path, picture and summary out."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from occlog.errors import UsageError, option
from occlog.io.open import load_scene, open_input
from occlog.records.tables import RobotPath, Tracks, Truth
from occlog.runner import Job
from occlog.scans.moving_people import moving_people
from occlog.settings import configure
from occlog.simulate.config import START_NS

from .config import NavigateConfig
from .course import Course, Disc, course_of, people_of
from .request import NavigateRequest
from .rows import PathRows
from .stage import Drive, drive
from .verdict import Verdict

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene


def run_navigate(request: NavigateRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Drive the robot and write its path; the summary, and what was lost before."""
    if request.after and request.obstacles is None:
        raise UsageError(f"{option('after')} is a time of {option('obstacles')}; add them")
    discs = tuple(map(disc_of, request.discs))
    scene = load_scene(request.scene, None, request.scene)
    config = configure(NavigateConfig.in_unit(scene.length_unit), request.settings)
    opened = None if request.obstacles is None else open_input(request.obstacles, Tracks, Truth)
    moving = None if opened is None else moving_people(opened, scene.length_unit, request.after, people_of(config))
    course = course_of(scene, discs, moving, config)
    for what, place in (("start", request.start), ("goal", request.goal)):
        course.check_place(what, np.array(place), config)
    parameters = asdict(config) | {
        "start": list(request.start),
        "goal": list(request.goal),
        "discs": [list(d) for d in discs],
        "start_s": request.after,
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
        verdict = Verdict(robots, 0, goal[0], course.names, config)
        if request.picture is not None:
            drawn = _picture(scene, course, RobotPath.concat(kept), request, config, verdict)
            tables.write_bytes("picture", drawn)
    if verdict.warning():
        job.note(f"warning: {verdict.warning()}")
    summary: dict[str, object] = {"path": str(request.output)}
    summary |= {} if request.picture is None else {"picture": str(request.picture)}
    return {**summary, **verdict.figures()}, losses


def disc_of(text: str) -> Disc:
    """The round obstacle of a text `X,Y` or `X,Y,RADIUS`; UsageError where it is none."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not 2 <= len(numbers) <= 3 or not all(map(math.isfinite, numbers)):
        raise UsageError(f"{option('obstacle')} {text}: want X,Y or X,Y,RADIUS")
    if len(numbers) > 2 and numbers[2] < 0.0:
        raise UsageError(f"{option('obstacle')} {text}: the radius must be at least 0")
    return Disc(*numbers)


def _picture(
    scene: Scene, course: Course, path: RobotPath, request: NavigateRequest, config: NavigateConfig, verdict: Verdict
) -> bytes:
    """PNG of the path in the scene."""
    from .picture import PathPicture, path_png

    goal = np.array(request.goal)
    return path_png(PathPicture(scene=scene, course=course, path=path, goal=goal, config=config, end=verdict.words()))
