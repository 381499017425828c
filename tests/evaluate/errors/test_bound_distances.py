"""The bound with ranges, strengths and differences: by hand, and with the settings that tracks were made with."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Bearings, Truth
from occlog.scans.config import DistanceMeasurementConfig

PLACES = {"a": (0.0, 0.0), "b": (8.0, 0.0), "c": (0.0, 6.0)}
XY, PRIOR = np.array([3.0, 4.0]), (9.0, 0.0, 16.0)


def scene(z: float = 0.0) -> Scene:
    room = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
    return Scene(arrays=tuple(MicrophoneArray(n, np.array([*p, z])) for n, p in PLACES.items()), room=room)


def truth(z: float = np.nan) -> Truth:
    return Truth.of(t_ns=[0, 10**8], target_id=[0, 0], x=[3.0, 3.0], y=[4.0, 4.0], z=[z, z], role=["target"] * 2)


def table(**columns: object) -> Measurements:
    """Of one time."""
    n = len(columns["sensor"])
    nan = np.full(n, np.nan)
    blank = {"range": nan, "sigma_range": nan, "rssi": nan, "sigma_rssi": nan}
    return Measurements.of(t_ns=np.zeros(n, dtype=np.int64), target_id=np.zeros(n, dtype=np.int32), **(blank | columns))


def bound(
    rows: Measurements, config: DistanceMeasurementConfig, where: Scene, bearings: Bearings | None = None
) -> float:
    how = EvaluateConfig(prior_covariance=PRIOR, motion="cv")
    return float(evaluate(None, truth(), bearings, where, how, measured=(rows, config, None)).bound.bound[0])


def by_hand(information: np.ndarray) -> float:
    return float(np.sqrt(np.trace(np.linalg.inv(np.diag([1 / 9.0, 1 / 16.0]) + information))))


def towards(name: str, rise: float = 0.0) -> tuple[np.ndarray, float]:
    """Gradient of the distance from a station, and the distance."""
    away = XY - PLACES[name]
    far = float(np.sqrt(away @ away + rise**2))
    return away / far, far


def test_of_one_moment_it_is_the_inverse_of_prior_and_fisher_information() -> None:
    a, far = towards("a", 1.5)
    rows = table(sensor=["a"], range=[5.0], sigma_range=[0.2])
    assert bound(rows, DistanceMeasurementConfig(tag_height=0.5), scene(2.0)) == pytest.approx(
        by_hand(np.outer(a, a) / 0.04)
    )
    rows = table(sensor=["a"], rssi=[-75.0], sigma_rssi=[4.0])
    slope = 20.0 / np.log(10.0) / far  # dB for a metre
    reported = by_hand(np.outer(a, a) * (slope / 4.0) ** 2)
    assert bound(rows, DistanceMeasurementConfig(tag_height=0.5), scene(2.0)) == pytest.approx(reported)


def test_differences_ranges_and_bearings_add_up() -> None:
    (a, far), (b, _) = towards("a"), towards("b")
    rows = table(sensor=["b"], reference=["a"], tdoa=[0.0], sigma_tdoa=[1e-3])
    reported = np.outer(b - a, b - a) / 0.343**2
    assert bound(rows, DistanceMeasurementConfig(propagation_speed="sound"), scene()) == pytest.approx(
        by_hand(reported)
    )
    nan = [np.nan]
    seen = {"t_ns": [0], "sensor": ["a"], "target_id": [0], "seen": [True], "u_px": nan, "sigma_px": nan, "score": nan}
    bearings = Bearings.of(**seen, bearing=[np.arctan2(4.0, 3.0)], sigma=[0.01])
    across = np.array([-a[1], a[0]]) / far / 0.01
    both = by_hand(reported + np.outer(across, across))
    assert bound(rows, DistanceMeasurementConfig(propagation_speed="sound"), scene(), bearings) == pytest.approx(both)


def test_measurements_of_other_targets_count_nothing_and_a_bound_in_space_is_refused() -> None:
    rows = table(sensor=["a", "b"], range=[5.0, 5.0], sigma_range=[0.2, 0.2])
    other = Measurements.of(**{c.name: getattr(rows, c.name) for c in rows.columns()} | {"target_id": np.array([0, 7])})
    a, _ = towards("a")
    assert bound(other, DistanceMeasurementConfig(), scene()) == pytest.approx(by_hand(np.outer(a, a) / 0.04))
    how = EvaluateConfig(prior_covariance=PRIOR, bound_dimension="space")
    with pytest.raises(InputError, match="only the bound on the ground"):
        evaluate(None, truth(1.0), None, scene(), how, measured=(rows, DistanceMeasurementConfig(), None))
