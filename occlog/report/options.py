"""Options of `occlog report --video`, and which ones are about pages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from occlog.cli import options
from occlog.cli.numbers import Finite
from occlog.errors import UsageError
from occlog.ingest.plan import FRAMES

F = TypeVar("F", bound=Callable[..., Any])

OVERLAY = (
    click.option(
        "--recording",
        type=options.PATH,
        default=None,
        help="Draw over the video of this recording, instead of making a page.",
    ),
    click.option(
        "--video",
        type=options.PATH,
        default=None,
        help="The video to make: .mp4, or .avi (Motion JPEG, larger, no smears).",
    ),
    click.option(
        "--frame", type=click.IntRange(min=0), default=None, help="Number, in the first camera, of the frame for --png."
    ),
    click.option(
        "--frames",
        type=FRAMES,
        default=None,
        metavar="A:B",
        help="Video of frames A <= number < B of the first camera only.",
    ),
    click.option(
        "--camera",
        "cameras",
        multiple=True,
        metavar="NAME",
        help="Only this camera; repeatable. The first one counts the frames. [default: all]",
    ),
    click.option("--failures", type=options.PATH, default=None, help="Failures written by evaluate, drawn in red."),
    click.option(
        "--fundamental",
        type=options.PATH,
        default=None,
        help="Geometry of the views as the tracker had it, if not that of the recording.",
    ),
    click.option(
        "--scale",
        type=Finite(0.05, 16),
        default=None,
        help="Enlarge images. [default: by a whole number, to a height of about 480 px]",
    ),
    click.option(
        "--fps",
        type=Finite(0.1, 1000),
        default=None,
        metavar="HZ",
        help="Frames a second of the video. [default: those of the recording]",
    ),
)

ALONE = ("recording", "video", "frame", "frames", "cameras", "failures", "fundamental", "scale", "fps")
PAGE = ("output", "bearings", "errors", "bound", "diagnostics", "occluders", "metrics")


def overlay_options(command: F) -> F:
    """Add the options, in order."""
    for option in reversed(OVERLAY):
        command = option(command)
    return command


def split(given: dict[str, Any], title: str) -> dict[str, Any] | None:
    """Values for a video, or None for a page, for which only its own options are left in `given`.

    Args:
        given: values of all options; changed.
        title: value of --title.

    Returns:
        The values; UsageError for options that do not go together.
    """
    own = {name: given.pop(name) for name in ALONE}
    if own["recording"] is None:
        for name, value in own.items():
            if value not in (None, ()):
                raise UsageError(f"--{name.removesuffix('s') if name == 'cameras' else name} needs --recording")
        if given["output"] is None:
            raise UsageError("no output: give -o (the page), or --recording with --video or --frame")
        return None
    for name in PAGE:
        if given[name] is not None:
            raise UsageError(f"--{name} is about a page; leave it out, or leave out --recording")
    if title != "Tracking report":
        raise UsageError("--title is about a page; leave it out, or leave out --recording")
    return own | {name: given[name] for name in ("tracks", "truth", "scene", "png", "overwrite")}
