"""Doubts of rows while one sensor contradicts the estimate."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.consistency.estimates import SensorDisagreement
from occlog.records.tables import Diagnostics, Residuals

STEP = 100_000_000


def notes(count: int, first: int = 0, doubt: str = "") -> Diagnostics:
    """Rows of one target every tenth of a second."""
    values = {c.name: np.full(count, "" if c.kind == "U" else 1, c.dtype) for c in Diagnostics.columns()}
    own = {"t_ns": np.arange(first, first + count) * STEP, "target_id": np.zeros(count, np.int32)}
    return Diagnostics(**(values | own | {"quality_flags": np.full(count, doubt)}))


def residuals(believed: dict[str, str], first: int = 0) -> Residuals:
    """Of each sensor a bearing a row: believed (1), not believed (0), or none (-)."""
    found = [(first + n, name, float(b)) for name, text in believed.items() for n, b in enumerate(text) if b != "-"]
    step, sensor, belief = zip(*sorted(found), strict=True)
    n = len(found)
    return Residuals.of(
        t_ns=np.array(step, np.int64) * STEP,
        target_id=np.zeros(n, np.int32),
        sensor=np.array(sensor),
        residual=np.zeros(n),
        expected_variance=np.ones(n),
        inlier_probability=np.array(belief),
    )


def against(found: Diagnostics) -> str:
    return "".join("x" if d == "inconsistent_sensor" else "." for d in found.quality_flags.tolist())


@pytest.mark.parametrize(
    ("a", "expected"),
    [
        ("1" * 20, "." * 20),
        ("1" * 4 + "0" * 16, "." * 10 + "x" * 10),  # at least two thirds of ten bearings
        ("0" * 4 + "1" * 16, "." * 20),  # fewer than five of them
        ("0" * 5 + "1" * 15, "." * 4 + "xxx" + "." * 13),  # 5 of 5, of 6, of 7
        ("10" * 10, "." * 20),  # half of them
        ("---0" * 5, "." * 20),  # too few in a second
    ],
)
def test_a_sensor_contradicts_by_most_of_its_bearings_of_the_last_second(a: str, expected: str) -> None:
    assert against(SensorDisagreement().judged(notes(20), residuals({"a": a, "b": "1" * 20}))) == expected


def test_single_false_bearings_of_several_sensors_are_no_contradiction() -> None:
    each = {name: "1" * k + "01111" * 4 for k, name in enumerate("abcde")}
    assert "x" not in against(SensorDisagreement().judged(notes(20), residuals({k: v[:20] for k, v in each.items()})))


def test_chunks_do_not_matter_and_other_doubts_stay() -> None:
    text = "1" * 4 + "0" * 16
    whole = against(SensorDisagreement().judged(notes(20), residuals({"a": text})))
    judge, parts = SensorDisagreement(), []
    for first in range(0, 20, 3):
        end = min(first + 3, 20)
        parts.append(against(judge.judged(notes(end - first, first), residuals({"a": text[first:end]}, first))))
    assert "".join(parts) == whole
    edge = SensorDisagreement().judged(notes(20, doubt="region_edge"), residuals({"a": text}))
    assert edge.quality_flags[-1] == "region_edge,inconsistent_sensor"
    assert SensorDisagreement().judged(Diagnostics.empty(), Residuals.empty()).quality_flags.tolist() == []
