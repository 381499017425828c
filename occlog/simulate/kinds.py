"""Options of `occlog simulate --scene`: scenes that need no file, and which option is about which of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from occlog.cli.numbers import AT_LEAST_0, POSITIVE, Finite
from occlog.errors import UsageError

KINDS = ("balls", "people")


class Size(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """WIDTHxHEIGHT in pixels."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """(width, height), each 16 to 8192."""
        if isinstance(value, tuple):
            return value
        found = re.fullmatch(r"(\d{1,5})[x×](\d{1,5})", str(value).strip())
        size = (int(found[1]), int(found[2])) if found else (0, 0)
        if not all(16 <= side <= 8192 for side in size):
            self.fail(f"{value!r} is not a size: want WIDTHxHEIGHT, each 16 to 8192, e.g. 320x240", param, ctx)
        return size


BOTH = (
    click.option("--frames", type=click.IntRange(min=1), default=None, help="Of each camera. [default: 400]"),
    click.option(
        "--views", type=click.IntRange(1, 6), default=None, help="Cameras. [default: 2 of balls, 3 of people]"
    ),
    click.option(
        "--size",
        type=Size(),
        default=None,
        metavar="WxH",
        help="Of the images. [default: 320x240 of balls, 640x480 of people]",
    ),
    click.option("--grey", is_flag=True, default=None, help="Video without colours."),
    click.option(
        "--overlap", is_flag=True, default=None, help="Targets may hide one another in the first frame already."
    ),
)

BALLS = (
    click.option("--balls", type=click.IntRange(min=1), default=None, help="How many. [default: 6]"),
    click.option("--radius", type=Finite(min=0.5), default=None, metavar="PX", help="Of the balls. [default: 22]"),
    click.option(
        "--ball-speed",
        type=AT_LEAST_0,
        default=None,
        metavar="PX",
        help="Mean way of a ball in a frame, in space. [default: 3]",
    ),
    click.option(
        "--spin", type=AT_LEAST_0, default=None, metavar="RAD", help="Turn of a ball in a frame. [default: 0.05]"
    ),
    click.option(
        "--distance",
        type=POSITIVE,
        default=None,
        metavar="PX",
        help="From the cameras to the middle of the box; near ones see sizes change. [default: 1e6]",
    ),
    click.option(
        "--collide",
        is_flag=True,
        default=None,
        help="Balls bounce off each other. [default: one flies through the other]",
    ),
    click.option(
        "--clutter",
        type=click.IntRange(min=0),
        default=None,
        help="Patches in the balls' colours on each background. [default: 6]",
    ),
)

PEOPLE = (
    click.option(
        "--people",
        type=click.IntRange(min=1),
        default=None,
        help="How many, all targets in the same clothes. [default: 4]",
    ),
)

SHARED = ("frames", "views", "size", "grey", "overlap")
RENDERED = ("store", "image_noise", "colour_noise")
ALLOWED = {
    "balls": {*SHARED, *RENDERED, "balls", "radius", "ball_speed", "spin", "distance", "collide", "clutter"},
    "people": {*SHARED, *RENDERED, "people", "speed", "texture", "light_drift", "light_period", "shadows"},
}
"""Options of each kind of scene."""


def check_kind(kind: str | None, scene: Path | None, paths: Path | None, given: Mapping[str, Any]) -> None:
    """UsageError for options that are not about the scene that was asked for.

    Args:
        kind: value of --scene; None: the scene comes from a file.
        scene: the SCENE argument.
        paths: value of --paths.
        given: all other options that were given.
    """
    if kind is None:
        if scene is None:
            raise UsageError("no scene: give SCENE (a file), or --scene balls or people")
        if scene.name in KINDS and not scene.exists():
            raise UsageError(f"{scene}: no such file; the video of {scene} is made with --scene {scene}")
        own = ALLOWED["balls"] | ALLOWED["people"]
        of_files = {*RENDERED, "speed", "texture", "light_drift", "light_period", "shadows"}
        for name in given:
            if name in own - of_files:
                kinds = " or ".join(f"--scene {k}" for k in KINDS if name in ALLOWED[k])
                raise UsageError(f"--{name.replace('_', '-')} is an option of {kinds}")
        return
    if scene is not None:
        raise UsageError(f"--scene {kind} makes its own scene; leave out {scene}")
    for name in (*(["paths"] if paths is not None else []), *given):
        if name not in ALLOWED[kind]:
            raise UsageError(f"--{name.replace('_', '-')} is not an option of --scene {kind}")
