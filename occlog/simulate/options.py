"""Options of `occlog simulate`: what each kind of scene takes."""

from __future__ import annotations

import re
from typing import Any

import click

from occlog.cli.numbers import AT_LEAST_0, RATE
from occlog.cli.options import PATH
from occlog.cli.setting_options import options_of
from occlog.simulate.balls.config import BallsConfig

from .config import ObserveConfig, PeopleConfig, RenderConfig, SoundConfig, StoreConfig, WorldConfig

RENDER_PREFIX = "render_"
"""Of the names of parameters that are settings of the video: the noise of images is not that of cameras."""


class ImageSize(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """WIDTHxHEIGHT in pixels."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
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
    return [*options_of(WorldConfig), *_times(), *_sensing()]


def paths_params() -> list[click.Parameter]:
    """Options of a scene from a file in which targets follow a script."""
    paths = click.Option(
        ["--paths"],
        type=PATH,
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
