"""`simulate` in Python: a recording with ground truth from a scene."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from occlog import console
from occlog.errors import UsageError
from occlog.io.files.atomic import check_outputs

from .folders import Folder
from .keywords import Setting, settings_by_class
from .recordings import Recording
from .sources import Inputs, SceneSource, Source

if TYPE_CHECKING:
    from occlog.settings import Settings

RENDER = "render_"
"""What the names of settings of the video begin with: the noise of images is not that of cameras."""
ARGUMENTS = ("scene", "kind", "seed", "seconds", "rate_hz", "fps", "paths", "avoid", "render", "bearings", "output")


def simulate(
    scene: SceneSource | None = None,
    *,
    kind: Literal["balls", "people"] | None = None,
    seed: int = 0,
    seconds: float | None = None,
    rate_hz: float | None = None,
    fps: float | None = None,
    paths: Source | None = None,
    avoid: Source | None = None,
    bearings: bool | None = None,
    render: bool = False,
    workers: int | None = None,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: bool = False,
    **settings: Setting,
) -> Recording:
    """Make a recording with ground truth, as `occlog simulate` does.

    Args:
        scene: room and sensors; None with a `kind` that needs none.
        kind: `balls` or `people`: a video to track in, instead of a scene.
        seed: of all random numbers.
        seconds: length of the recording, instead of `steps`.
        rate_hz: steps a second.
        fps: frames a second of every camera.
        paths: file of scripted targets (YAML) instead of random walkers.
        avoid: people whom walkers avoid.
        bearings: simulate what cameras measure; None: unless there is video.
        render: add video of every camera.
        workers: threads; None: one a processor. The result is the same.
        output: where the recording is written; None: a folder that goes with the last reference to it.
        overwrite: an output that is there may be replaced.
        progress: show a bar on standard error, if it is a terminal.
        **settings: of walkers, cameras, arrays, readers and storage, by their names in docs/reference/settings.md;
            those of the video with `render_` before them.

    Raises:
        UsageError: a setting that there is not, or arguments that contradict each other.
        InputError: the scene is missing, damaged, or says something that cannot be.
        OutputExistsError: the output is there, and may not be replaced.
    """
    if kind is not None and scene is not None:
        raise UsageError(f"kind {kind!r} makes its own scene; leave the scene out")
    if kind is None and scene is None:
        raise UsageError("no scene: give one, or kind='balls' or 'people'")
    home = Folder()
    path = home.file("recording.mcap") if output is None else Path(output)
    with Inputs() as inputs, console.notes_kept():
        if kind == "balls":
            summary = _balls(
                path, settings, seed=seed, fps=fps, workers=workers, overwrite=overwrite, quiet=not progress
            )
        else:
            from occlog.simulate.config import (
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
            from occlog.simulate.run import SimulateRequest, people_setup, run_simulate, scene_setup
            from occlog.simulate.video import video_paths

            classes: list[tuple[str, type[Settings]]] = [
                ("", WorldConfig),
                ("", FieldConfig),
                ("", ObserveConfig),
                ("", SoundConfig),
                ("", ReadConfig),
                ("", MeasureConfig),
                (RENDER, RenderConfig),
                ("", StoreConfig),
                *([("", PeopleConfig)] if kind == "people" else []),
            ]
            world, field, observe, sound, reads, measure, images, store, *people = settings_by_class(
                "simulate", settings, classes, ARGUMENTS
            )
            request = SimulateRequest(
                scene=inputs.scene(scene),
                paths=inputs.optional(paths, "paths"),
                avoid=inputs.optional(avoid, "avoid"),
                world=world,
                avoidance=field,
                seconds=seconds,
                rate_hz=rate_hz,
                bearings=bearings,
                observe=observe,
                sound=sound,
                reads=reads,
                measure=measure,
                video=render or kind == "people",
                render=images,
                store=store,
                fps=fps,
                workers=workers,
            )
            check_outputs(request.inputs, [path], overwrite)
            setup = people_setup(people[0], request) if people else scene_setup(request)
            check_outputs(request.inputs, [path, *video_paths(setup, path).values()], overwrite)
            summary = run_simulate(request.inputs, setup, path, seed, overwrite=overwrite, quiet=not progress)
    shown = home.without_paths(summary) if output is None else summary
    return Recording(path, shown, None if output is not None else home)


def _balls(
    path: Path,
    settings: dict[str, Setting],
    *,
    seed: int,
    fps: float | None,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
) -> dict[str, object]:
    """The video of balls of one look."""
    from occlog.simulate.balls.config import BallsConfig
    from occlog.simulate.balls.run import balls_setup, balls_videos, run_balls
    from occlog.simulate.config import StoreConfig

    balls, store = settings_by_class("simulate", settings, [("", BallsConfig), ("", StoreConfig)], ARGUMENTS)
    check_outputs([], [path], overwrite)
    setup = balls_setup(balls, store, fps, workers)
    check_outputs([], [path, *balls_videos(setup, path).values()], overwrite)
    return run_balls(setup, path, seed, overwrite=overwrite, quiet=quiet)
