"""Columns of the table of sensors."""

from __future__ import annotations

from occlog.report.plots.sensortable import SensorRow, sensor_columns


def row(frames: str, seen: str, share: str, residual: str = "–") -> SensorRow:
    return SensorRow("a", "camera", "0, 0, 3", "45", "60", frames, seen, share, residual, residual)


def test_columns_without_a_value_and_shares_of_detections_alone_are_left_out() -> None:
    with_shares = [key for key, _ in sensor_columns([row("10", "9", "90"), row("10", "10", "100", "0.2")], "m")]
    assert with_shares == ["kind", "position", "heading", "fov", "frames", "seen", "share", "residual", "fit"]
    alone = [key for key, _ in sensor_columns([row("10", "10", "100")], "m")]
    assert alone == ["kind", "position", "heading", "fov", "seen"]
