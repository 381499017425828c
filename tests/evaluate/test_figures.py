"""Names of figures: all that are given are known, and a misspelled one is answered with the nearest."""

from __future__ import annotations

import json

import pytest
from places import ROOT

from occlog.evaluate.metric_names import METRICS, unknown_metric_hint

GIVEN = json.loads((ROOT / "tests" / "golden" / "expected" / "simulated" / "metrics.json").read_text())
NAMES = [name for name, value in GIVEN.items() if isinstance(value, int | float) and name != "plausible"]


def test_every_figure_of_a_simulated_recording_and_of_the_table_is_known() -> None:
    assert len(NAMES) > 100
    assert [
        name for name in (*NAMES, *(metric.name for metric in METRICS)) if unknown_metric_hint(name) is not None
    ] == []


@pytest.mark.parametrize(
    "name", ["settled_rmse_target_3_m", "gospa_missed_m2", "views_recall_front", "mota_recording_a", "bearing_rms_mrad"]
)
def test_a_figure_may_say_its_unit_and_what_it_is_of(name: str) -> None:
    assert unknown_metric_hint(name) is None


@pytest.mark.parametrize(("name", "near"), [("rsme", "rmse"), ("motaa", "mota"), ("settled_rmsee_m", "rmse")])
def test_a_misspelled_figure_is_answered_with_the_nearest(name: str, near: str) -> None:
    assert near in (unknown_metric_hint(name) or "")
