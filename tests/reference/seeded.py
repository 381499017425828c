"""Faults that every kind of plug-in can have, seeded into a working one, and the tests that all kits pass."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from places import ROOT

from occlog.conformance.faults import BrokenError, faults_by
from occlog.plugins.interface import Settings

Faulty = Mapping[str, type]


def example(name: str) -> ModuleType:
    """A module of the examples of plug-ins."""
    path = ROOT / f"examples/plugins/{name}.py"
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def common_faults(good: Any, function: str) -> dict[str, type]:
    """The faults that `manners` and the interface must find, by the check that must find them."""

    def before(act: Callable[[Any], None]) -> type:
        def called(self: Any, *given: Any) -> Any:
            act(self)
            return getattr(good, function)(self, *given)

        return type("Seeded", (good,), {function: called})

    @dataclass(frozen=True)
    class Undeclared(Settings):
        OWNER = "x"
        more: float = 1.0

    return {
        "interface": type("TwoLines", (good,), {"summary": "one\ntwo"}),
        "settings": type("UndeclaredSetting", (good,), {"settings": Undeclared}),
        "global-random": before(lambda _: np.random.normal()),  # type: ignore[arg-type,return-value]  # noqa: NPY002
        "output": before(lambda _: print("busy")),  # noqa: T201
        "warnings": before(lambda _: warnings.warn("it is late", RuntimeWarning, stacklevel=2)),
        "surroundings": before(lambda _: os.environ.__setitem__("OMP_NUM_THREADS", "7")),
    }


LEFT_BEHIND: list[bytes] = []


def hoard(*_: object) -> None:
    """Keep something for ever."""
    LEFT_BEHIND.append(bytes(20_000))


def check_seeded(checks: Mapping[str, Callable[[Any], None]], faulty: Faulty, name: str) -> None:
    """The fault is found by the check of its name."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(BrokenError):
            checks[name](faulty[name])
    LEFT_BEHIND.clear()


def check_kit(checks: Mapping[str, Callable[[Any], None]], faulty: Faulty, good: Any, folder: Path) -> None:
    """Every check has a seeded fault, nothing is found in what has none, and a broken interface ends the list."""
    assert set(faulty) == set(checks)
    assert folder == Path.cwd()
    assert faults_by(checks, good) == []
    assert [fault.check for fault in faults_by(checks, faulty["interface"])] == ["interface"]
