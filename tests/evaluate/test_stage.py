"""Conditions of --fail-if (what they say, what they refuse, when they break), and what asking cameras costs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.errors import ExitCode, UsageError
from occlog.evaluate.results import Threshold, failures, parse_threshold
from occlog.evaluate.stage import CooperationCounts
from occlog.records.tables import Cooperation

METRICS = {
    "rmse_m": 0.7,
    "rmse_x_m": 0.3,
    "bound_ratio": 1.2,
    "bearing_rms_px": 2.0,
    "bearing_rms_mrad": 1.5,
    "nees_mean": math.nan,
    "detection_rate_sensor_cam 1": 0.5,
}
NS = 1_000_000_000


def cooperation_figures(asked: Cooperation, tracked: tuple[int, int] | None = None) -> dict[str, float]:
    counts = CooperationCounts()
    counts.update(asked)
    return counts.result(tracked)


def broken(text: str) -> list[str]:
    return failures(METRICS, [parse_threshold(text)])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rmse>0.5", Threshold("rmse", ">", 0.5)),
        (" rmse_m >= 5e-1 ", Threshold("rmse_m", ">=", 0.5)),
        ("detection_rate<.9", Threshold("detection_rate", "<", 0.9)),
        ("bias_x_m<=-1", Threshold("bias_x_m", "<=", -1.0)),
        ("detection_rate_sensor_cam 1<0.9", Threshold("detection_rate_sensor_cam 1", "<", 0.9)),
    ],
)
def test_parse(text: str, expected: Threshold) -> None:
    assert parse_threshold(text) == expected


@pytest.mark.parametrize(
    "text",
    ["", "rmse", "rmse>", ">0.5", "rmse=0.5", "rmse==0.5", "rmse>>1", "rmse>a", "rmse>nan", "rmse>inf", "1<rmse<2"],
)
def test_parse_refuses(text: str) -> None:
    with pytest.raises(UsageError, match="must be a metric") as refused:
        parse_threshold(text)
    assert refused.value.exit_code == ExitCode.USAGE


@given(
    st.text("abc_ ", min_size=1).map(str.strip).filter(bool),
    st.sampled_from(["<", "<=", ">", ">="]),
    st.floats(-1e9, 1e9),
)
def test_parse_is_the_inverse_of_writing(metric: str, sign: str, limit: float) -> None:
    found = parse_threshold(f"{metric}{sign}{limit!r}")
    assert found == Threshold(metric, sign, limit)


@pytest.mark.parametrize(
    ("text", "breaks"),
    [
        ("rmse_m>0.5", True),
        ("rmse_m>0.7", False),
        ("rmse_m>=0.7", True),
        ("rmse_m<0.7", False),
        ("rmse_m<=0.7", True),
        ("rmse_m<1", True),
        ("bound_ratio>1.3", False),
    ],
)
def test_comparisons_at_and_around_the_limit(text: str, breaks: bool) -> None:
    assert bool(broken(text)) == breaks


def test_message_gives_metric_and_value() -> None:
    assert broken("rmse>0.5") == ["rmse>0.5: rmse_m is 0.7"]


def test_missing_metric_breaks_and_names_the_nearest() -> None:
    (line,) = broken("rsme_m>0.5")
    assert "no metric 'rsme_m'" in line
    assert "rmse_m" in line


def test_name_without_unit_must_stand_for_one_metric() -> None:
    (line,) = broken("bearing_rms>100")
    assert "bearing_rms_px or bearing_rms_mrad" in line
    assert not broken("bearing_rms_px>100")


def test_not_a_number_breaks() -> None:
    (line,) = broken("nees_mean>3")
    assert "nees_mean is not a number" in line


def test_every_broken_threshold_is_reported_in_order() -> None:
    lines = failures(METRICS, [parse_threshold(t) for t in ("rmse>0.5", "bound_ratio>9", "none>0", "rmse_x>0.1")])
    assert [line.split(":")[0] for line in lines] == ["rmse>0.5", "none>0", "rmse_x>0.1"]


def asked(*rows):
    """Rows (t [s], target, cause, frames, answered)."""
    t, target, cause, frames, answered = zip(*rows, strict=True)
    x = np.where(answered, 1.0, np.nan)
    return Cooperation.of(
        t_ns=[round(s * NS) for s in t],
        target_id=target,
        cause=cause,
        cameras=["a,b"] * len(t),
        frames=frames,
        answered=answered,
        x=x,
        y=x,
        cov_xx=x,
        cov_xy=0 * x,
        cov_yy=x,
    )


REQUESTS = asked(
    (1, 0, "spread", 2, True),
    (1, 1, "spread,count", 1, False),
    (1, 2, "shared", 0, True),
    (3, 0, "count", 2, True),
    (7, 1, "periodic", 2, True),
)


def test_requests_frames_and_causes_are_counted():
    found = cooperation_figures(REQUESTS)
    assert found["cooperation_requests"] == 4
    assert found["cooperation_answered"] == 3
    assert found["cooperation_shared"] == 1
    assert found["cooperation_frames"] == 7
    assert found["cooperation_requests_spread"] == 2
    assert found["cooperation_requests_count"] == 2
    assert found["cooperation_requests_periodic"] == 1
    assert found["cooperation_requests_ellipse"] == 0
    assert found["cooperation_period_s"] == pytest.approx(3.0)  # 6 s, two intervals


def test_the_period_is_that_of_the_tracks():
    assert cooperation_figures(REQUESTS, (0, 30 * NS))["cooperation_period_s"] == pytest.approx(10.0)


def test_nothing_asked_is_no_period():
    found = cooperation_figures(Cooperation.empty())
    assert found["cooperation_requests"] == found["cooperation_frames"] == 0
    assert math.isnan(found["cooperation_period_s"])
