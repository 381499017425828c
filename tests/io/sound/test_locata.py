"""Tables of LOCATA, made after its description: poses of arrays, microphones, sources, times."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.core.geometry.camera import array_rotation
from occlog.errors import ExitCode, InputError
from occlog.io.formats.sound.formats import STILL_M, read_array, read_source
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Truth

HEAD = ["year", "month", "day", "hour", "minute", "second", "x", "y", "z", "ref_vec_x", "ref_vec_y", "ref_vec_z"]
HEAD += [f"rotation_{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
TURN = array_rotation(math.radians(40), math.radians(10), math.radians(-5))
MICROPHONES = np.array([[0.05, 0.0, 0.0], [0.0, 0.07, 0.0], [-0.05, 0.0, 0.02], [0.0, -0.07, -0.01]])
CENTRE = np.array([2.0, 3.0, 1.1])


def row(second: str, place: np.ndarray, turn: np.ndarray, microphones: np.ndarray | None = None) -> str:
    cells = ["2018", "1", "31", "23", "59", second, *(f"{v:.9f}" for v in (*place, *turn[:, 1], *turn.reshape(-1)))]
    if microphones is not None:
        cells += [f"{v:.9f}" for v in (place + microphones @ turn.T).reshape(-1)]
    return "\t".join(cells)


def array_file(tmp_path: Path, *rows: str, name: str = "position_array_dicit.txt") -> Path:
    head = [*HEAD, *(f"mic{n}_{axis}" for n in (1, 2, 3, 4) for axis in "xyz")]
    path = tmp_path / name
    path.write_text("\n".join(["\t".join(head), *rows]) + "\n")
    return path


def source_file(tmp_path: Path, *rows: str, name: str = "position_source_talker3.txt") -> Path:
    path = tmp_path / name
    path.write_text("\n".join(["\t".join(HEAD), *rows]) + "\n")
    return path


def test_an_array_has_its_pose_and_its_microphones_in_its_own_frame(tmp_path: Path) -> None:
    path = array_file(tmp_path, *(row(f"{k}.5", CENTRE + 0.001 * k, TURN, MICROPHONES) for k in range(3)))
    array = read_array(path, None)
    assert array.name == "dicit"
    assert np.allclose(array.position, CENTRE + 0.001)
    assert np.allclose(array.rotation, TURN, atol=1e-7)
    assert np.allclose(array.microphones, MICROPHONES, atol=1e-7)
    assert read_array(path, "mine").name == "mine"


def test_an_array_may_tremble_so_far_and_no_farther(tmp_path: Path) -> None:
    def moved(by: float) -> Path:
        rows = [row("1.0", CENTRE, TURN, MICROPHONES), row("2.0", CENTRE + np.array([by, 0, 0]), TURN, MICROPHONES)]
        return array_file(tmp_path, *rows)

    assert read_array(moved(STILL_M - 1e-6), None).name == "dicit"
    with pytest.raises(InputError, match=r"line 3: the array has moved by 0.031 m and 0 degrees .* moving arrays"):
        read_array(moved(STILL_M + 1e-3), None)
    turned = array_rotation(math.radians(43), math.radians(10), math.radians(-5))
    rows = [row("1.0", CENTRE, TURN, MICROPHONES), row("2.0", CENTRE, turned, MICROPHONES)]
    with pytest.raises(InputError, match="and 3 degrees"):
        read_array(array_file(tmp_path, *rows), None)


def test_a_source_has_exact_times_and_the_number_of_its_name(tmp_path: Path) -> None:
    rows = [row("58.123456789", CENTRE, TURN), row("58.123456789", CENTRE, TURN), row("59.5", CENTRE + 1, TURN)]
    truth = read_source(source_file(tmp_path, *rows))
    start = 1_517_443_198  # 2018-01-31T23:59:58Z
    assert truth.t_ns.tolist() == [start * 10**9 + 123_456_789, (start + 1) * 10**9 + 500_000_000]
    assert truth.target_id.tolist() == [3, 3]
    assert np.allclose([truth.x[1], truth.y[1], truth.z[1]], CENTRE + 1)
    assert read_source(source_file(tmp_path, rows[0], name="position_source_talker.txt")).target_id.tolist() == [0]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([row("2.0", CENTRE, TURN), row("1.0", CENTRE, TURN)], "line 3: its time is before that of the row above"),
        ([row("60", CENTRE, TURN)], "line 2: not a date and time"),
        ([row("x", CENTRE, TURN)], "line 2: not a date and time"),
        ([row("1", CENTRE, TURN).replace("2018\t1\t31", "2018\t2\t31")], "line 2: not a date and time"),
        ([], "has no row"),
    ],
)
def test_faults_of_a_source_are_named(tmp_path: Path, rows: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_source(source_file(tmp_path, *rows))


def test_faults_of_an_array_are_named(tmp_path: Path) -> None:
    mirrored = TURN * [1, 1, -1]
    with pytest.raises(InputError, match="line 2: rotation_11 to rotation_33 are not a rotation"):
        read_array(array_file(tmp_path, row("1", CENTRE, mirrored, MICROPHONES)), None)
    with pytest.raises(InputError, match="has no column mic1_x"):
        read_array(source_file(tmp_path, row("1", CENTRE, TURN)), None)


def test_ingest_takes_arrays_and_sources_without_anything_else(tmp_path: Path) -> None:
    array = array_file(tmp_path, row("1", CENTRE, TURN, MICROPHONES))
    source = source_file(tmp_path, *(row(f"{k}.0", CENTRE + k, TURN) for k in range(4)))
    out = tmp_path / "room.mcap"
    assert run(["ingest", "-o", str(out), "--arrays", str(array), "--truth", str(source), "-q"]) == ExitCode.DONE
    recording = open_recording(out)
    assert recording.scene is not None
    assert [a.name for a in recording.scene.arrays] == ["dicit"]
    assert np.allclose(recording.scene.arrays[0].rotation, TURN, atol=1e-7)
    assert len(recording.read(Truth)) == 4
