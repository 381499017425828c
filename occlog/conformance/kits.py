"""The kit of each kind of plug-in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from occlog.errors import UsageError
from occlog.io.files.limits import check_input
from occlog.plugins.loading import DETECTOR, EXPORTER, METHOD, METRIC, READER, VIEW_TRACKER, Plugin

from . import detectors, exporters, filters, metrics, view_trackers
from .faults import Check
from .readers import checks_with

KITS: Mapping[str, Mapping[str, Check]] = {
    METHOD: filters.CHECKS,
    VIEW_TRACKER: view_trackers.CHECKS,
    DETECTOR: detectors.CHECKS,
    METRIC: metrics.CHECKS,
    EXPORTER: exporters.CHECKS,
}
"""Checks by kind; those of readers need a file."""


def kit_of(plugin: Plugin, sample: Path | None) -> Mapping[str, Check]:
    """Return the checks for a plug-in, by name.

    Args:
        plugin: the plug-in.
        sample: file that a reader should be able to read; None for other kinds.

    Raises:
        UsageError: a reader without a sample, or a sample for a plug-in of another kind.
        InputError: the sample is missing or empty.
    """
    if plugin.kind != READER:
        if sample is not None:
            raise UsageError(
                f"--sample is for readers; plug-in {plugin.name} is a {plugin.kind}: leave it out", id="not-applicable"
            )
        return KITS[plugin.kind]
    if sample is None:
        raise UsageError(
            f"plug-in {plugin.name} is a reader: give a valid file of its format (--sample FILE)", id="missing-option"
        )
    return checks_with(check_input(sample, f"a file that {plugin.name} reads"))
