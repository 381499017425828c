"""Merged figures of several recordings are those of one recording in which these follow one another."""

from __future__ import annotations

from copy import deepcopy
from typing import TypeVar

import numpy as np
import pytest
from tracked_crowds import crowd, views

from occlog.array_types import NS
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.on_ground import GroundFigures, evaluate_ground
from occlog.evaluate.mot.stage import ComparedBoxes
from occlog.evaluate.run import NOT_COMBINED
from occlog.evaluate.sources import EvaluationSources, in_memory
from occlog.evaluate.stage import Evaluator
from occlog.records.columns import ColumnTable
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Tracks, Truth, TruthBoxes

T = TypeVar("T", bound=ColumnTable)
APART = 3600 * NS
"""Time between recordings that follow one another; no gap is bridged over it."""
GROUND = MultiTargetConfig(match_distance=1.0, moda_distance=0.5, assigned_target="optimal", ospa_window=7)
IMAGES = MultiTargetConfig(assigned_target="optimal", gospa_px=30.0)


def later(table: T, number: int) -> T:
    """A recording after so many others, with identities and cameras of its own."""
    changed = {
        "t_ns": table.t_ns + number * APART,  # type: ignore[attr-defined]
        "target_id": np.where(table.target_id < 0, -1, table.target_id + 1000 * number).astype(np.int32),  # type: ignore[attr-defined]
    }
    if isinstance(table, Boxes):
        changed["sensor"] = np.array([f"{number} {name}" for name in table.sensor])
    return type(table)(**{c.name: getattr(table, c.name) for c in table.columns()} | changed)


def of_ground(tracks: Tracks, truth: Truth) -> GroundFigures:
    sources = EvaluationSources(tracks=in_memory(tracks), truth=in_memory(truth))
    return Evaluator(sources, Scene(), EvaluateConfig(match="optimal")).of_many(GROUND)


def compared(tracks: Boxes, truth: TruthBoxes) -> ComparedBoxes:
    return ComparedBoxes(lambda: iter([(tracks, truth)]), IMAGES)


def check(found: dict[str, float], whole: dict[str, float]) -> None:
    """Counts and quantiles to the last digit, sums up to rounding; nothing else is given."""
    wanted = {n: v for n, v in whole.items() if not n.startswith(NOT_COMBINED) and "_sensor_" not in n}
    found = {n: v for n, v in found.items() if not n.startswith(NOT_COMBINED)}
    assert set(found) == set(wanted)
    assert found == pytest.approx(wanted, rel=1e-12, nan_ok=True)
    exact = [n for n, v in wanted.items() if float(v).is_integer() or "median" in n or "p95" in n]
    assert {n: found[n] for n in exact} == {n: wanted[n] for n in exact}


@pytest.mark.jit
def test_on_the_ground() -> None:
    sides = [crowd(seed, people, 60) for seed, people in ((1, 4), (7, 3), (8, 5))]
    joined = (table.concat([later(one[k], n) for n, one in enumerate(sides)]) for k, table in ((0, Tracks), (1, Truth)))
    whole = evaluate_ground(*joined, GROUND, None).metrics
    assert whole["id_switches"] > 5 < whole["fragmentations"]
    a, b, c = (of_ground(*one) for one in sides)
    left, right = deepcopy(a), deepcopy(b)
    left.merge(b)
    left.merge(c)
    right.merge(c)
    a.merge(right)
    check(left.result(), whole)
    check(a.result(), whole)


@pytest.mark.jit
def test_in_images() -> None:
    sides = [views(seed) for seed in (2, 3, 5)]
    joined = [
        table.concat([later(one[k], n) for n, one in enumerate(sides)]) for k, table in ((0, Boxes), (1, TruthBoxes))
    ]
    whole = compared(joined[0], joined[1])
    wanted = whole.evaluate().metrics
    assert wanted["id_switches"] > 2 < wanted["fragmentations"]
    each = [compared(*one) for one in sides]
    a, b, c = (one.figures() for one in each)
    frames = [n for one in each for n in one.frames]
    counts = {name: sum(one.counts[name] for one in each) for name in each[0].counts}
    left, right = deepcopy(a), deepcopy(b)
    left.merge(b)
    left.merge(c)
    right.merge(c)
    a.merge(right)
    check(left.result(frames, counts), wanted)
    check(a.result(frames, counts), wanted)


def test_a_recording_without_tracks_adds_its_misses() -> None:
    tracks, truth = crowd(1, 3, 40)
    one, none = of_ground(tracks, truth), of_ground(Tracks.empty(), truth)
    before, missed = one.result(), none.result()
    one.merge(none)
    both = one.result()
    assert missed["fn"] == before["objects"]
    assert both["fn"] == before["fn"] + missed["fn"]
    assert (both["objects"], both["tp"]) == (2 * before["objects"], before["tp"])
    assert both["idf1"] == pytest.approx(2 * before["idtp"] / (2 * before["objects"] + before["estimates_compared"]))
