"""The kit of readers finds each seeded fault by the name of its check, and nothing in one without fault."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seeded import check_kit, check_seeded, common_faults, example, hoard

from occlog.conformance.readers import checks_with

Good: Any = example("own_parts/own_tables").CompassLog


@pytest.fixture
def checks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Callable[[Any], None]]:
    path = tmp_path_factory.mktemp("sample") / "walk.compass"
    lines = (f"{0.5 * k:.1f} {name} {10 + 0.5 * k:.2f}\n" for k in range(20) for name in ("north", "east"))
    path.write_text("".join(lines), encoding="utf-8")
    return checks_with(path)


def changed(act: Any) -> type:
    """The good one, whose columns are changed: called with the object, the path and the columns."""
    return type("Changed", (Good,), {"read": lambda self, path: act(self, path, Good.read(self, path))})


def instead(read: Any) -> type:
    """The good one that reads otherwise."""
    return type("Instead", (Good,), {"read": read})


def _without(found: Any, name: str) -> Any:
    return {key: values for key, values in found.items() if key != name}


def _appends(self: Any, path: Path) -> Any:
    found = Good.read(self, path)
    with path.open("a", encoding="utf-8") as file:
        file.write("99.0 north 7.0\n")
    return found


def _open(self: Any, path: Path) -> Any:
    KEPT.append(path.open("rb"))
    return Good.read(self, path)


KEPT: list[Any] = []


def _counts(self: Any, path: Path, found: Any) -> Any:
    self.files = self.__dict__.get("files", -1) + 1
    return {**found, "id": found["id"] + self.files}


def _default(self: Any, path: Path) -> Any:
    if not path.is_file():
        return {"time_s": [0.0], "sensor": ["north"], "bearing_deg": [0.0], "sigma_deg": [1.0], "id": [0]}
    return Good.read(self, path)


def _trusting(self: Any, path: Path) -> Any:
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    return {"time_s": [float(row[0]) for row in rows], "sensor": [row[1] for row in rows]} | {
        "bearing_deg": [90.0 - float(row[2]) for row in rows],
        "sigma_deg": np.ones(len(rows)),
        "id": np.zeros(len(rows), dtype=np.int64),
    }


def _skips(self: Any, path: Path) -> Any:
    try:
        return Good.read(self, path)
    except ValueError:
        return {"time_s": [], "sensor": [], "bearing_deg": [], "sigma_deg": [], "id": []}


def _wants_twenty(self: Any, path: Path, found: Any) -> Any:
    assert len(found["time_s"]) <= 40
    return found


def _flipped(self: Any, path: Path) -> Any:
    try:
        return Good.read(self, path)
    except ValueError as error:
        raise KeyError(str(error)) from error


NUMBER = itertools.count()
FAULTS = {
    **common_faults(Good, "read"),
    "endings": type("NoPoint", (Good,), {"endings": ("compass",)}),
    "table": type("Trucks", (Good,), {"table": "trucks"}),
    "columns": changed(lambda self, path, found: {**found, "time_s": found["time_s"][1:]}),
    "fits": changed(lambda self, path, found: _without(found, "sensor")),
    "used": changed(lambda self, path, found: {**found, "colour": found["id"]}),
    "place": changed(lambda self, path, found: {**found, "id": found["id"] + (path.name != "walk.compass")}),
    "unchanged": instead(_appends),
    "closed": instead(_open),
    "reuse": changed(_counts),
    "absent": instead(_default),
    "cut": instead(_trusting),
    "garbage": instead(_skips),
    "flipped": instead(_flipped),
    "size": changed(_wants_twenty),
    "determinism": changed(lambda self, path, found: {**found, "id": found["id"] + next(NUMBER)}),
    "memory": changed(lambda self, path, found: hoard() or found),
}
"""A reader with one fault, by the check that must find it."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_seeded_fault_is_found_by_name(name: str, checks: dict[str, Callable[[Any], None]]) -> None:
    check_seeded(checks, FAULTS, name)
    while KEPT:
        KEPT.pop().close()


def test_the_kit_is_complete_and_finds_nothing_in_a_good_one(
    tmp_path: Path, checks: dict[str, Callable[[Any], None]]
) -> None:
    check_kit(checks, FAULTS, Good, tmp_path)
