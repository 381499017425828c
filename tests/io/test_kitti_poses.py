"""Poses of KITTI odometry as truth, tracks and in recordings; nanoseconds of TUM and EuRoC in recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Truth

N = 12
T = 0.1036 * np.arange(N)
X, Y, Z = 0.9 * np.arange(N), 0.1 * np.arange(N) ** 2, 0.02 * np.arange(N)
"""Way in the scene: forward, to the left, up."""


def write(folder: Path, *, times: int = N) -> Path:
    lines = []
    for k in range(N):
        angle = 0.05 * k
        c, s = np.cos(angle), np.sin(angle)
        pose = np.array([[c, 0, -s, -Y[k]], [0, 1, 0, -Z[k]], [s, 0, c, X[k]]])
        lines.append(" ".join(f"{value:.9e}" for value in pose.reshape(-1)))
    path = folder / "00.txt"
    path.write_text("\n".join(lines) + "\n")
    if times:
        (folder / "times.txt").write_text("".join(f"{t:.6e}\n" for t in np.resize(T, times)))
    rows = "".join(f"{t},0,{x},{y},{z}\n" for t, x, y, z in zip(T, X, Y, Z, strict=True))
    (folder / "scene.csv").write_text(f"time,id,x,y,z\n{rows}")
    return path


def test_poses_are_forward_left_and_up_from_the_first_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, other, out = write(tmp_path), str(tmp_path / "scene.csv"), tmp_path / "out.mcap"
    for tracks, truth in ((str(path), other), (other, str(path))):
        assert run(["evaluate", tracks, "--truth", truth, "--json"]) == ExitCode.DONE
        found = capsys.readouterr()
        assert json.loads(found.out)["rmse_m"] < 1e-8
        assert "poses of KITTI with the times of times.txt; x is forward (z of the file), y is left" in found.err
        assert found.err.count("poses of KITTI") == 1
    assert run(["ingest", "--truth", str(path), "-o", str(out)]) == ExitCode.DONE
    truth = open_recording(out).read(Truth)
    assert np.abs(np.column_stack([truth.x - X, truth.y - Y, truth.z - Z])).max() < 1e-8
    assert np.abs(truth.t_ns - 1e9 * T).max() < 1000
    assert run(["info", str(path)]) == ExitCode.DONE
    assert "poses of KITTI" in capsys.readouterr().out


def test_times_that_are_missing_or_of_another_sequence_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for times, words in (
        (0, "put the times of the sequence into its folder as 00_times.txt, one a line [s]"),
        (N - 2, "at least 12 poses, but times.txt has 10 times"),
        (N + 2, "12 poses, but times.txt has 14 times"),
    ):
        path = write(tmp_path, times=times)
        assert run(["evaluate", str(path), "--truth", str(tmp_path / "scene.csv")]) == ExitCode.BAD_INPUT
        (line,) = [each for each in capsys.readouterr().err.splitlines() if "error:" in each]
        assert words in line


def test_a_quiet_command_states_no_axes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["evaluate", str(write(tmp_path)), "--truth", str(tmp_path / "scene.csv")]
    run(words)
    assert "poses of KITTI with" in capsys.readouterr().err
    run([*words, "-q"])
    assert "KITTI" not in capsys.readouterr().err
    run(words)  # quiet for one command alone
    assert "poses of KITTI with" in capsys.readouterr().err


def test_a_world_with_z_up_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = "".join(f"1 0 0 {0.1 * k} 0 1 0 {2.0 * k} 0 0 1 0\n" for k in range(N))
    path = write(tmp_path)
    path.write_text(lines)
    run(["evaluate", str(path), "--truth", str(tmp_path / "scene.csv")])
    assert "heights vary by 22 m, the way forward by 0 m: z seems to be up" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["tum", "euroc"])
def test_nanoseconds_of_tum_and_euroc_go_into_recordings(tmp_path: Path, kind: str) -> None:
    """Cases c21 and c23: these were read by evaluate alone."""
    path, out = tmp_path / f"truth.{'tum' if kind == 'tum' else 'csv'}", tmp_path / "out.mcap"
    start = 1_714_564_800_000_000_000
    if kind == "tum":
        path.write_text("".join(f"{start + k * 10**8} {k} {2 * k} 0 0 0 0 1\n" for k in range(N)))
    else:
        head = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n"
        path.write_text(head + "".join(f"{start + k * 10**8},{k},{2 * k},0,1,0,0,0\n" for k in range(N)))
    assert run(["ingest", "--truth", str(path), "-o", str(out)]) == ExitCode.DONE
    truth = open_recording(out).read(Truth)
    assert truth.t_ns.tolist() == [start + k * 10**8 for k in range(N)]
    assert truth.y.tolist() == [2 * k for k in range(N)]
