"""The `occlog simulate` command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from occlog.cli import options
from occlog.cli.numbers import AT_LEAST_0, POSITIVE, RATE, Finite

from . import kinds as simulate_kinds

if TYPE_CHECKING:
    from .video import Setup

F = TypeVar("F", bound=Callable[..., Any])
SHARE = Finite(0, 1)
COUNT = click.IntRange(min=0)

# Options of one list are fields of one configuration; None: its default, which depends on the length unit.
WORLD = (
    click.option(
        "--steps",
        type=click.IntRange(min=1),
        default=None,
        help="Time steps. [default: 600, or 4000 in units of its own]",
    ),
    click.option("--seconds", type=AT_LEAST_0, default=None, help="Length of the recording, instead of --steps."),
    click.option(
        "--rate",
        "rate_hz",
        type=RATE,
        default=None,
        metavar="HZ",
        help="Steps a second. [default: 10, or 1 in units of its own]",
    ),
    click.option("--targets", type=COUNT, default=None, help="Targets. [default: 1]"),
    click.option("--occluders", type=COUNT, default=None, help="Other moving objects. [default: 0]"),
    click.option(
        "--diameter",
        type=POSITIVE,
        default=None,
        metavar="LENGTH",
        help="Of every object; their centres keep this distance. [default: 0.5 m, or 3.33]",
    ),
    click.option(
        "--speed",
        type=POSITIVE,
        default=None,
        metavar="LENGTH",
        help="Way of an object in a second. [default: 1.2 m, or 1]",
    ),
    click.option(
        "--sigma",
        type=AT_LEAST_0,
        default=None,
        metavar="LENGTH",
        help="Noise of the motion per axis, gathered in a second. [default: 0.05 m, or 0.33]",
    ),
    click.option(
        "--redirect",
        type=SHARE,
        default=None,
        help="Probability of a new destination within a second; 0: only on arrival. [default: 0.095]",
    ),
    click.option(
        "--clearance",
        type=AT_LEAST_0,
        default=None,
        metavar="LENGTH",
        help="Centres keep this distance from walls and static occluders. [default: 0.25 m, or 0; "
        "with --render at least half a diameter]",
    ),
    click.option(
        "--z",
        type=AT_LEAST_0,
        default=None,
        metavar="LENGTH",
        help="Height of the objects' reference point. [default: 0.9 m, or not known]",
    ),
)

PATHS = (
    click.option(
        "--paths",
        type=options.PATH,
        default=None,
        metavar="FILE",
        help="Scripted targets (YAML) instead of random walkers; it may say how long and how often too.",
    ),
)

SOUND = (
    click.option(
        "--silence",
        default=None,
        metavar="SOUND_S,SILENT_S",
        help="Targets fall silent at random: mean seconds of sound and of silence. [default: never]",
    ),
    click.option(
        "--false-doa",
        type=AT_LEAST_0,
        default=None,
        metavar="RATE",
        help="Directions without a source, a second and array. [default: 0]",
    ),
    click.option(
        "--label-doa",
        is_flag=True,
        default=None,
        help="Write which target each direction is of, to test with. [default: unlabelled]",
    ),
)

OBSERVE = (
    click.option(
        "--bearings/--no-bearings", default=None, help="Simulate what cameras measure. [default: unless --render]"
    ),
    click.option(
        "--noise",
        type=click.Choice(["white", "calibration"]),
        default=None,
        help="Errors of a camera's pose: new in every frame, or fixed in time. [default: white]",
    ),
    click.option("--miss", type=SHARE, default=None, help="Probability that a visible target is missed. [default: 0]"),
    click.option(
        "--false-alarm",
        type=SHARE,
        default=None,
        help="Probability that a frame without the target reports it all the same. [default: 0]",
    ),
)

RENDER = (
    click.option("--render", is_flag=True, help="Add video of every camera, true boxes, and the targets' appearance."),
    click.option(
        "--store",
        type=click.Choice(["png", "ffv1"]),
        default=None,
        help="Video as PNG images in the recording, or lossless FFV1 files beside it, which are smaller. "
        "[default: png]",
    ),
    click.option(
        "--image-noise",
        type=AT_LEAST_0,
        default=None,
        metavar="LEVELS",
        help="Noise of every pixel, common to its colours: standard deviation in grey levels of 255. [default: 1.5]",
    ),
    click.option(
        "--colour-noise",
        type=AT_LEAST_0,
        default=None,
        metavar="LEVELS",
        help="Noise of every colour alone. [default: 1]",
    ),
    click.option(
        "--texture",
        type=AT_LEAST_0,
        default=None,
        help="Contrast of tiles, bricks and grain; 0, plain paint, makes small files. [default: 1]",
    ),
    click.option(
        "--light-drift",
        type=Finite(0, 1, max_open=True),
        default=None,
        help="Share by which the light rises and falls. [default: 0.03]",
    ),
    click.option(
        "--light-period", type=POSITIVE, default=None, metavar="SECONDS", help="Time in which it does so. [default: 60]"
    ),
    click.option("--shadows/--no-shadows", default=None, help="Shadows of people on the floor. [default: shadows]"),
    click.option("--lookalike", is_flag=True, default=None, help="The others wear the same clothes as the targets."),
)


def settings(command: F) -> F:
    """Add the options of all lists, in order."""
    kinds = (*simulate_kinds.BOTH, *simulate_kinds.BALLS, *simulate_kinds.PEOPLE)
    for option in reversed((*PATHS, *WORLD, *OBSERVE, *SOUND, *RENDER, *kinds)):
        command = option(command)
    return command


@click.command(name="simulate", short_help="Make a recording with ground truth from a scene.")
@click.argument("scene", type=options.PATH, required=False)
@click.option(
    "--scene",
    "kind",
    type=click.Choice(simulate_kinds.KINDS),
    default=None,
    help="A video to track in, instead of SCENE: balls that hide one another, or people who look alike.",
)
@options.output_opt("The recording (MCAP).")
@settings
@click.option(
    "--fps",
    type=RATE,
    default=None,
    metavar="HZ",
    help="Frames a second of every camera, instead of the scene's rates.",
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
    **values: Any,
) -> int:
    """Make a recording with ground truth from SCENE (YAML, or a recording that holds a scene).

    Objects walk to random places of the room and go around each other and the static
    occluders (Ercan et al. 2013, Sec. 6).  The recording holds their true paths and what
    cameras measure of the targets (Eqs. 1-4) and microphone arrays hear of them; with
    --render it holds video instead, for `occlog detect`.  With --paths objects do what the
    file says.

    With --scene a video comes from no file: `balls` is that of Qu et al. 2007, Sec. 4.1, six
    balls of one look seen by two cameras at a right angle; `people` is a room with people
    in the same clothes.  The true boxes are of all targets in all frames.

    \b
      occlog simulate examples/room100.yaml -o room.mcap --steps 1000 --occluders 40 --seed 7
      occlog simulate examples/room.yaml -o video.mcap --render --seconds 15 --occluders 3
      occlog simulate examples/lee_field.yaml --paths examples/lee_field_paths.yaml -o field.mcap
      occlog simulate --scene balls -o balls.mcap --store ffv1 --seed 1
      occlog simulate --scene people -o people.mcap --views 4 --store ffv1
    """
    paths: Path | None = values.pop("paths")
    given = {name: value for name, value in values.items() if value is not None and (name, value) != ("render", False)}
    simulate_kinds.check_kind(kind, scene, paths, given)
    if kind == "balls":
        return _balls(output, given, fps, seed, workers, overwrite, quiet, as_json)
    from .run import run_simulate
    from .video import video_paths

    inputs = [path for path in (scene, paths) if path is not None]
    options.check_outputs(inputs, [output], overwrite)
    setup = _setup(scene, paths, values if scene is not None else given, fps, workers)
    options.check_outputs(inputs, [output, *video_paths(setup, output).values()], overwrite)
    summary = run_simulate(inputs, setup, output, seed, overwrite=overwrite, quiet=quiet)
    return options.finish(summary, [], as_json)


def _setup(
    scene: Path | None, paths: Path | None, values: dict[str, Any], fps: float | None, workers: int | None
) -> Setup:
    """What decides on the recording: a scene from a file with its options, or the room with people."""
    from occlog.io.scenes.paths import read_paths

    from .run import make_setup, people_setup

    if scene is None:
        return people_setup(values, fps, workers)
    loaded = options.load_scene(scene, None, scene)
    return make_setup(loaded, values, fps, workers, None if paths is None else read_paths(paths))


def _balls(
    output: Path,
    given: dict[str, Any],
    fps: float | None,
    seed: int,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    from occlog.simulate.balls.command import balls_setup, balls_videos, run_balls

    options.check_outputs([], [output], overwrite)
    setup = balls_setup(given, fps, workers)
    options.check_outputs([], [output, *balls_videos(setup, output).values()], overwrite)
    return options.finish(run_balls(setup, output, seed, overwrite=overwrite, quiet=quiet), [], as_json)
