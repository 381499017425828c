"""Options of `occlog evaluate` for tracks of many targets, in images and on the ground."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, TypeVar

import click

from occlog.cli import options
from occlog.cli.numbers import POSITIVE, Finite
from occlog.errors import UsageError
from occlog.ingest.plan import FRAMES

F = TypeVar("F", bound=Callable[..., Any])

# Every option of this list but the last two is a field of ManyConfig, which has its default.
OPTIONS = (
    click.option(
        "--tau",
        type=POSITIVE,
        default=None,
        metavar="FACTOR",
        help="A tracker is on a target this many radii from it, sqrt(half width x half height) of the true "
        "box; further away it is not. [default: 1]",
    ),
    click.option("--tau-px", type=POSITIVE, default=None, metavar="PX", help="The same in pixels, instead of --tau."),
    click.option(
        "--own",
        type=click.Choice(["label", "start", "best"]),
        default=None,
        help="A track's own target: that of its number, the first one it is on, or by the best assignment. "
        "[default: label; start for MOTChallenge text, boxes, and trackers born from detections; best "
        "with --match optimal]",
    ),
    click.option(
        "--clear-rule",
        type=click.Choice(["classic", "challenge"]),
        default=None,
        help="CLEAR-MOT pairs as py-motmetrics (classic) or as TrackEval. [default: classic]",
    ),
    click.option(
        "--match-distance",
        type=POSITIVE,
        default=None,
        metavar="LENGTH",
        help="On the ground: a track meets a target this near. [default: 1 m]",
    ),
    click.option(
        "--track-gap",
        "track_gap_s",
        type=Finite(min=0),
        default=None,
        metavar="SECONDS",
        help="On the ground: interpolate tracks of many targets over at most this. [default: --max-gap]",
    ),
    click.option(
        "--gospa-cutoff",
        type=POSITIVE,
        default=None,
        help="GOSPA's cutoff, of 1 - IoU or of the distance on the ground. [default: where a pair meets]",
    ),
    click.option("--gospa-p", type=Finite(min=1), default=None, help="GOSPA's exponent. [default: 2]"),
    click.option("--gospa-alpha", type=Finite(0, 2, min_open=True), default=None, help="GOSPA's alpha. [default: 2]"),
    click.option(
        "--gospa-px",
        type=POSITIVE,
        default=None,
        metavar="PX",
        help="Give GOSPA of the centres in the image too, with this cutoff.",
    ),
    click.option(
        "--camera",
        "cameras",
        multiple=True,
        metavar="NAME",
        help="Of tracks in images: compare this camera only; may be repeated.",
    ),
    click.option(
        "--frames", type=FRAMES, default=None, metavar="A:B", help="Of tracks in images: only frames A <= number < B."
    ),
    click.option(
        "--failures",
        type=options.PATH,
        default=None,
        help="Write each failure of a tracker: frame, camera, target, cause (Parquet).",
    ),
    click.option(
        "--mot",
        type=options.PATH,
        default=None,
        metavar="DIR",
        help="Write truth and tracks as MOTChallenge files, as TrackEval wants them; DIR may hold tracks of "
        "others already.",
    ),
)
FIELDS = (
    "tau",
    "tau_px",
    "own",
    "clear_rule",
    "match_distance",
    "track_gap_s",
    "gospa_cutoff",
    "gospa_p",
    "gospa_alpha",
    "gospa_px",
    "cameras",
    "frames",
)
"""Options that are fields of ManyConfig."""
IMAGE_ONLY = ("tau", "tau_px", "gospa_px", "cameras", "frames", "mot")
GROUND_ONLY = ("match_distance", "track_gap_s")
COMMON = ("tracks", "truth", "output", "fail_if", "overwrite", "quiet", "as_json", "box_overlap", "failures")


def many_options(command: F) -> F:
    """Add all of OPTIONS, in order."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


def given_names() -> tuple[str, ...]:
    """Parameters of the running command that were given on the command line."""
    context = click.get_current_context()
    source = click.core.ParameterSource.COMMANDLINE
    return tuple(name for name in context.params if context.get_parameter_source(name) is source)


def check_image_options(given: Collection[str]) -> None:
    """UsageError for options that mean nothing for tracks in images."""
    allowed = {*COMMON, *FIELDS, *IMAGE_ONLY} - {*GROUND_ONLY}
    _refuse([name for name in given if name not in allowed], "has no meaning for tracks in images; leave it out")


def check_ground_options(given: Collection[str], tracks: bool) -> None:
    """UsageError for options that mean nothing for tracks on the ground, or without tracks."""
    wrong = [name for name in given if name in IMAGE_ONLY]
    _refuse(
        wrong,
        "is for tracks in images (view_tracks, boxes, MOTChallenge text); on the ground there is --match-distance",
    )
    if not tracks:
        _refuse([name for name in given if name in (*FIELDS, "failures")], "needs TRACKS and --truth")


def _refuse(names: list[str], why: str) -> None:
    if names:
        found = {p.name: p.opts[0] for p in click.get_current_context().command.params}
        raise UsageError(f"{found.get(names[0], names[0])} {why}")
