"""Run of `occlog navigate`: scene, tracks and places in; path, picture and summary out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from occlog.array_types import NS
from occlog.cli import options
from occlog.errors import InputError
from occlog.io.files.atomic import Together, open_output
from occlog.io.files.parquet import TableWriter
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.open import Opened, check_unit, open_input
from occlog.records.tables import RobotPath, Tracks, Truth
from occlog.settings import configure

from .config import NavigateConfig
from .course import Course, Disc, Moving, course_of
from .rows import PathRows
from .stage import Drive, drive
from .verdict import Verdict

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene

T = TypeVar("T", Tracks, Truth)
START_NS = 1_577_836_800_000_000_000
"""Time of the first row where there are no tracks: 2020-01-01T00:00:00Z."""


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
    scene = options.load_scene(request.scene, None, request.scene)
    config = configure(NavigateConfig.in_unit(scene.length_unit), values)
    opened = None if request.obstacles is None else open_input(request.obstacles, Tracks, Truth)
    moving = None if opened is None else _moving(opened, scene, request.start_s, config)
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
    start_ns = START_NS if moving is None else moving.start_ns
    rows = PathRows(course.names, start_ns, config.step_s)
    steps = options.progress(drive(robots, goal, course, config), "navigate", quiet=quiet)
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
        options.note(f"warning: {verdict.warning()}", quiet)
    summary: dict[str, object] = {"path": str(request.output)}
    summary |= {} if request.picture is None else {"picture": str(request.picture)}
    return {**summary, **verdict.figures()}, losses, verdict.reached


def _moving(opened: Opened, scene: Scene, start_s: float, config: NavigateConfig) -> Moving:
    """People of a file, from the robot's start to its last possible step; InputError where there are none."""
    if opened.recording is not None or opened.made_in_a_scene:
        check_unit(opened, scene.length_unit, error=InputError)
    gap_ns, most_ns = round(config.max_gap_s * NS), round((config.steps + 1) * config.step_s * NS)
    after_ns = round(start_s * NS)
    start_ns, rows = (
        _between(opened, Tracks, after_ns, gap_ns, most_ns)
        if opened.has(Tracks)
        else _between(opened, Truth, after_ns, gap_ns, most_ns)
    )
    if not len(rows):
        raise InputError(f"{opened.path}: has no rows from {start_s:g} s after its first one on; nobody to avoid")
    return Moving(rows, start_ns, config)


def _between(opened: Opened, table: type[T], after_ns: int, gap_ns: int, most_ns: int) -> tuple[int, T]:
    """Time `after_ns` after the first row, and the rows from a gap before it to a gap after so many nanoseconds."""
    parts: list[T] = []
    start_ns: int | None = None
    for chunk in opened.rows(table):
        t_ns = chunk.t_ns
        if not len(chunk):
            continue
        start_ns = int(t_ns[0]) + after_ns if start_ns is None else start_ns
        parts.append(chunk.take((t_ns >= start_ns - gap_ns) & (t_ns <= start_ns + most_ns + gap_ns)))
        if t_ns[-1] > start_ns + most_ns + gap_ns:
            break
    return start_ns or 0, table.concat(parts)


def _picture(
    scene: Scene, course: Course, path: RobotPath, request: NavigateRequest, config: NavigateConfig, verdict: Verdict
) -> bytes:
    """PNG of the path in the scene."""
    from .picture import PathPicture, path_png

    goal = np.array(request.goal)
    return path_png(PathPicture(scene=scene, course=course, path=path, goal=goal, config=config, end=verdict.words()))
