"""The kit finds each seeded fault by the name of its check, and nothing in a filter without fault."""

from __future__ import annotations

import importlib.util
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT

from occlog.conformance.faults import BrokenError, faults_by
from occlog.conformance.filters import CHECKS
from occlog.plugins.interface import TargetScan

SPEC = importlib.util.spec_from_file_location("own_filter", ROOT / "examples/plugins/own_filter/own_filter.py")
assert SPEC is not None
assert SPEC.loader is not None
MODULE = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(MODULE)
Own: Any = MODULE.OwnFilter


class TwoLines(Own):
    summary = "one\ntwo"


class UndeclaredSetting(Own):
    @dataclass(frozen=True)
    class OwnSettings(MODULE.OwnSettings):  # type: ignore[misc,name-defined]
        OWNER = "own"
        more: float = 1.0

    settings = OwnSettings


class GivesATuple(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else (*estimate.xy,)


class GivesNan(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(xy=estimate.xy * np.nan)


class Lopsided(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(covariance=estimate.covariance + 1e-3 * np.eye(2, k=1))


class NegativeVariance(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(covariance=-estimate.covariance)


class SwapsAxes(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(xy=estimate.xy[::-1])


class BoldCovariance(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(covariance=1e-4 * estimate.covariance)


class OwnEntropy(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return (
            None
            if estimate is None
            else estimate._replace(xy=estimate.xy + 1e-9 * np.random.default_rng().normal(size=2))
        )


class SharedGenerator(Own):
    def step(self, scan: TargetScan) -> object:
        np.random.normal()  # noqa: NPY002
        return super().step(scan)


class StateOfTheClass(Own):
    last = np.zeros(2)

    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        if estimate is None:
            return None
        mixed = estimate._replace(xy=estimate.xy + 1e-6 * type(self).last)
        type(self).last = estimate.xy
        return mixed


class ChangesInputs(Own):
    def step(self, scan: TargetScan) -> object:
        scan.bearings[:] += 0.0001
        return super().step(scan)


class ChangesResults(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        if estimate is None:
            return None
        self.held = self.__dict__.get("held", np.zeros(2))
        self.held[:] = estimate.xy
        return estimate._replace(xy=self.held)


class Prints(Own):
    def step(self, scan: TargetScan) -> object:
        print("step", scan.t_ns)  # noqa: T201
        return super().step(scan)


class Warns(Own):
    def step(self, scan: TargetScan) -> object:
        warnings.warn("it is late", RuntimeWarning, stacklevel=2)
        return super().step(scan)


class SetsEnvironment(Own):
    def step(self, scan: TargetScan) -> object:
        os.environ["OMP_NUM_THREADS"] = "7"
        return super().step(scan)


class KeepsHistory(Own):
    def step(self, scan: TargetScan) -> object:
        self.__dict__.setdefault("history", []).append(scan)
        return super().step(scan)


class WantsRows(Own):
    def step(self, scan: TargetScan) -> object:
        scan.bearings.max()
        return super().step(scan)


class TakesNanForNumbers(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(velocity=np.full(2, scan.bearings.sum()))


class CountsStepsInAGap(Own):
    def step(self, scan: TargetScan) -> object:
        before = self.__dict__.setdefault("before", scan.t_ns)
        self.before = scan.t_ns
        if scan.t_ns - before > 60 * 10**9:
            raise IndexError("no such row")
        return super().step(scan)


class DividesByTheTime(Own):
    def step(self, scan: TargetScan) -> object:
        before = self.__dict__.get("before", 0)
        self.before = scan.t_ns
        1 / (scan.t_ns - before)
        return super().step(scan)


class FailsWhenTimeGoesBack(Own):
    def step(self, scan: TargetScan) -> object:
        before = self.__dict__.setdefault("before", scan.t_ns)
        self.before = scan.t_ns
        assert scan.t_ns >= before
        return super().step(scan)


class WantsThreeSensors(Own):
    def step(self, scan: TargetScan) -> object:
        if scan.sensors and len(set(scan.sensors)) == 2:
            raise KeyError("south")
        return super().step(scan)


class WantsTwoSensors(Own):
    def step(self, scan: TargetScan) -> object:
        if len(set(scan.sensors)) == 1:
            raise KeyError("second sensor")
        return super().step(scan)


class OneRowASensor(Own):
    def step(self, scan: TargetScan) -> object:
        if len(set(scan.sensors)) < len(scan.sensors):
            raise ValueError("a sensor is there twice")
        return super().step(scan)


class RoundsSigma(Own):
    def step(self, scan: TargetScan) -> object:
        return super().step(scan._replace(sigma=np.round(scan.sigma, 4)))


class BelievesTheFirst(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        far = 5.0 if scan.sensors[:1] == ("west",) else 0.0
        return None if estimate is None else estimate._replace(xy=estimate.xy + far)


class DoesNotWrap(Own):
    def step(self, scan: TargetScan) -> object:
        wrong = np.where(scan.bearings < -2.0, scan.bearings + 0.5, scan.bearings)
        return super().step(scan._replace(bearings=wrong))


class NearTheOrigin(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(xy=np.clip(estimate.xy, -500.0, 500.0))


class OffByMetres(Own):
    def step(self, scan: TargetScan) -> object:
        estimate = super().step(scan)
        return None if estimate is None else estimate._replace(xy=estimate.xy + 2.0)


class SecondsInFloat32(Own):
    def step(self, scan: TargetScan) -> object:
        return super().step(scan._replace(t_ns=int(np.float32(scan.t_ns * 1e-9)) * 10**9))


FAULTS = {
    "interface": TwoLines,
    "settings": UndeclaredSetting,
    "shape": GivesATuple,
    "finite": GivesNan,
    "symmetric": Lopsided,
    "definite": NegativeVariance,
    "follows": SwapsAxes,
    "consistent": BoldCovariance,
    "determinism": OwnEntropy,
    "global-random": SharedGenerator,
    "independent": StateOfTheClass,
    "inputs": ChangesInputs,
    "results": ChangesResults,
    "output": Prints,
    "warnings": Warns,
    "surroundings": SetsEnvironment,
    "memory": KeepsHistory,
    "empty": WantsRows,
    "hidden": TakesNanForNumbers,
    "gap": CountsStepsInAGap,
    "same-time": DividesByTheTime,
    "time-back": FailsWhenTimeGoesBack,
    "two-sensors": WantsThreeSensors,
    "one-sensor": WantsTwoSensors,
    "candidates": OneRowASensor,
    "sharp": RoundsSigma,
    "order": BelievesTheFirst,
    "wrap": DoesNotWrap,
    "shift": NearTheOrigin,
    "unit": OffByMetres,
    "epoch": SecondsInFloat32,
}
"""A filter with one fault, by the check that must find it."""


def test_every_check_has_a_seeded_fault() -> None:
    assert set(FAULTS) == set(CHECKS)


@pytest.mark.parametrize("name", FAULTS)
def test_a_seeded_fault_is_found_by_name(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(BrokenError):
            CHECKS[name](FAULTS[name])


def test_a_filter_without_fault_passes_every_check() -> None:
    assert faults_by(CHECKS, Own) == []
