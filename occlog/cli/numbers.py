"""Numbers as option values: finite ones, which the ranges of click alone do not promise."""

from __future__ import annotations

import math
from typing import Any

import click
from click.types import FloatParamType


class Finite(click.FloatRange):
    """A range of numbers without NaN, which click lets pass every range, and without infinity."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number; a usage error for one that is not finite or not in the range."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class AnyFinite(FloatParamType):
    """Any number but NaN and infinity."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number; a usage error for one that is not finite."""
        return Finite().convert(value, param, ctx)


POSITIVE = Finite(min=0, min_open=True)
AT_LEAST_0 = Finite(min=0)
RATE = Finite(1e-3, 1_000_000)
"""Frames or steps a second: times are whole nanoseconds, and recordings last days at most."""
