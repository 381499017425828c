"""Figures of plug-ins: tracks and truth in, figures with the plug-in's name and their units out."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Mapping
from dataclasses import replace

from occlog.errors import PluginError, UsageError
from occlog.plugins.chosen import Chosen
from occlog.plugins.interface import Compared, Metric
from occlog.plugins.loading import said_by
from occlog.records.tables import Tracks, Truth
from occlog.settings import METRES

from .results import Evaluation

PURE = ("", "1")
"""Units of numbers without one, which end no name."""


def full_name(plugin: str, figure: str, unit: str, length_unit: str) -> str:
    """Name of a figure: the plug-in's, its own, and its unit: `gaps_longest_s`."""
    of = unit.replace("length", length_unit)
    own = f"{plugin.replace('-', '_')}_{figure}"
    return own if of in PURE else f"{own}_{of}"


def names_of_figures(plugged: Iterable[Chosen]) -> set[str]:
    """Full names of the figures that plug-ins give, in any unit of length."""
    lengths = (*METRES, "unit")
    return {
        full_name(each.plugin.name, name, unit, length)
        for each in plugged
        for name, unit in each.plugin.load().units.items()
        for length in lengths
    }


def fault_of(figures: object, units: Mapping[str, str]) -> str | None:
    """What is wrong with what a metric gave back, in words; None: nothing."""
    if not isinstance(figures, Mapping):
        return f"figures gives a {type(figures).__name__}; a mapping of names to numbers was expected"
    for name in units:
        if name not in figures:
            return f"figures gives no {name}, which units declares"
    for name, value in figures.items():
        if name not in units:
            return f"figures gives {name}, which units does not declare"
        if not isinstance(value, numbers.Real):
            return f"{name} is a {type(value).__name__}; a number was expected"
        if math.isinf(value):
            return f"{name} is infinite; NaN says that there is nothing to compute it from"
    return None


def with_plugins(
    result: Evaluation, plugged: Iterable[Chosen], tracks: Tracks, truth: Truth, length_unit: str
) -> Evaluation:
    """The evaluation with the figures of plug-ins; PluginError where one fails or gives what cannot be."""
    metrics, names = dict(result.metrics), list[str]()
    for each in plugged:
        own: Metric = each.make(length_unit)
        with said_by(each.plugin):
            found = own.figures(Compared(tracks, truth, result.errors, length_unit))
        wrong = fault_of(found, own.units)
        if wrong is not None:
            raise PluginError(f"{each.plugin.label}: {wrong}")
        named = {full_name(each.plugin.name, n, own.units[n], length_unit): float(v) for n, v in found.items()}
        both = sorted(named.keys() & metrics.keys())
        if both:
            raise UsageError(f"{each.plugin.label}: {both[0]} is a figure of the evaluation itself; rename the plug-in")
        metrics |= named
        names += named
    return replace(result, metrics=metrics, plugged=tuple(names))
