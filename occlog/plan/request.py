"""Request of `occlog plan`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, seed_of_all, sink, source
from occlog.settings import option_setting

from .config import PlanConfig


@dataclass(frozen=True, kw_only=True)
class PlanRequest(Request):
    """Predict the tracking errors of the cameras and arrays of SCENE (YAML, or a recording that holds one).

    For each position on the floor: the root mean square error of a filter that has tracked a target there, and the
    probability that no, one, or several sensors see the target, among --people who walk about and occlude it. The
    error is that of a filter that knows the turning rate of the people, along random walks to each position; no
    recording is made.

    \b
      occlog plan examples/room.yaml --people 6 --max-expected-error 0.3 -o plan.parquet --picture plan.png
      occlog plan examples/room.yaml --people 6 --along-walls southwest --add 2 --report plan.html
      occlog plan examples/room.yaml --density 0.2 --remove --json
    """

    OWNER: ClassVar[str] = "plan"
    RUN: ClassVar[str] = "occlog.plan.run:run_plan"

    scene: Path = source("A scene, or a recording that holds one.", argument=True)
    output: Path | None = sink(
        "Map of the expected error and of the sensors that see the target, by position (Parquet).",
        "plan",
        option="-o/--output",
    )
    picture: Path | None = sink("Draw the map (PNG or SVG, by the name).")
    report: Path | None = sink("Write a page with map, metrics and rankings (HTML).")
    candidates: Path | None = source(
        "Scene file with cameras and arrays at possible positions for one more sensor; they are ranked.", metavar="FILE"
    )
    along_walls: str | None = option_setting(
        None,
        "Rank positions along the walls for a camera like this one of the scene (lens, height, noise), directed at "
        "the centre of the room.",
        metavar="CAMERA",
        shown="",
    )
    spacing: float | None = option_setting(
        None,
        "Maximum spacing of the camera positions along a wall, in the scene's unit. [default: a "
        "sixteenth of the length of all walls]",
        unit="length",
        above=0,
        shown="",
    )
    add: int | None = option_setting(
        None,
        "Add N of the candidates one after the other, each time the one that reduces the error most.",
        at_least=1,
        metavar="N",
        shown="",
    )
    remove: bool = option_setting(
        False, "Rank the scene's own sensors by how little the error grows without them.", shown=""
    )
    paths: Path | None = source(
        "Tracks, or a recording with truth: errors are averaged over the floor with the "
        "density of these people as weight. [default: all positions alike]",
        metavar="FILE",
    )
    settings: Mapping[str, object] = group(lambda: PlanConfig, example="settling_s=12")
    seed: int = seed_of_all()
