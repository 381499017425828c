"""`occlog listen`: files to a table that `track` takes, recorded talkers, and one line for each fault."""

from __future__ import annotations

import json
import re
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.records.tables import Doa, Tracks

pytest.importorskip("pyroomacoustics")
RATE, C = 16000, 343.0
SOLID = 0.06 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
PLACES = {"mic1": (0.0, 0.0), "mic2": (4.0, 0.0)}
TALKER = (1.5, 2.5)
FAST = ["--grid", "8", "--window", "0.016", "-q"]
RESPEAKER = "x,y,z\n" + "".join(f"{x},{y},0.005\n" for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))).replace(
    "1", "0.02285"
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two arrays, one of them turned, that hear white sound from one place; files of 2 s."""
    rng = np.random.default_rng(0)
    rows = "".join(f"      - [{x:.3f}, {y:.3f}, {z:.3f}]\n" for x, y, z in SOLID)
    scene = "occlog_scene: 1\nroom: [[-1, -1], [5, -1], [5, 5], [-1, 5]]\nmicrophone_arrays:\n"
    for name, (x, y) in PLACES.items():
        yaw = 90 if name == "mic2" else 0
        scene += f"  - name: {name}\n    position: [{x}, {y}, 1.2]\n    yaw_deg: {yaw}\n    microphones:\n{rows}"
        bearing = np.arctan2(TALKER[1] - y, TALKER[0] - x) - np.radians(yaw)
        early = SOLID @ [np.cos(bearing), np.sin(bearing), 0.0] / C
        n = 2 * RATE
        omega = 2 * np.pi * np.fft.rfftfreq(n, 1 / RATE)
        sound = np.fft.irfft(
            np.fft.rfft(rng.standard_normal(n))[:, None] * np.exp(1j * omega[:, None] * early), n, axis=0
        )
        wavfile.write(tmp_path / f"{name}.wav", RATE, (0.05 * sound).astype(np.float32))
    (tmp_path / "scene.yaml").write_text(scene)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_sound_to_a_track(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two arrays hear a talker at rest: every direction within 2 degrees, and its place within 0.2 m."""
    start = ["--start-time", "2024-05-01T12:00:00Z", "--start-time", "mic2=1714564800.25"]
    args = ["listen", "--scene", "scene.yaml", "mic1=mic1.wav", "mic2=mic2.wav", "-o", "doa.parquet", *start, *FAST]
    assert run([*args, "--json"]) == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert result["rows"] == {"mic1": 4, "mic2": 4}
    assert result["silent_frames"] == {"mic1": 0, "mic2": 0}
    doa = read_table(folder / "doa.parquet", Doa)
    assert (np.diff(doa.t_ns) > 0).all()
    assert doa.t_ns[0] == 1_714_564_800_250_000_000  # the middle of the first frame
    for name, (x, y) in PLACES.items():
        mine = doa.take(doa.sensor == name)
        assert np.degrees(np.abs(mine.azimuth - np.arctan2(TALKER[1] - y, TALKER[0] - x))).max() < 2.0
    assert read_provenance(folder / "doa.parquet").parameters["algorithm"] == "srp"
    how = ["--method", "fix", "--window", "0.3", "-o", "t.parquet", "-q"]
    assert run(["track", "doa.parquet", "--scene", "scene.yaml", *how]) == ExitCode.DONE
    found = read_table(folder / "t.parquet", Tracks)
    assert np.hypot(found.x - TALKER[0], found.y - TALKER[1]).max() < 0.2


def test_one_talker_is_where_the_recording_says(shared_data: Path, tmp_path: Path) -> None:
    """`simulated_4mic_wav`, files of one talker at 180 degrees, +20: median azimuth within 5 degrees."""
    (tmp_path / "mics.csv").write_text(RESPEAKER)
    files = sorted((shared_data / "simulated_4mic_wav" / "data" / "a180e20").glob("*/*.wav"))
    assert files
    for file in files:
        out = str(tmp_path / "doa.parquet")
        args = ["listen", "--arrays", f"mic={tmp_path / 'mics.csv'}", str(file), "-o", out, "-q", "--overwrite"]
        assert run(args) == ExitCode.DONE
        doa = read_table(tmp_path / "doa.parquet", Doa)
        assert len(doa) >= 3
        off = np.degrees((doa.azimuth - np.pi + np.pi) % (2 * np.pi) - np.pi)
        assert abs(np.median(off)) < 5.0
        assert np.abs(off).max() < 10.0
        high = np.degrees(doa.elevation)
        assert (high > 0).all()
        assert abs(np.median((high - 20.0) / np.degrees(doa.sigma_elevation))) < 1.0


def test_damaged_files_are_used_as_far_as_they_go(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = (folder / "mic1.wav").read_bytes()
    (folder / "cut.wav").write_bytes(data[: len(data) // 2])
    args = ["listen", "--scene", "scene.yaml", "-o", "doa.parquet", *FAST, "--json", "--overwrite"]
    assert run([*args, "mic1=cut.wav"]) == ExitCode.LOSSY
    out = capsys.readouterr()
    assert "cut.wav: frame 159" in out.err
    assert json.loads(out.out)["rows"] == {"mic1": 1}
    assert read_provenance(folder / "doa.parquet").losses
    at = data.index(b"data") + 4
    (folder / "open.wav").write_bytes(data[:at] + struct.pack("<I", 0) + data[at + 4 :])
    assert run([*args, "mic1=open.wav"]) == ExitCode.LOSSY
    assert "does not state the length" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["mic1=no.wav"], 4, "no such file"),
        (["mic1=scene.yaml"], 4, "is not a WAV file"),
        (["mic1=mic1.wav", "--frame", "2", "--window", "1.5"], 2, "'--window': 1.5 is not in the range 0<x<=1"),
        (["mic1.wav"], 2, "does not name its array"),
        (["mic1=mic1.wav", "mic1=mic2.wav"], 2, "has two files"),
        (["mic9=mic1.wav"], 4, "mic9"),
        (["mic1=mic1.wav", "--channels", "1,2,3"], 4, "3 channels, but array mic1 has 6 microphones"),
        (["mic1=mic1.wav", "--channels", "1,2,3,4,5,9"], 2, "no channel 9"),
        (["mic1=mic1.wav", "--channels", "1,1"], 2, "names a channel twice"),
        (["mic1=mic1.wav", "--channels", "0"], 2, "expected numbers from 1"),
        (["mic1=mic1.wav", "--max-sources", "many"], 2, "must be 1 to 100, or auto"),
        (["mic1=mic1.wav", "--max-sources", "auto", "--algorithm", "music"], 2, "only srp finds how many"),
        (["mic1=mic1.wav", "--band", "4000", "300"], 2, "above the lower end"),
        (["mic1=mic1.wav", "--start-time", "noon"], 4, "'noon'"),
        (
            ["mic1=mic1.wav", "--frame", "3"],
            4,
            "32000 samples (2 s) are fewer than one frame has, 48000 (3 s)",
        ),
    ],
)
def test_faults_are_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], args: list[str], code: int, message: str
) -> None:
    assert run(["listen", "--scene", "scene.yaml", "-o", "doa.parquet", "-q", *args]) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (folder / "doa.parquet").exists()


def test_microphones_that_are_farther_apart_than_a_window_lasts_are_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = (folder / "scene.yaml").read_text()
    (folder / "far.yaml").write_text(scene.replace("[0.060, 0.000, 0.000]", "[1e9, 0, 0]"))
    assert run(["listen", "--scene", "far.yaml", "mic1=mic1.wav", "-o", "doa.parquet", *FAST]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert "microphones spread over 1e+09 m, but a window of" in error
    assert "a window of 0.016 s allows 5.49 m" in error


def test_without_the_library_one_line_says_what_to_install(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyroomacoustics.doa", None)
    assert run(["listen", "--scene", "scene.yaml", "mic1=mic1.wav", "-o", "doa.parquet"]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert "pip install pyroomacoustics" in error
    assert error.count("\n") == 1


def test_a_channel_without_a_signal_is_named(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = shared_cases / "c04_wav_dead"
    words = ["--arrays", f"table={case / 'mics.csv'}", str(case / "w_dead.wav"), "-o", str(tmp_path / "doa.parquet")]
    assert run(["listen", *words]) == ExitCode.DONE
    assert "microphone 3 has under 1% of the level of the others" in capsys.readouterr().err
    found = read_table(tmp_path / "doa.parquet", Doa)
    np.testing.assert_allclose(np.degrees(found.azimuth), 60.0, atol=3.0)


def test_a_channel_that_is_late_is_named_with_its_samples(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = shared_cases / "c05_wav_late_channel"
    words = ["--arrays", f"table={case / 'mics.csv'}", str(case / "w_late.wav"), "-o", str(tmp_path / "doa.parquet")]
    assert run(["listen", *words, "--json", "-q"]) == ExitCode.DONE
    (found,) = json.loads(capsys.readouterr().out)["warnings"]
    assert found["id"] == "microphone-late"
    assert re.search(r"microphone 3 is late by 25[4-8] samples", found["message"])


def test_two_microphones_at_one_position_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = (folder / "scene.yaml").read_text()
    (folder / "scene.yaml").write_text(scene.replace("[-0.060, 0.000, 0.000]", "[0.060, 0.000, 0.000]"))
    assert run(["listen", "--scene", "scene.yaml", "mic1=mic1.wav", "-o", "d.parquet", *FAST]) == ExitCode.BAD_INPUT
    assert "microphones 1 and 2 of array mic1" in capsys.readouterr().err
    assert not (folder / "d.parquet").exists()
