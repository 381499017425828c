"""Time stamps, sidecar files, frame rates."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.errors import InputError
from occlog.io.files.timing.frame_times import FrameTimes, as_rate, frames_to_ns
from occlog.io.files.timing.times import parse_time, read_sidecar
from occlog.io.formats.truth import read_sync_times
from occlog.records.columns import MAX_NS


@pytest.mark.parametrize(
    ("text", "unit", "ns"),
    [
        ("25.0009787", "s", 25_000_978_700),
        ("1700000000.123456789", "s", 1_700_000_000_123_456_789),
        ("1700000000123", "ms", 1_700_000_000_123_000_000),
        ("0.5", "us", 500),
        ("-2", "s", -2_000_000_000),
        ("2024-01-01T00:00:00Z", "s", 1_704_067_200_000_000_000),
        ("2024-01-01 01:00:00.123456789+01:00", "s", 1_704_067_200_123_456_789),
        ("1969-12-31T23:59:59.5Z", "s", -500_000_000),
    ],
)
def test_times_are_exact_to_the_nanosecond(text: str, unit: str, ns: int) -> None:
    assert parse_time(text, unit) == ns


@pytest.mark.parametrize(
    "text",
    ["", "noon", "nan", "inf", "2024-13-01T00:00:00Z", "1e400", "1e999999", "-1e99999999", "1700000000123456789"],
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="time"):
        parse_time(text)


def sidecar(tmp_path: Path, text: str, cameras: tuple[str, ...] = ("cam1",)) -> dict[str, list[int]]:
    path = tmp_path / "ts.csv"
    path.write_text(text)
    return {name: times.tolist() for name, times in read_sidecar(path, cameras).items()}


@pytest.mark.parametrize(
    "text",
    [
        "0.5\n0.75\n1.5\n",
        "# comment\n0,0.5\n1,0.75\n2,1.5\n",
        "time\n0.5\n0.75\n1.5\n",
        "t_ms;frame\n500;0\n750;1\n1500;2\n",
        "\ufefft_ns\r\n500000000\r\n750000000\r\n1500000000\r\n",
        "time [ms]\n500\n750\n1500\n",
        "time (ms),frame\n500,0\n750,1\n1500,2\n",
        "1970-01-01 00:00:00,500\n1970-01-01 00:00:00,750\n1970-01-01 00:00:01,500\n",
        "time\n1970-01-01 00:00:00.5+00\n1970-01-01 00:00:00.75+00\n1970-01-01 00:00:01.5+00\n",
        "Frame_Index,Timestamp\n0,1970-01-01T00:00:00.5Z\n1,1970-01-01T00:00:00.75Z\n2,1970-01-01T00:00:01.5Z\n",
    ],
)
def test_the_forms_of_a_sidecar(tmp_path: Path, text: str) -> None:
    assert sidecar(tmp_path, text) == {"cam1": [500_000_000, 750_000_000, 1_500_000_000]}


@pytest.mark.parametrize(
    ("form", "scale"),
    [("{t},{t}.png", 10**9), ("{t}.000000 rgb/{t}.png", 1)],
)
def test_lists_of_images_with_their_times_are_sidecars(tmp_path: Path, form: str, scale: int) -> None:
    """EuRoC's data.csv and TUM's rgb.txt; names of images were taken for times."""
    path = tmp_path / "list.txt"
    times = [1_714_564_800 + k for k in range(3)]
    path.write_text("# timestamp filename\n" + "".join(form.format(t=t * scale) + "\n" for t in times))
    assert read_sidecar(path, ["cam"])["cam"].tolist() == [t * 10**9 for t in times]


def test_a_timecode_is_named(tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    path.write_text("00:00:00:00\n00:00:00:01\n")
    with pytest.raises(InputError, match="timecode"):
        read_sidecar(path, ["cam"])


def test_one_file_for_several_cameras(tmp_path: Path) -> None:
    text = "sync_index,cam_id,frame_time\n0,2,0.1\n0,1,0.2\n1,2,0.4\n1,9,0.4\n1,1,0.3\n"
    assert sidecar(tmp_path, text, ("cam_1", "cam_02")) == {
        "cam_02": [10**8, 4 * 10**8],
        "cam_1": [2 * 10**8, 3 * 10**8],
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.5\n0.4\n", "line 2: time stamp goes back"),
        ("time\n0.5\n0.5\n", "line 3: time stamp repeats, 1 times in all"),
        ("frame,time\n0,1\n2,2\n", "line 3: frame 2 where frame 1 was expected"),
        ("time\n1\nx\n", "line 3: time 'x'"),
        ("time,frame\n1,0\n\n2\n", "line 4: 1 cells, but the first line has 2"),
        ("20240501T120000.0Z\n", "time '20240501T120000.0Z': neither a number nor a date and time such as 2024-05-01T"),
        ("24-05-01 12:00:00\n", "time '24-05-01 12:00:00': .* write 2024-05-01T"),
        ("2024-10-27 02:59:59.9\n2024-10-27 02:00:00\n", "line 2: time stamp goes back .* end of summer time"),
        ("a,b,c\n1,2,3\n", "unknown column 'a'"),
        ("frame,tyme\n1,2\n", "did you mean 'time'"),
        ("1,2,3\n", "3 columns without a header"),
        ("time,t_ns\n1,2\n", "two columns of times"),
        ("frame\n0\n", "no column of times"),
        ("camera,time\ncam7,1\n", "column camera has 'cam7'"),
        ("", "is empty"),
        ("#\n", "no line with data"),
    ],
)
def test_a_faulty_sidecar_names_line_and_value(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        sidecar(tmp_path, text)
    assert "ts.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_caliscope_time_stamps_of_unsynchronised_cameras(shared_data: Path) -> None:
    path = shared_data / "caliscope_4cam/session_a/calibration/extrinsic/timestamps.csv"
    names = [f"cam_{n}" for n in range(4)]
    times = read_sidecar(path, names)
    assert {n: len(t) for n, t in times.items()} == dict.fromkeys(names, 57)
    assert times["cam_2"][0] == 25_000_978_700
    spread = np.ptp(np.column_stack([times[n] for n in names]), axis=1) / 1e6
    assert np.median(spread) < 5  # ms; the README: median 2, at most 20
    assert spread.max() < 21
    sync = read_sync_times(path)
    assert list(sync)[:2] == [35, 36]
    assert sync[35] == pytest.approx((25.0009787 + 25.0184798 + 25.00100565 + 25.00119655) / 4 * 1e9, abs=1)


@given(st.integers(0, 10**8), st.integers(1, 100_000), st.sampled_from([1, 2, 1000, 1001]))
def test_times_of_a_rate_are_the_rounded_exact_ones(frame: int, numerator: int, denominator: int) -> None:
    rate = Fraction(numerator, denominator)
    if frame / rate > 9_000_000_000:
        with pytest.raises(InputError, match="out of range"):
            frames_to_ns(np.array([frame]), rate)
        return
    exact = Fraction(frame) / rate * 10**9
    assert abs(int(frames_to_ns(np.array([frame]), rate)[0]) - exact) <= Fraction(1, 2)


@pytest.mark.parametrize(
    ("given", "rate"),
    [
        (29.97, Fraction(30000, 1001)),
        ("59.94", Fraction(60000, 1001)),
        (25, 25),
        ("7", 7),
        (12.5, Fraction(25, 2)),
        ("30000/1001", Fraction(30000, 1001)),
        (23.976, Fraction(24000, 1001)),
        (30, 30),
    ],
)
def test_frame_rates_become_exact(given: float | str, rate: Fraction) -> None:
    assert as_rate(given) == rate


@pytest.mark.parametrize(
    ("given", "rate"),
    [
        ("0.0006", Fraction(6, 10_000)),  # was 1/1001
        ("0.0003", Fraction(3, 10_000)),  # was 0
        ("30.0003", Fraction(300_003, 10_000)),  # a clock that was measured was 30
        ("29.973", Fraction(29_973, 1000)),  # was 30000/1001
        (29.97002997002997, Fraction(30_000, 1001)),
        (1 / 3, Fraction(1, 3)),
    ],
)
def test_frame_rates_are_no_others(given: float | str, rate: Fraction) -> None:
    assert abs(as_rate(given) / rate - 1) < 1e-9
    last = int(9e9 * float(rate)) - 1
    assert abs(int(frames_to_ns(np.array([last]), as_rate(given))[0]) - last * 10**9 / rate) <= 10**10


@pytest.mark.parametrize("given", ["0", "-3", "nan", "fast", 1e9, "1/0"])
def test_a_frame_rate_that_cannot_be_is_refused(given: float | str) -> None:
    with pytest.raises(InputError, match="frame rate"):
        as_rate(given)


def test_a_frame_without_a_time_is_named() -> None:
    times = FrameTimes("sidecar x.csv", 5, np.array([0, 10, 30]))
    assert times.at(np.array([2, 0])).tolist() == [35, 5]
    with pytest.raises(InputError, match=r"frame 3 has no time: sidecar x\.csv gives times for frames 0 to 2"):
        times.at(np.array([1, 3]))
    with pytest.raises(InputError, match="give the frame rate"):
        FrameTimes("nothing").at(np.array([0]))


def test_times_are_read_up_to_half_the_range_of_64_bits() -> None:
    assert parse_time(str(MAX_NS), "ns") == MAX_NS
    assert parse_time(str(-MAX_NS), "ns") == -MAX_NS
    with pytest.raises(InputError, match="out of range for ns"):
        parse_time(str(MAX_NS + 1), "ns")


def test_a_number_of_seconds_beyond_the_year_5138_is_of_another_unit() -> None:
    with pytest.raises(InputError, match="out of range for s"):
        parse_time("1e11", "s")
    with pytest.raises(InputError, match="too large for seconds"):
        parse_time("100000000001", "s")


def test_a_frame_has_a_time_up_to_285_years_away() -> None:
    assert frames_to_ns(np.array([9 * 10**9]), Fraction(1)).tolist() == [9 * 10**18]
    with pytest.raises(InputError, match="frame 9000000001: its time at 1 fps is out of range"):
        frames_to_ns(np.array([0, 9 * 10**9 + 1]), Fraction(1))
