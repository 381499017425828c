"""The kit of trackers of one camera finds each seeded fault by the name of its check, and nothing in a good one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seeded import check_kit, check_seeded, common_faults, example

from occlog.conformance.view_trackers import CHECKS, FRAMES, START_NS
from occlog.plugins.interface import BoxesInFrame

Good: Any = example("own_parts/own_images").OverlapTracker


def changed(act: Any) -> type:
    """The good one, whose identities are changed: called with the object, the frame and the identities."""
    return type("Changed", (Good,), {"step": lambda self, found: act(self, found, Good.step(self, found))})


def _asserts(holds: Any) -> type:
    def step(self: Any, found: BoxesInFrame) -> Any:
        assert holds(self, found)
        return Good.step(self, found)

    return type("Asserts", (Good,), {"step": step})


def _moves(self: Any, found: BoxesInFrame) -> Any:
    found.boxes[:] += 1.0
    return Good.step(self, found)


def _held(self: Any, found: BoxesInFrame, ids: Any) -> Any:
    self.held = self.__dict__.get("held", np.zeros(60, dtype=np.int64))
    self.held[: len(ids)] = ids
    return self.held[: len(ids)]


def _history(self: Any, found: BoxesInFrame, ids: Any) -> Any:
    self.__dict__.setdefault("all", []).append(found)
    return ids


SHARED = {"count": 0}


def _shared(self: Any, found: BoxesInFrame, ids: Any) -> Any:
    SHARED["count"] += 1
    return ids + SHARED["count"] // 11 % 7 * (10**3 if SHARED["count"] > 40 else 0)


def _steady(self: Any, found: BoxesInFrame) -> bool:
    before = self.__dict__.get("before")
    self.before = found
    return before is None or found.frame - before.frame < 1000


def _later(self: Any, found: BoxesInFrame) -> bool:
    before = self.__dict__.get("t_ns", -1)
    self.t_ns = found.t_ns
    return found.t_ns > before


FAULTS = {
    **common_faults(Good, "step"),
    "shape": changed(lambda self, found, ids: ids[:1]),
    "numbers": changed(lambda self, found, ids: ids - 5),
    "once": changed(lambda self, found, ids: np.zeros(len(ids), dtype=np.int64)),
    "follows": changed(lambda self, found, ids: ids + 2 * found.frame),
    "apart": changed(lambda self, found, ids: ids[::-1].copy() if found.frame > FRAMES // 2 else ids),
    "newcomer": changed(lambda self, found, ids: np.where(ids == 2, 0, ids + 1) if len(ids) == 3 else ids),
    "order": changed(lambda self, found, ids: np.arange(len(ids))),
    "independent": changed(_shared),
    "inputs": type("Moves", (Good,), {"step": _moves}),
    "results": changed(_held),
    "memory": changed(_history),
    "empty": _asserts(lambda self, found: len(found.boxes)),
    "crowd": _asserts(lambda self, found: len(found.boxes) < 50),
    "same-box": _asserts(lambda self, found: len(np.unique(found.boxes, axis=0)) == len(found.boxes)),
    "unknown-scores": changed(lambda self, found, ids: np.where(found.scores > 0, ids, -2)),
    "embeddings": _asserts(lambda self, found: np.isfinite(found.embeddings).all()),
    "gap": _asserts(_steady),
    "same-time": _asserts(_later),
    "epoch": changed(lambda self, found, ids: ids if found.t_ns >= START_NS else ids + found.frame),
    "determinism": changed(lambda self, found, ids: ids + int(np.random.default_rng().integers(10**6))),
}
"""A tracker with one fault, by the check that must find it."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_seeded_fault_is_found_by_name(name: str) -> None:
    check_seeded(CHECKS, FAULTS, name)


def test_the_kit_is_complete_and_finds_nothing_in_a_good_one(tmp_path: Path) -> None:
    check_kit(CHECKS, FAULTS, Good, tmp_path)
