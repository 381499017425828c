from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import run

from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.metric_names import METRICS
from occlog.evaluate.stage import evaluate
from occlog.report.content.metrics_in_words import groups, number

MINUS = "\N{MINUS SIGN}"
SPACE = "\N{NARROW NO-BREAK SPACE}"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (float("inf"), "∞"),
        (True, "yes"),
        ("a_b", "a_b"),
        (7, "7"),
        (400.0, "400"),
        (1234567, f"1{SPACE}234{SPACE}567"),
        (-1234567.0, f"{MINUS}1{SPACE}234{SPACE}567"),
        (0.123456, "0.1235"),
        (-0.5, f"{MINUS}0.5"),
        (1.5e-7, f"1.5e{MINUS}07"),
        (np.int32(5), "5"),
    ],
)
def test_numbers_as_people_write_them(value: object, text: str) -> None:
    assert number(value) == text


def test_figures_in_words_with_units() -> None:
    metrics = {
        "_provenance": {"seed": 1},
        "rmse_ft": 0.71,
        "detection_rate": 0.834,
        "bearing_rms_mrad": 17.4533,
        "extra": 3,
    }
    found = {g.title: {f.name: (f.value, f.unit) for f in g.figures} for g in groups(metrics, "ft")}
    assert found == {
        "Accuracy": {"RMSE": ("0.71", "ft")},
        "Detection": {"detected of visible": ("83.4", "%"), "RMS bearing error": ("1", "°")},
        "Other figures": {"extra": ("3", "")},
    }


def test_figures_for_each_target_and_sensor() -> None:
    metrics = {
        "rmse_m": 1.0,
        "rmse_target_0_m": 2.0,
        "rmse_target_12_m": 3.0,
        "estimates_target_12": 7.0,
        "bearing_rms_sensor_cam_1_px_px": 4.0,
        "bearing_rms_px": 5.0,
        "visible_sensor_target_3": 6.0,
    }
    accuracy, seen = groups(metrics, "m")
    (table,) = accuracy.breakdowns
    assert table.kind == "target"
    assert table.columns == ("RMSE [m]", "estimates")
    assert table.rows == (("0", ("2", "–")), ("12", ("3", "7")))
    (table,) = seen.breakdowns
    assert table.kind == "sensor"
    assert dict(table.rows) == {"target_3": ("6", "–"), "cam_1_px": ("–", "4")}


def test_a_longer_name_is_not_read_as_a_shorter_one() -> None:
    (group,) = groups({"detected": 5.0, "detected_hidden": 2.0}, "m")
    assert [(f.name, f.value) for f in group.figures] == [("detected", "5"), ("detected though hidden", "2")]
    assert group.breakdowns == []


def test_settled_figures_stand_apart() -> None:
    first, second = groups({"settled_rmse_m": 1.0, "rmse_m": 2.0}, "m")
    assert (first.title, first.figures[0].value) == ("Accuracy", "2")
    assert (second.title, second.figures[0].value) == ("Accuracy, after the start", "1")


def test_there_is_a_word_for_everything_that_evaluate_says() -> None:
    data = run(steps=120, targets=2, cameras=3)
    config = EvaluateConfig(held_out=("camera 2",), triangulation_tolerance=1.0, settling_s=2.0)
    found = evaluate(data.tracks, data.truth, data.bearings, data.scene, config)
    titles = [g.title for g in groups(found.metrics, "m")]
    assert "Other figures" not in titles
    assert {"Accuracy", "Bound", "Consistency", "Detection", "Lines of sight", "Accuracy, after the start"} <= set(
        titles
    )
    assert sum(len(g.figures) for g in groups(found.metrics, "m")) > 60


@pytest.mark.parametrize(("length", "of"), [("m", ""), ("", " of 1 - IoU")])
def test_figures_on_the_ground_and_of_boxes_have_their_own_label_and_unit(length: str, of: str) -> None:
    end, power = (f"_{length}", "2") if length else ("", "")
    (group,) = groups({f"motp{end}": 0.5, f"gospa_missed{end}{power}": 1.0, "tracks": 1.0}, "m")
    assert {f.name: f.unit for f in group.figures if f.name != "tracks"} == {
        f"MOTP{of}": length,
        f"mean GOSPA, missed{of}": "m²" if length else "",
    }


def test_accuracy_without_an_error_is_left_out() -> None:
    assert groups({"tracks": 2.0, "estimates_without_truth": 10.0}, "m") == []


def test_no_word_twice() -> None:
    names = [metric.name for metric in METRICS]
    assert len(names) == len(set(names))
    labels = [(metric.group, metric.label) for metric in METRICS]
    assert len(labels) == len(set(labels))


def test_headline_agrees_with_evaluate() -> None:
    data = run(steps=120, targets=2, cameras=4)
    found = evaluate(data.tracks, data.truth, data.bearings, data.scene, EvaluateConfig())
    shown = replace(data, errors=found.errors, bound=found.bound)
    rmse, bound = shown.beside_bound()
    assert shown.figures.errors.rmse() == pytest.approx(found.metrics["rmse_m"], rel=1e-12)
    assert bound == pytest.approx(found.metrics["bound_rmse_m"], rel=1e-12)
    assert rmse / bound == pytest.approx(found.metrics["bound_ratio"], rel=1e-12)
