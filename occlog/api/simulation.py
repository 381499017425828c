"""`simulate` in Python: a recording with ground truth from a scene."""

from __future__ import annotations

import os
from typing import Literal

from occlog.errors import UsageError
from occlog.simulate.request import VERB

from .call import check_taken, record
from .keywords import Setting
from .recordings import Recording
from .sources import SceneSource, Source

NOT_OF_REQUESTS = ("settings", "output", "overwrite", "progress")


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
    arguments = dict(locals())
    chosen = kind or ("walkers" if paths is None else "paths")
    form = VERB.form(chosen)
    own = {name: value for name, value in arguments.items() if name not in NOT_OF_REQUESTS}
    check_taken(form, own, (), f"kind {chosen}" if kind else "a scene", VERB)
    return record(form, arguments)
