"""The kit of metrics finds each seeded fault by the name of its check, and nothing in one without fault."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seeded import check_kit, check_seeded, common_faults, example, hoard

from occlog.conformance.metrics import CHECKS
from occlog.plugins.interface import MetricInput

Gaps: Any = example("own_parts/own_tables").Gaps


class Good(Gaps):
    """With a length and a share next to the times."""

    units = {"longest": "s", "tracks": "1", "far": "length"}  # noqa: RUF012

    def figures(self, compared: MetricInput) -> Any:
        far = compared.errors.error.max() if len(compared.errors) else np.nan
        return {**super().figures(compared), "far": far}


def changed(**more: Any) -> type:
    """The good one with figures changed; each is called with the tables and its value."""

    def figures(self: Any, compared: MetricInput) -> Any:
        found = Good.figures(self, compared)
        return {**found, **{name: act(compared, found[name]) for name, act in more.items()}}

    return type("Changed", (Good,), {"figures": figures})


class UpperCase(Good):
    units = {"Longest": "s"}  # noqa: RUF012


class KeepsTheLast(Good):
    count = 0

    def figures(self, compared: MetricInput) -> Any:
        self.count += 1
        return {**super().figures(compared), "tracks": self.count}


class ChangesInputs(Good):
    def figures(self, compared: MetricInput) -> Any:
        compared.tracks.x[:] = 0.0
        return super().figures(compared)


class Undeclared(Good):
    def figures(self, compared: MetricInput) -> Any:
        return {**super().figures(compared), "more": 1.0}


class Hoards(Good):
    def figures(self, compared: MetricInput) -> Any:
        hoard()
        return super().figures(compared)


NUMBER = itertools.count()
FAULTS = {
    **common_faults(Good, "figures"),
    "units": UpperCase,
    "figures": Undeclared,
    "known": changed(**dict.fromkeys(Good.units, lambda *_: np.nan)),
    "inputs": ChangesInputs,
    "reuse": KeepsTheLast,
    "no-tracks": changed(tracks=lambda given, _: given.tracks.t_ns.max()),
    "no-truth": changed(tracks=lambda given, _: given.truth.t_ns.max()),
    "no-pairs": changed(far=lambda given, _: given.errors.error.max()),
    "one-row": changed(longest=lambda given, _: np.diff(given.tracks.t_ns).max() * 1e-9 if len(given.tracks) else 0),
    "no-covariance": changed(tracks=lambda given, value: value if np.isfinite(given.errors.nees).all() else np.inf),
    "numbers": changed(tracks=lambda given, _: np.count_nonzero(given.tracks.target_id == 3)),
    "shift": changed(far=lambda given, _: given.tracks.x.max(initial=0.0)),
    "unit": changed(far=lambda given, value: value + 1.0),
    "epoch": changed(longest=lambda given, _: given.tracks.t_ns.max(initial=0) * 1e-9),
    "determinism": changed(tracks=lambda *_: next(NUMBER)),
    "memory": Hoards,
}
"""A metric with one fault, by the check that must find it."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_seeded_fault_is_found_by_name(name: str) -> None:
    check_seeded(CHECKS, FAULTS, name)


def test_the_kit_is_complete_and_finds_nothing_in_a_good_one(tmp_path: Path) -> None:
    check_kit(CHECKS, FAULTS, Good, tmp_path)
