"""The `occlog simulate` command, and the options of each kind of scene."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from occlog import console
from occlog.cli import options
from occlog.cli.options import INPUT
from occlog.cli.setting_options import Variant, VariantCommand, given, options_of, value_after
from occlog.cli.values import AT_LEAST_0, RATE
from occlog.errors import UsageError
from occlog.io.files.atomic import check_outputs

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

RENDER_PREFIX = "render_"
"""Of the names of parameters that are settings of the video: the noise of images is not that of cameras."""


class ImageSize(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """WIDTHxHEIGHT in pixels."""

    name = "WxH"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """(width, height)."""
        if isinstance(value, tuple):
            return value
        found = re.fullmatch(r"(\d{1,5})[x×](\d{1,5})", str(value).strip())
        if found is None:
            self.fail(f"{value!r} is not a size: want WIDTHxHEIGHT, e.g. 320x240", param, ctx)
        return int(found[1]), int(found[2])


def _times() -> list[click.Option]:
    """How long and how often, in other words than steps."""
    people, own = WorldConfig.in_unit("m"), WorldConfig()
    rates = f"{1 / people.step_s:g}, or {1 / own.step_s:g} in a unit of its own"
    return [
        click.Option(["--seconds"], type=AT_LEAST_0, default=None, help="Length of the recording, instead of --steps."),
        click.Option(
            ["--rate", "rate_hz"], type=RATE, default=None, metavar="HZ", help=f"Steps a second. [default: {rates}]"
        ),
    ]


def _sensing() -> list[click.Option]:
    """What cameras and arrays measure, and whether there is video."""
    return [
        click.Option(
            ["--bearings/--no-bearings"],
            default=None,
            help="Simulate what cameras measure. [default: unless --render]",
        ),
        *options_of(ObserveConfig),
        *options_of(SoundConfig),
        *options_of(ReadConfig),
        *options_of(MeasureConfig),
        click.Option(
            ["--render"], is_flag=True, help="Add video of every camera, true boxes, and the targets' appearance."
        ),
        *options_of(RenderConfig, prefix=RENDER_PREFIX),
        *options_of(StoreConfig, only=("store",)),
    ]


def _size(settings: type[BallsConfig | PeopleConfig]) -> click.Option:
    words = f"Of the images. [default: {settings.width}x{settings.height}]"
    return click.Option(["--size"], type=ImageSize(), default=None, metavar="WxH", help=words)


def walkers_params() -> list[click.Parameter]:
    """Options of a scene from a file in which objects walk at random."""
    avoid = click.Option(
        ["--avoid"],
        type=INPUT,
        default=None,
        metavar="FILE",
        help="People whom the objects avoid, with --motion field: tracks, or a recording with the truth. They walk as "
        "they did, from their first row on, and are not in the recording.",
    )
    return [*options_of(WorldConfig), avoid, *options_of(FieldConfig), *_times(), *_sensing()]


def paths_params() -> list[click.Parameter]:
    """Options of a scene from a file in which targets follow a script."""
    paths = click.Option(
        ["--paths"],
        type=INPUT,
        default=None,
        metavar="FILE",
        help="Scripted targets (YAML) instead of random walkers; it may say how long and how often too.",
    )
    return [paths, *options_of(WorldConfig, only=("steps", "diameter", "z")), *_times(), *_sensing()]


def balls_params() -> list[click.Parameter]:
    """Options of the video of balls."""
    return [*options_of(BallsConfig), _size(BallsConfig), *options_of(StoreConfig)]


def people_params() -> list[click.Parameter]:
    """Options of the video of people who look alike."""
    return [
        *options_of(PeopleConfig),
        _size(PeopleConfig),
        *options_of(WorldConfig, only=("speed",)),
        *options_of(RenderConfig, without=("lookalike",), prefix=RENDER_PREFIX),
        *options_of(StoreConfig),
    ]


SCENES = {
    "walkers": Variant("objects walk to random places in the room of a file", walkers_params, called="SCENE"),
    "paths": Variant("objects do what a script says", paths_params, called="SCENE --paths FILE"),
    "balls": Variant("video of balls of one look that hide one another (Qu, Schonfeld, Mohamed 2007)", balls_params),
    "people": Variant("video of a room with people in the same clothes", people_params),
}
"""What is simulated; the last two need no file."""
KINDS = ("balls", "people")


def chosen_scene(args: Sequence[str]) -> str | None:
    """The kind of scene that the arguments choose; None: none, or one that there is not."""
    kind = value_after(args, "--scene")
    if kind is not None:
        return kind if kind in KINDS else None
    return None if value_after(args, "--paths") is None else "paths"


@click.command(
    name="simulate",
    cls=VariantCommand,
    variants=SCENES,
    choose=chosen_scene,
    default="walkers",
    shows_default=True,
    what="scene",
    chosen_by="--scene {}",
    short_help="Make a recording with ground truth from a scene.",
)
@click.argument("scene", type=options.INPUT, required=False)
@click.option(
    "--scene",
    "kind",
    type=click.Choice(KINDS),
    default=None,
    help="A video to track in, instead of SCENE: balls that hide one another, or people who look alike.",
)
@options.output_opt("The recording (MCAP).")
@click.option(
    "--fps",
    type=RATE,
    default=None,
    metavar="HZ",
    help="Frames a second of every camera. [default: the scene's rates; 25 of balls and people]",
)
@options.seed_opt
@options.workers_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    scene: Path | None,
    kind: str | None,
    output: Path,
    fps: float | None,
    seed: int,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **own: Any,
) -> int:
    """Make a recording with ground truth from SCENE (YAML, or a recording that holds a scene).

    Objects walk to random places of the room and go around each other and the static
    occluders (Ercan et al. 2013, Sec. 6).  The recording holds their true paths and what
    cameras measure of the targets (Eqs. 1-4), microphone arrays hear and readers of tags
    read of them, with --measure also ranges, differences of ranges and strengths of signals;
    with --render it holds video instead, for `occlog detect`.  With --paths
    objects do what the file says.

    With --scene a video comes from no file: `balls` is that of Qu et al. 2007, Sec. 4.1, six
    balls of one look seen by two cameras at a right angle; `people` is a room with people
    in the same clothes.  The true boxes are of all targets in all frames.

    \b
      occlog simulate examples/room100.yaml -o room.mcap --steps 1000 --occluders 40 --seed 7
      occlog simulate examples/room.yaml -o video.mcap --render --seconds 15 --occluders 3
      occlog simulate examples/room.yaml -o walk.mcap --seconds 60 --occluders 4 --motion field
      occlog simulate examples/lee_field.yaml --paths examples/lee_field_paths.yaml -o field.mcap
      occlog simulate --scene balls -o balls.mcap --store ffv1 --seed 1
      occlog simulate --scene people -o people.mcap --views 4 --store ffv1
    """
    _check_scene(scene, kind)
    size = own.get("size")
    images = {} if size is None else {"width": size[0], "height": size[1]}
    store = given(StoreConfig, own)
    if kind == "balls":
        from .balls.run import balls_setup, balls_videos, run_balls

        check_outputs([], [output], overwrite)
        balls = balls_setup(given(BallsConfig, own) | images, store, fps, workers)
        check_outputs([], [output, *balls_videos(balls, output).values()], overwrite)
        return console.finish(run_balls(balls, output, seed, overwrite=overwrite, quiet=quiet), [], as_json)

    from .run import SimulateRequest, people_setup, run_simulate, scene_setup
    from .video import video_paths

    request = SimulateRequest(
        scene=scene,
        paths=own.get("paths"),
        avoid=own.get("avoid"),
        world=given(WorldConfig, own),
        avoidance=given(FieldConfig, own),
        seconds=own.get("seconds"),
        rate_hz=own.get("rate_hz"),
        bearings=own.get("bearings"),
        observe=given(ObserveConfig, own),
        sound=given(SoundConfig, own),
        reads=given(ReadConfig, own),
        measure=given(MeasureConfig, own),
        video=kind == "people" or own["render"],
        render=given(RenderConfig, own, prefix=RENDER_PREFIX),
        store=store,
        fps=fps,
        workers=workers,
    )
    check_outputs(request.inputs, [output], overwrite)
    setup = people_setup(given(PeopleConfig, own) | images, request) if kind == "people" else scene_setup(request)
    check_outputs(request.inputs, [output, *video_paths(setup, output).values()], overwrite)
    summary = run_simulate(request.inputs, setup, output, seed, overwrite=overwrite, quiet=quiet)
    return console.finish(summary, setup.losses, as_json)


def _check_scene(scene: Path | None, kind: str | None) -> None:
    """UsageError unless there is either a file or a kind of scene that needs none."""
    if kind is None and scene is None:
        raise UsageError(f"no scene: give SCENE (a file), or --scene {' or '.join(KINDS)}")
    if kind is None and scene is not None and scene.name in KINDS and not scene.exists():
        raise UsageError(f"{scene}: no such file; the video of {scene} is made with --scene {scene}")
    if kind is not None and scene is not None:
        raise UsageError(f"--scene {kind} makes its own scene; leave out {scene}")
