"""Filters, rivals and exchanges of labels: the kernel against its form in matrices (`label_reference`)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from label_reference import Continuity, Walk

from occlog.array_types import Floats, Ints
from occlog.scans.kernels.label_continuity import (
    ContinuityState,
    LabelledRows,
    SensorPositions,
    WalkingSpeed,
    follow_labels,
)

SENSORS = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 1e-3], [5.0, 9.0, 0.0], [-1.0, 8.0, 4e-4]])
WALK = Walk(0.5, 0.8, 0.01)
K, S = 3, len(SENSORS)


def empty() -> ContinuityState:
    """Filters of three labels that have no bearings yet."""
    position = np.tile([-np.inf, 0.0, 0.0, 0.0], (K, 1))
    return ContinuityState(
        mean=np.zeros((K, 4)), covariance=np.zeros((K, 4, 4)), known=np.zeros(K, dtype=np.int64),
        at_s=np.full(K, -np.inf), last=position, scale=np.ones(K), factors=np.zeros((K, 2)),
        accepted=np.zeros(K, dtype=np.int64), agreed=np.zeros(K, dtype=np.int64),
        confirmed=np.zeros(K, dtype=np.int64), before=position.copy(),
        contradicted=np.column_stack([np.full(K, np.inf), np.ones(K), position, position]),
        rival_mean=np.zeros((K, 4)), rival_covariance=np.zeros((K, 4, 4)),
        rival=np.column_stack([np.full(K, np.inf), np.zeros((K, 5))]), recent=np.full((K, S, 3), -np.inf),
        identity=np.tile(np.arange(K), (S, 1)), odds=np.zeros((S + 1, K, K)), open_s=np.full((S + 1, K, K), np.inf),
    )  # fmt: skip


def recording(
    seed: int, event: str, noise: float, steps: int = 60
) -> list[tuple[float, list[tuple[int, int, float, float]]]]:
    """Bearings of three people at 10 Hz, a tenth of them false and a fifth missing; from 2.5 s to 4.5 s the event."""
    rng, out = np.random.default_rng(seed), []
    at, velocity = rng.uniform([2.0, 2.0], [8.0, 6.0], (K, 2)), rng.normal(0.0, 0.5, (K, 2))
    for step in range(steps):
        now, rows = round(0.1 * step, 9), []
        at = at + 0.1 * velocity
        event_now = 25 <= step < 45
        where = at + 4.0 * np.array([[1.0], [0.0], [0.0]]) * np.sign(5.0 - at[0]) * (event == "jump" and step >= 25)
        for s in range(S):
            for k in range(K):
                d = where[k] - SENSORS[s, :2]
                sigma = noise if k else 2.0 * noise
                z = math.atan2(d[1], d[0]) + sigma * rng.normal() + (rng.random() < 0.1) * rng.normal(0.0, 0.5)
                label = k
                if event_now and k < 2 and (event in ("all", "blunt") or (event == "one" and s == 1)):
                    label = 1 - k
                if not (event == "pause" and k == 0 and 20 <= step < 45) and rng.random() > 0.1:
                    z = math.remainder(z, 2.0 * math.pi) if rng.random() > 0.1 else math.nan
                    rows.append((s, label, z, sigma**2))
        out.append((now, rows))
    return out


@pytest.mark.parametrize(
    ("seed", "event", "noise"),
    [(0, "all", 0.01), (1, "one", 0.01), (0, "jump", 0.01), (1, "pause", 0.01), (2, "blunt", 0.12), (3, "blunt", 0.12)],
)
def test_labels_are_followed_as_in_matrices(seed: int, event: str, noise: float) -> None:
    made, form, state = recording(seed, event, noise), Continuity(K, SENSORS, WALK), empty()
    rows = [(now, *row) for now, each in made for row in each]
    t, sensor, label, z, variance = (np.array(column) for column in zip(*rows, strict=True))
    given = LabelledRows(t, sensor.astype(np.int64), label.astype(np.int64), z, variance)
    sensors = SensorPositions(*(np.ascontiguousarray(column) for column in SENSORS.T))
    identity, against = np.zeros(len(t), dtype=np.int64), np.zeros(len(t), dtype=np.bool_)
    events: list[Floats] = []
    begun, open_s = 0, math.inf
    # In two parts: what is known goes on
    for end in (int(np.searchsorted(t, 2.75)), len(t)):
        part = LabelledRows(*(column[:end] for column in given))
        found, open_s = follow_labels(part, sensors, WalkingSpeed(*WALK), state, identity[:end], against[:end], begun)
        events += list(found)
        begun = end
    for now, each in made:
        form.step(now, each)
    compare(form, state, identity, against, events)
    assert open_s == form.open.min()
    kinds = [e[0] for e in form.events]
    assert (0.0 in kinds) or event not in ("all", "one")
    assert (1.0 in kinds) or event != "jump"


def compare(form: Continuity, state: ContinuityState, identity: Ints, against: Floats, events: list[Floats]) -> None:
    """All that both forms found, and what they know at the end."""
    np.testing.assert_array_equal(identity, form.found)
    np.testing.assert_array_equal(against, form.against)
    np.testing.assert_allclose(np.array(events).reshape(-1, 7), np.array(form.events).reshape(-1, 7), rtol=1e-6)
    np.testing.assert_allclose(state.odds, form.odds, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(state.open_s, form.open)
    np.testing.assert_array_equal(state.identity, form.identity)
    for k, own in enumerate(form.labels):
        assert state.known[k] == (own.track is not None)
        assert state.scale[k] == pytest.approx(own.scale)
        assert state.factors[k] == pytest.approx([sum(own.logs), len(own.logs)])
        assert [state.accepted[k], state.agreed[k], state.confirmed[k]] == [own.accepted, own.agreed, own.confirmed]
        assert state.contradicted[k, 0] == own.since
        if own.track is not None:
            np.testing.assert_allclose(state.mean[k], own.track.m, rtol=1e-7)
            np.testing.assert_allclose(state.covariance[k], own.track.P, rtol=1e-6, atol=1e-9)
        if own.rival is not None:
            np.testing.assert_allclose(state.rival_mean[k], own.rival.m, rtol=1e-7)
            np.testing.assert_allclose(state.rival_covariance[k], own.rival.P, rtol=1e-6, atol=1e-9)
