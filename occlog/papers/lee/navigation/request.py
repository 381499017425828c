"""Request of `occlog navigate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, output_file, sink, source
from occlog.settings import setting

from .config import NavigateConfig


@dataclass(frozen=True, kw_only=True)
class NavigateRequest(Request):
    """Navigate a robot through SCENE (YAML, or a recording that holds one) by potential fields.

    The goal attracts, obstacles repel, and every --step seconds the robot takes the direction of the total force, at
    constant speed (Lee 2009, Sec. 5.2.2). At an obstacle in line with the goal a step could end in the obstacle:
    --force prevent turns away before it. The robot then oscillates, which is detected; --escape leaves the line.

    The path ends at the goal, at a collision, where the motion repeats itself for ever, or after --max-steps.

    \b
      occlog navigate examples/room.yaml --from 1,2.6 --to 7,2.6 -o path.parquet --picture path.png
      occlog navigate examples/room.yaml --from 1,1 --to 7,5 --obstacles tracks.parquet -o path.parquet --strict
    """

    OWNER: ClassVar[str] = "navigate"
    RUN: ClassVar[str] = "occlog.papers.lee.navigation.run:run_navigate"
    JUDGED: ClassVar[bool] = True
    VERDICT: ClassVar[str] = "reached"
    STRICT: ClassVar[str] = "if the robot collides or does not reach its goal. The path is written anyway."

    scene: Path = source("A scene, or a recording that holds one.", argument=True)
    start: tuple[float, ...] = setting(
        MISSING,
        "Start position X,Y of the robot, in the scene's unit.",
        unit="length",
        counts=(2,),
        option="--from",
        metavar="X,Y",
        shown="",
    )
    goal: tuple[float, ...] = setting(
        MISSING,
        "Goal position X,Y of the robot, in the scene's unit.",
        unit="length",
        counts=(2,),
        option="--to",
        metavar="X,Y",
        shown="",
    )
    output: Path = output_file("The path of the robot, a row for each step (Parquet).", "robot_path")
    picture: Path | None = sink("Also draw the path in the scene (PNG).")
    obstacles: Path | None = source("Moving people to avoid: tracks (Parquet), or a recording with truth.")
    disc_obstacles: tuple[str, ...] = setting(
        (),
        "Round obstacle X,Y[,RADIUS] (in the scene's unit; radius 0 if omitted) in addition "
        "to those of the scene; may be repeated.",
        option="--obstacle",
        metavar="X,Y[,RADIUS]",
        repeat=True,
        whole=True,
        shown="",
    )
    start_delay_s: float = setting(
        0.0,
        "Start the robot this many seconds after the first row of --obstacles.",
        unit="s",
        at_least=0,
        option="--start-delay",
        shown="0",
    )
    settings: Mapping[str, object] = group(lambda: NavigateConfig, example="repulsion=0.05")
