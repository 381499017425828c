"""Options of `occlog track` for methods that track in images, and the check which options go with a method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from occlog.cli import options

F = TypeVar("F", bound=Callable[..., Any])

VIEW_METHODS = ("mipf", "idmot", "cmct", "bmct", "mcmc")
"""Names of `occlog.track.images.catalogue.VISUAL`; a test keeps the two alike."""
OWN = ("initial", "detections", "world", "fundamental")
"""Options that only these methods have."""
SHARED = (
    "bearings",
    "output",
    "scene",
    "method",
    "particles",
    "only",
    "without",
    "window",
    "settings",
    "seed",
    "overwrite",
    "quiet",
    "as_json",
)
"""Options that they share with the others."""

OPTIONS = (
    click.option(
        "--initial",
        type=options.PATH,
        default=None,
        help="Where targets are in each view at first: CSV of ellipses, or boxes with identities (Parquet, or "
        "a recording that holds true boxes). [default: from detections]",
    ),
    click.option(
        "--detections",
        type=options.PATH,
        default=None,
        help="Boxes of a detector, or views of `occlog detect`, that trackers begin from. [default without "
        "--initial: boxes in the recording, or else what moves in it]",
    ),
    click.option(
        "--fundamental",
        type=options.PATH,
        default=None,
        help="Fundamental matrices (JSON, see `occlog epipolar`). [default: poses of --scene, "
        "those in the recording, poses of its scene]",
    ),
    click.option(
        "--world",
        type=options.PATH,
        default=None,
        help="Where the targets are on the ground, from all views that track them (Parquet).",
    ),
)


def view_opts(command: F) -> F:
    """All options of `OPTIONS`."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


def check_options(context: click.Context, method: str) -> bool:
    """Return whether the method tracks in images; UsageError for an option that the method does not take.

    Args:
        context: of the command.
        method: the one chosen.
    """
    visual = method in VIEW_METHODS
    for parameter in context.command.params:
        name = parameter.name or ""
        given = context.get_parameter_source(name) not in (ParameterSource.DEFAULT, None)
        if given and visual and name not in (*OWN, *SHARED):
            raise click.UsageError(f"{parameter.opts[0]} does not go with --method {method}, which tracks in images")
        if given and not visual and name in OWN:
            raise click.UsageError(
                f"{parameter.opts[0]} goes with methods that track in images ({', '.join(VIEW_METHODS)}), not with "
                f"{method}"
            )
    return visual


def run(context: click.Context, window_ns: int | None) -> int:
    """Track by the options in the context, and return the exit code.

    Args:
        context: of the command.
        window_ns: frames at most this far apart make one moment; None: from the frame rates.
    """
    from occlog.cli.parse import parse_names, parse_setting
    from occlog.track.images.run.inputs import ViewsRequest
    from occlog.track.images.run.run import ViewsOutputs, run_track_views

    p = context.params
    outputs = ViewsOutputs(p["output"], p["world"])
    inputs = [p["bearings"], p["scene"], p["initial"], p["detections"], p["fundamental"]]
    options.check_outputs(inputs, [outputs.tracks, outputs.world], p["overwrite"])
    values = dict(parse_setting(text) for text in p["settings"])
    if p["particles"] is not None:
        values["particles"] = str(p["particles"])
    request = ViewsRequest(
        recording=p["bearings"],
        scene=p["scene"],
        method=p["method"],
        settings=values,
        initial=p["initial"],
        detections=p["detections"],
        fundamental=p["fundamental"],
        only=parse_names(p["only"]),
        without=parse_names(p["without"]),
        window_ns=window_ns,
        seed=p["seed"],
    )
    summary, losses = run_track_views(request, outputs, p["overwrite"], p["quiet"])
    return options.finish(summary, losses, p["as_json"])
