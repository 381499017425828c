"""What functions take in the place of files, and what they say of what they cannot take."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from walk_frames import bearings_frame, stations_frame, truth_frame

import occlog


def tracked(bearings: occlog.Table) -> pd.DataFrame:
    return occlog.track(bearings, stations_frame(), method="fix").tracks.to_pandas()


def test_arrow_tables_dicts_and_streams_are_read_as_frames_are() -> None:
    frame = bearings_frame()
    wanted = tracked(frame)  # type: ignore[arg-type]

    class Stream:
        def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
            return pa.Table.from_pandas(frame).__arrow_c_stream__(requested_schema)

    for same in (pa.Table.from_pandas(frame), {str(n): frame[n].to_numpy() for n in frame.columns}, Stream()):
        assert tracked(same).equals(wanted)  # type: ignore[arg-type]


def test_polars_frames_are_read_as_frames_of_pandas_are() -> None:
    polars = pytest.importorskip("polars", reason="polars is not installed")
    frame = bearings_frame()
    assert tracked(polars.from_pandas(frame)).equals(tracked(frame))  # type: ignore[arg-type]


def test_an_index_with_a_name_is_a_column_and_the_frame_stays_as_it_is() -> None:
    frame = bearings_frame()
    indexed = frame.set_index("time")
    before = indexed.copy()
    assert tracked(indexed).equals(tracked(frame))  # type: ignore[arg-type]
    assert indexed.equals(before)
    assert indexed.index.name == "time"


def test_times_of_pandas_are_times() -> None:
    frame = bearings_frame()
    dated = frame.assign(time=pd.Timestamp("2026-05-01T12:00:00Z") + pd.to_timedelta(frame["time"], unit="s"))
    table = occlog.read(dated, "bearings")
    assert table["t_ns"].min() == 1_777_636_800 * 10**9
    assert table.to_pandas(datetimes=True)["t_ns"].min() == pd.Timestamp("2026-05-01T12:00:00Z")


def test_tables_that_went_to_pandas_come_back_the_same() -> None:
    tracks = occlog.track(bearings_frame(), stations_frame(), method="fix").tracks
    for datetimes in (False, True):
        again = occlog.read(tracks.to_pandas(datetimes=datetimes), "tracks")
        assert again.to_pandas()[["t_ns", "x", "y", "cov_xy"]].equals(tracks.to_pandas()[["t_ns", "x", "y", "cov_xy"]])


def test_a_recording_of_one_table_gives_it_by_name(tmp_path: Path) -> None:
    occlog.read(truth_frame(), "truth").save(tmp_path / "truth.parquet")
    opened = occlog.open(tmp_path / "truth.parquet")
    assert opened.tables == ("truth",)
    assert opened.scene is None
    assert len(opened["truth"]) == len(truth_frame())
    with pytest.raises(occlog.UsageError, match="did you mean 'truth'"):
        opened["thruth"]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (bearings_frame().rename(columns={"bearing_deg": "bering_deg"}), "bearings: .* is it 'bering_deg'"),
        (bearings_frame().rename(columns={"bearing_deg": "bearing"}), "bearings: .*does not state its unit"),
        (bearings_frame().assign(station="nroth"), "bearings: row 0: .*did you mean 'north'"),
        (bearings_frame().assign(sigma_deg=-1.0), "bearings: row 0: sigma_deg is -1; it must be above 0"),
        ({"time": np.zeros(2), "station": ["a"]}, "bearings: this value makes no table"),
        (pa.array([1.0]), "bearings: is of type DoubleArray; give a file"),
        (bearings_frame().iloc[:0], "bearings"),
    ],
)
def test_what_cannot_be_is_refused_by_the_name_of_the_argument(wrong: object, message: str) -> None:
    with pytest.raises(occlog.InputError, match=message) as error:
        occlog.track(wrong, stations_frame(), method="fix")  # type: ignore[arg-type]
    assert "/" not in str(error.value).replace("and/or", "")
    assert "--" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"sigma_v": 1.0}, occlog.UsageError, "ekf has no setting 'sigma_v'; did you mean 'process_noise_position'"),
        ({"sceen": 1.0}, occlog.UsageError, "did you mean 'scene'"),
        ({"process_noise_position": -1}, occlog.SettingError, "process_noise_position is -1"),
        ({"process_noise_position": "much"}, occlog.UsageError, "process_noise_position: expected a number"),
        ({"initial_ellipses": "x.csv"}, occlog.UsageError, "initial_ellipses is not an argument of method ekf"),
        ({"also": ("calibration",)}, occlog.UsageError, "method ekf has no table 'calibration'"),
        ({"select": {"policy": "greedy"}}, occlog.UsageError, "select is not an argument of method ekf"),
    ],
)
def test_settings_are_checked_as_on_the_command_line(
    settings: dict[str, object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        occlog.track(bearings_frame(), stations_frame(), method="ekf", **settings)  # type: ignore[arg-type]


def test_messages_name_arguments_and_leave_commands_as_they_are() -> None:
    with pytest.raises(occlog.UsageError) as error:
        occlog.track(bearings_frame())
    assert str(error.value) == "bearings: holds no scene; give one with scene"


def test_without_polars_the_remedy_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(occlog.UsageError, match="polars is not installed"):
        occlog.read(truth_frame(), "truth").to_polars()


def test_ranges_are_measurements_too() -> None:
    ranges = pd.DataFrame(
        [
            (t, station.name, 7, np.hypot(x - station.x, y - station.y))
            for t, x, y in truth_frame()[["time", "x", "y"]].itertuples(index=False)
            for station in stations_frame().itertuples(index=False)
        ],
        columns=["time", "station", "id", "range_m"],
    )
    result = occlog.track(ranges, stations_frame(), method="fix", sigma_range=0.5)
    assert occlog.evaluate(result, truth_frame()).metrics["rmse_m"] < 0.1
