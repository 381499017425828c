"""Options that several commands share, so that they mean the same everywhere.

-o, --output PATH      the main output                          all that write
--overwrite            replace outputs that exist               all that write
--scene PATH           scene file, instead of the recording's   detect track evaluate report
--seed N               seed of all random numbers               simulate track run
--json                 the summary as JSON on standard output   all
-v / -q                more / fewer messages                    all

Values of options: finite numbers, which the ranges of click alone do not promise, settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.types import FloatParamType

from occlog.errors import UsageError
from occlog.settings import read_pair

from .input_paths import Input
from .startup import remember_quiet

F = TypeVar("F", bound=Callable[..., object])
PATH = click.Path(path_type=Path)
"""Parameter type of the path of an output, a folder or a configuration."""
INPUT = Input()
"""Parameter type of an input; `-` is standard input."""

overwrite_opt = click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
json_opt = click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
seed_opt = click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of all random numbers; equal seeds give equal results.",
)
SCENE_HELP = "Scene file (YAML), a recording that contains one, or a text table of sensor positions (name, x, y)."
scene_opt = click.option("--scene", type=INPUT, default=None, help=SCENE_HELP)
STRICT_HELP = "Exit with code 6 if a consistency check fails. Outputs are written anyway."
strict_opt = click.option("--strict", is_flag=True, help=STRICT_HELP)
quiet_opt = click.option(
    "-q",
    "--quiet",
    is_flag=True,
    callback=remember_quiet,
    help="No progress bars, notes and warnings on standard error; findings remain in the outputs.",
)


def set_opt(example: str) -> Callable[[F], F]:
    """Decorator that adds `--set NAME=VALUE` for settings without an option of their own.

    `example`: one for its help.
    """
    return click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="NAME=VALUE",
        help=f"A setting NAME=VALUE, of those listed at the end of this help, e.g. {example}; may be repeated.",
    )


def output_opt(help_text: str, *, required: bool = True) -> Callable[[F], F]:
    """Decorator that adds the option `-o/--output`, a path; `help_text`: its help.

    `required`: whether it must be given.
    """
    return click.option("-o", "--output", type=PATH, required=required, help=help_text)


class Finite(click.FloatRange):
    """Parameter type: number in a range, without NaN and infinity (which click accepts in ranges)."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return `value` as a float; usage error unless it is finite and in the range."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class AnyFinite(FloatParamType):
    """Parameter type of any number but NaN and infinity."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return `value` as a float; usage error unless it is finite."""
        return Finite().convert(value, param, ctx)


class NumberOrFile(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """Parameter type: number with a lower limit, or path of a file that states the number."""

    name = "number or file"

    def __init__(self, low: float) -> None:
        """Create a type that takes finite numbers of at least `low`, and paths."""
        self._number, self._path = Finite(low), click.Path(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | Path:
        """Return `value` as a float, or as a path if it is no number; usage error for a number below the limit."""
        try:
            float(value)
        except (TypeError, ValueError):
            return Path(self._path.convert(value, param, ctx))
        return self._number.convert(value, param, ctx)


class Pair(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """Parameter type: two whole numbers, as a range A:B or (with `size`) a size WIDTHxHEIGHT."""

    def __init__(self, *, size: bool) -> None:
        self.name, self._size = "size" if size else "range", size

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Return `value`, for example `0:100` or `640x480`, as two whole numbers; usage error for another text."""
        if isinstance(value, tuple):
            return value
        try:
            return read_pair(str(value), self._size)
        except UsageError as error:
            self.fail(str(error), param, ctx)


FRAMES, SIZE = Pair(size=False), Pair(size=True)


def parse_setting(text: str) -> tuple[str, str]:
    """Return (name, value) of a text `NAME=VALUE` of `--set`; UsageError for other text."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UsageError(f"--set {text}: expected NAME=VALUE")
    return name.strip(), value
