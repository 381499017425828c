"""Request of `occlog simulate`, for each kind of scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from occlog.request import Form, Request, Verb, VerbKind, group, number_of_threads, output_file, seed_of_all, source
from occlog.settings import option_setting, setting

from .balls.config import BallsConfig
from .config import (
    FieldConfig,
    MeasureConfig,
    ObserveConfig,
    PeopleConfig,
    ReadConfig,
    RenderConfig,
    SoundConfig,
    StoreConfig,
    WorldConfig,
)

BALLS, PEOPLE = "balls", "people"
KINDS = (BALLS, PEOPLE)
"""Scenes that need no file."""
RENDER = "render_"
"""Prefix of the names of video settings: the noise of images is not that of cameras."""
RATES: dict[str, Any] = {"unit": "Hz", "at_least": 1e-3, "at_most": 1e6, "metavar": "HZ", "shown": ""}
"""Frames or steps a second: times are whole nanoseconds, and recordings last days at most."""


@dataclass(frozen=True, kw_only=True)
class SimulateRequestBase(Request):
    """Simulate a recording with ground truth from SCENE (YAML, or a recording that holds a scene).

    Objects walk to random positions of the room, around each other and around static occluders (Ercan et al. 2013,
    Sec. 6). The recording holds their true paths and the measurements of the targets by cameras (Eqs. 1-4),
    microphone arrays and tag readers; with --measure also ranges, differences of ranges and signal strengths; with
    --render video instead, for `occlog detect`. With --paths objects follow scripted paths.

    With --scene no file is needed: `balls` is the video of Qu et al. 2007, Sec. 4.1, six balls of equal appearance
    seen by two cameras at a right angle; `people` is a room with people in the same clothes. The true boxes are of
    all targets in all frames.

    \b
      occlog simulate examples/room100.yaml -o room.mcap --steps 1000 --occluders 40 --seed 7
      occlog simulate examples/room.yaml -o video.mcap --render --seconds 15 --occluders 3
      occlog simulate examples/room.yaml -o walk.mcap --seconds 60 --occluders 4 --motion field
      occlog simulate examples/lee_field.yaml --paths examples/lee_field_paths.yaml -o field.mcap
      occlog simulate --scene balls -o balls.mcap --store ffv1 --seed 1
      occlog simulate --scene people -o people.mcap --views 4 --store ffv1
    """

    OWNER: ClassVar[str] = "simulate"

    output: Path = output_file("The recording (MCAP).")
    fps: float | None = option_setting(
        None, "Frame rate of every camera. [default: the scene's rates; 25 for balls and people]", **RATES
    )
    seed: int = seed_of_all()
    workers: int | None = number_of_threads()


@dataclass(frozen=True, kw_only=True)
class SceneRequest(SimulateRequestBase):
    """A scene from a file, in which objects walk at random or on scripted paths."""

    RUN: ClassVar[str] = "occlog.simulate.run:run_scene"

    scene: Path | None = source("Room and sensors.", argument=True, required=False, scene=True)
    paths: Path | None = source(
        "Scripted target paths (YAML) instead of random motion; the file may also state duration and rate.",
        metavar="FILE",
    )
    world: Mapping[str, object] = group(lambda: WorldConfig)
    avoid: Path | None = source(
        "People that the objects avoid (--motion field): tracks, or a recording with truth; its first row is the start "
        "of the simulation. These people are not recorded.",
        metavar="FILE",
    )
    avoidance: Mapping[str, object] = group(lambda: FieldConfig)
    seconds: float | None = option_setting(
        None, "Length of the recording, instead of --steps.", unit="s", at_least=0, shown=""
    )
    rate_hz: float | None = setting(
        None,
        f"Steps per second. [default: {1 / WorldConfig.in_unit('m').step_s:g}, or {1 / WorldConfig().step_s:g} where "
        f"the scene has its own unit of length]",
        option="--rate",
        **RATES,
    )
    bearings: bool | None = setting(
        None,
        "Simulate the bearings of the cameras. [default: unless --render]",
        option="--bearings/--no-bearings",
        shown="",
    )
    observe: Mapping[str, object] = group(lambda: ObserveConfig)
    sound: Mapping[str, object] = group(lambda: SoundConfig)
    reads: Mapping[str, object] = group(lambda: ReadConfig)
    measure: Mapping[str, object] = group(lambda: MeasureConfig)
    render: bool = option_setting(
        False, "Add video of every camera, true boxes, and the targets' appearance.", shown=""
    )
    rendering: Mapping[str, object] = group(lambda: RenderConfig, prefix=RENDER)
    store: Mapping[str, object] = group(lambda: StoreConfig, only=("store",))


@dataclass(frozen=True, kw_only=True)
class _WithoutFile(SimulateRequestBase):
    """Request of `occlog simulate` for a video of a built-in scene, in place of a scene file."""

    kind: str | None = setting(
        None,
        "Built-in video instead of SCENE: `balls` that occlude one another, or `people` of equal appearance.",
        choices=KINDS,
        option="--scene",
        shown="",
    )


def _size(settings: BallsConfig | PeopleConfig) -> Any:
    words = f"Of the images. [default: {settings.width}x{settings.height}]"
    return setting(None, words, size=True, option="--size", metavar="WxH", shown="")


@dataclass(frozen=True, kw_only=True)
class BallsRequest(_WithoutFile):
    """Request of `occlog simulate --scene balls`: a video of balls."""

    RUN: ClassVar[str] = "occlog.simulate.balls.run:run_balls"

    balls: Mapping[str, object] = group(lambda: BallsConfig)
    size: tuple[int, int] | None = _size(BallsConfig())
    store: Mapping[str, object] = group(lambda: StoreConfig)


@dataclass(frozen=True, kw_only=True)
class SimulatePeopleRequest(_WithoutFile):
    """Request of `occlog simulate --scene people`: a video of people of equal appearance."""

    RUN: ClassVar[str] = "occlog.simulate.run:run_people"

    people: Mapping[str, object] = group(lambda: PeopleConfig)
    size: tuple[int, int] | None = _size(PeopleConfig())
    world: Mapping[str, object] = group(lambda: WorldConfig, only=("speed",))
    rendering: Mapping[str, object] = group(lambda: RenderConfig, without=("identical_clothes",), prefix=RENDER)
    store: Mapping[str, object] = group(lambda: StoreConfig)


_OF_SCENES = (
    *("output", "fps", "seed", "workers", "scene", "seconds", "rate_hz", "bearings", "observe", "sound", "reads"),
    *("measure", "render", "rendering", "store"),
)
VERB = Verb(
    _WithoutFile,
    {
        "walkers": VerbKind(
            "objects walk to random positions in the room of a file",
            lambda: Form(SceneRequest, (*_OF_SCENES, "world", "avoid", "avoidance")),
            "SCENE",
        ),
        "paths": VerbKind(
            "objects follow scripted paths",
            lambda: Form(SceneRequest, (*_OF_SCENES, "paths", "steps", "diameter", "object_height")),
            "SCENE --paths FILE",
        ),
        BALLS: VerbKind(
            "video of balls of equal appearance that occlude one another (Qu, Schonfeld, Mohamed 2007)",
            lambda: Form(BallsRequest),
        ),
        PEOPLE: VerbKind("video of a room with people in the same clothes", lambda: Form(SimulatePeopleRequest)),
    },
    default="walkers",
    by={"scene": lambda text: text if text in KINDS else "", "paths": lambda _: "paths"},
    what="scene",
    chosen_by="--scene {}",
)
