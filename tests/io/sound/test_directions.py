"""Directions of arrival: conventions, sets, real logs, malformed rows."""

from __future__ import annotations

import csv
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, UsageError
from occlog.io.formats.sound.csv_log import DoaOptions
from occlog.io.formats.sound.directions import read_doa, to_world
from occlog.io.formats.sound.formats import read_arrays
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Doa

ARRAYS = (MicrophoneArray("a1", np.zeros(3), yaw=0.5), MicrophoneArray("a2", np.ones(3)))


def read(path: Path, arrays: tuple[MicrophoneArray, ...] = ARRAYS, **options: object) -> Doa:
    return Doa.concat(read_doa(path, arrays, DoaOptions(**options)))  # type: ignore[arg-type]


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "doa.csv"
    path.write_text(text)
    return path


def test_degrees_radians_and_the_other_columns(tmp_path: Path) -> None:
    text = "time,sensor,azimuth_deg,elevation_deg,sigma_deg,confidence,id\n0,a1,90,30,2,0.5,7\n0,a2,-170,,,,-1\n"
    doa = read(write(tmp_path, text))
    assert doa.sensor.tolist() == ["a1", "a2"]
    assert np.allclose(doa.azimuth, np.radians([90, -170]))
    assert doa.elevation[0] == pytest.approx(math.radians(30))
    assert doa.sigma_azimuth[0] == pytest.approx(math.radians(2))
    assert np.isnan([doa.elevation[1], doa.sigma_azimuth[1], doa.confidence[1]]).all()
    assert doa.source_id.tolist() == [7, -1]


@pytest.mark.parametrize(("convention", "want"), [("math", 10.0), ("compass", 80.0), ("array", 10 + math.degrees(0.5))])
def test_conventions(tmp_path: Path, convention: str, want: float) -> None:
    doa = read(write(tmp_path, "t_ns,sensor,azimuth_deg\n0,a1,10\n"), convention=convention)
    assert math.degrees(doa.azimuth[0]) == pytest.approx(want)


def test_compass_points() -> None:
    world = np.degrees(to_world(np.radians([0.0, 90, 180, 270, 360]), "compass"))
    assert np.allclose(world, [90, 0, -90, -180, 90])
    assert (to_world(np.array([-np.pi, np.pi, 3 * np.pi]), "math") == -np.pi).all()


def test_a_set_of_directions_at_one_time_stays_a_set(tmp_path: Path) -> None:
    doa = read(write(tmp_path, "time,azimuth_rad\n0,1\n0,-1\n1,2\n"), sensor="a1")
    assert doa.t_ns.tolist() == [0, 0, 10**9]
    assert sorted(doa.azimuth[:2].tolist()) == [-1, 1]
    assert (doa.source_id == -1).all()


def test_a_unit_that_is_not_stated_is_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path, "time,sensor,azimuth\n0,a1,90\n")
    with pytest.raises(UsageError, match="name it azimuth_deg, or give --doa-unit"):
        read(path)
    assert read(path, unit="deg").azimuth[0] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,sensor,azimuth_rad\n0,a1,90\n", "line 2: azimuth_rad is 90; it is too large for radians"),
        ("time,sensor,azimuth_deg\n0,a1,x\n", "line 2: azimuth_deg is 'x'"),
        ("time,sensor,azimuth_deg\n0,a1,nan\n", "line 2: azimuth_deg is missing"),
        ("time,sensor,azimuth_deg\n0,b7,1\n", "array 'b7' is none of a1, a2"),
        ("time,sensor,azimuth_deg\n1,a1,1\n0,a1,1\n", "line 3: time of a1 goes back"),
        ("time,sensor,azimuth_deg,elevation_deg\n0,a1,1,91\n", "line 2: elevation_deg is 91; it must be within 90"),
        ("time,sensor,azimuth_deg,sigma_deg\n0,a1,1,0\n", "line 2: sigma_azimuth|must be above 0"),
        ("time,sensor,azimuth_deg,confidence\n0,a1,1,3\n", "line 2: confidence is 3; it must be 0 to 1"),
        ("sensor,azimuth_deg\na1,1\n", "has no column of times"),
        ("time,azimuth_deg\n0,1\n", "has no column sensor"),
        ("time,sensor,azimut_deg\n0,a1,1\n", "has no column of azimuths"),
        ("time,sensor,azimuth_deg,azimuth_rad\n0,a1,1,1\n", "columns azimuth_deg and azimuth_rad both state"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("column", "good", "bad", "message"),
    [
        ("elevation_deg", "90", "90.0001", "it must be within 90 degrees"),
        ("elevation_deg", "-90", "-90.0001", "it must be within 90 degrees"),
        ("confidence", "0", "-1e-9", "it must be 0 to 1"),
        ("confidence", "1", "1.000000001", "it must be 0 to 1"),
        ("sigma_deg", "1e-9", "0", "it must be above 0"),
        ("elevation_rad", "1.5707963267948966", "1.5707963267948968", "it must be within 90 degrees"),
    ],
)
def test_limits_of_a_column_are_allowed_and_no_more(
    tmp_path: Path, column: str, good: str, bad: str, message: str
) -> None:
    head = f"time,sensor,azimuth_deg,{column}\n0,a1,1,"
    assert len(read(write(tmp_path, f"{head}{good}\n"))) == 1
    with pytest.raises(InputError, match=f"line 2: .* is {bad}; {message}"):
        read(write(tmp_path, f"{head}{bad}\n"))


def test_radians_are_at_most_two_turns(tmp_path: Path) -> None:
    head = "time,sensor,azimuth_rad\n0,a1,"
    assert len(read(write(tmp_path, f"{head}{4 * math.pi!r}\n"))) == 1
    with pytest.raises(InputError, match="too large for radians"):
        read(write(tmp_path, f"{head}{math.nextafter(4 * math.pi, 99)!r}\n"))


def test_times_of_an_array_may_repeat_across_its_rows_but_not_go_back(tmp_path: Path) -> None:
    head = "t_ns,sensor,azimuth_deg\n5,a1,1\n"
    assert len(read(write(tmp_path, f"{head}5,a1,2\n"))) == 2
    with pytest.raises(InputError, match="line 3: time of a1 goes back"):
        read(write(tmp_path, f"{head}4,a1,2\n"))


@pytest.mark.parametrize("bad", ["360.001", "-0.001"])
def test_bearings_of_a_field_log_are_0_to_360(tmp_path: Path, bad: str) -> None:
    log = tmp_path / "log.dat"
    (tmp_path / "towers.dat").write_text("0,0\n100,0\n")
    log.write_text(f"06/10/84 13:31:34 7 S 1 360 2 {bad}\n")
    with pytest.raises(InputError, match=r"line 1: bearing .*; it must be 0 to 360 degrees"):
        read(log, read_arrays(tmp_path / "towers.dat"))


def telemetr(shared_data: Path) -> tuple[dict[str, np.ndarray], Doa]:
    folder = shared_data / "telemetr_bearings"
    towers = read_arrays(folder / "towers.dat")
    return {t.name: t.position[:2] for t in towers}, read(folder / "azimuth.dat", towers)


def test_field_log_of_bearings_from_north(shared_data: Path) -> None:
    towers, doa = telemetr(shared_data)
    assert len(towers) == 8
    assert towers["tower1"].tolist() == [746917, 4391247]
    assert len(doa) == 3 * 276 - 45  # 0 is no bearing
    first = doa.take(doa.t_ns == doa.t_ns[0])
    assert first.sensor.tolist() == ["tower6", "tower7", "tower8"]
    assert np.allclose(np.degrees(first.azimuth), [90 - 48, 90 - 331 + 360, 90 - 160])
    assert set(doa.source_id.tolist()) == {340}  # the animal


def test_animals_of_a_field_log_are_identities_if_they_are_numbers(tmp_path: Path) -> None:
    log = tmp_path / "log.dat"
    log.write_text("06/10/84 13:31:34 7 S 1 48 2 331\n06/10/84 13:31:35 owl M 1 50 2 330\n")
    (tmp_path / "towers.dat").write_text("0,0\n100,0\n")
    doa = read(log, read_arrays(tmp_path / "towers.dat"))
    assert doa.source_id.tolist() == [7, 7, -1, -1]


def test_a_bearing_of_0_in_a_field_log_is_none(tmp_path: Path) -> None:
    log = tmp_path / "log.dat"
    log.write_text("06/10/84 13:31:34 7 S 1 0 2 331\n06/10/84 13:31:35 7 M 1 360 2 0\n")
    (tmp_path / "towers.dat").write_text("0,0\n100,0\n")
    doa = read(log, read_arrays(tmp_path / "towers.dat"))
    assert doa.sensor.tolist() == ["tower2", "tower1"]
    assert np.degrees(doa.azimuth).tolist() == pytest.approx([119.0, 90.0])


def test_bearings_of_the_field_log_meet_at_the_published_fixes(shared_data: Path) -> None:
    """Least-squares crossings lie metres from the fixes of the authors' program; a wrong sign or north, km."""
    towers, doa = telemetr(shared_data)
    text = (shared_data / "telemetr_bearings/fixes.dat").read_text().split()
    pairs = [(a, b) for a, b in pairwise(text) if len(a) == len(b) == 7 and a.startswith("07")]
    fixes = [(float(a), float(b)) for a, b in pairs]
    distances = []
    for t in np.unique(doa.t_ns):
        rows = doa.take(doa.t_ns == t)
        normals = np.column_stack([-np.sin(rows.azimuth), np.cos(rows.azimuth)])
        right = np.array([n @ towers[s] for n, s in zip(normals, rows.sensor.tolist(), strict=True)])
        point, *_ = np.linalg.lstsq(normals, right, rcond=None)
        distances.append(min(math.dist(point, fix) for fix in fixes))
    assert len(fixes) > 200
    assert np.median(distances) < 40


@pytest.mark.parametrize(("algorithm", "limit"), [("FRI", 0.6), ("MUSIC", 0.6), ("SRP", 1.1)])
def test_estimates_of_frida_agree_with_the_true_azimuths(shared_data: Path, algorithm: str, limit: float) -> None:
    folder = shared_data / "frida_pyramic_doa"
    (array,) = read_arrays(folder / "mic_positions_m.csv", "pyramic")
    assert array.microphones.shape == (24, 3)
    doa = read(folder / "doa_estimates.csv", (array,), sensor="pyramic", algorithm=algorithm)
    with (folder / "truth_azimuth_deg.csv").open() as file:
        true = {row["speaker"]: float(row["azimuth_deg"]) for row in csv.DictReader(file)}
    with (folder / "doa_estimates.csv").open() as file:
        recordings = list(dict.fromkeys((r["recording"], r["speakers"], r["n_speakers"]) for r in csv.DictReader(file)))
    assert len(np.unique(doa.t_ns)) == len(recordings) == 92
    errors = []
    for k, (_, speaker, count) in enumerate(recordings):
        if count == "1" and speaker in true:
            estimates = np.degrees(doa.azimuth[doa.t_ns == k * 10**9])
            errors.append(np.abs((estimates - true[speaker] + 180) % 360 - 180).min())
    assert len(errors) == 7
    assert np.median(errors) < limit


def test_frida_needs_an_array_and_an_algorithm(shared_data: Path) -> None:
    path = shared_data / "frida_pyramic_doa/doa_estimates.csv"
    with pytest.raises(UsageError, match="choose one"):
        read(path, sensor="a1")
    with pytest.raises(UsageError, match=r"give it as ARRAY=doa_estimates\.csv"):
        read(path, algorithm="FRI")
    with pytest.raises(UsageError, match=r"has no algorithm 'XYZ' \(--doa-algorithm\); choose one of FRI"):
        read(path, sensor="a1", algorithm="XYZ")


def test_places_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no column z"):
        read_arrays(write(tmp_path, "x,y\n1,2\n"))
    with pytest.raises(InputError, match="4 columns"):
        read_arrays(write(tmp_path, "1,2,3,4\n"))


def test_times_in_ms_and_angles_in_radians_are_not_taken_for_seconds_and_degrees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [(k, name, -3.0 + 0.1 * k) for k in range(30) for name in ("a1", "a2")]
    head = "time,sensor,azimuth_deg\n"
    with pytest.raises(InputError) as caught:
        read(write(tmp_path, head + "".join(f"{100 * k},{name},{20 * angle}\n" for k, name, angle in rows)))
    assert caught.value.id == "missing-unit"
    read(write(tmp_path, head + "".join(f"{k / 10},{name},{20 * angle}\n" for k, name, angle in rows)))
    assert "radians" not in capsys.readouterr().err
    read(write(tmp_path, head + "".join(f"{k / 10},{name},{angle}\n" for k, name, angle in rows)))
    assert "radians" in capsys.readouterr().err


@pytest.mark.parametrize(("unit", "scale"), [("", 1.0), ("_m", 1.0), ("_cm", 100.0), ("_mm", 1000.0)])
def test_positions_of_microphones_state_their_unit(tmp_path: Path, unit: str, scale: float) -> None:
    path = tmp_path / "mics.csv"
    path.write_text(f"x{unit},y{unit},z{unit}\n{0.02 * scale},0,0\n0,{0.03 * scale},0\n0,0,{0.01 * scale}\n")
    (array,) = read_arrays(path)
    assert array.microphones is not None
    assert np.allclose(array.microphones, np.diag([0.02, 0.03, 0.01]))
    path.write_text("x,x_mm,y,z\n1,1,1,1\n")
    with pytest.raises(InputError) as caught:
        read_arrays(path)
    assert caught.value.id == "missing-column"


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.linspace(0.0, 1.0, 40, endpoint=False), "turns?"),
        (np.linspace(-3.1, 3.1, 40), "radians?"),
        (np.linspace(0.0, 399.0, 40), "gon?"),
        (np.linspace(0.0, 359.9, 40), ""),
        (np.linspace(-10.0, 10.0, 40), ""),
    ],
)
def test_a_range_of_azimuths_of_another_unit_is_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], values: np.ndarray, said: str
) -> None:
    rows = [f"{k},{'a1' if k % 2 else 'a2'},{value:.4f}" for k, value in enumerate(values.tolist())]
    read(write(tmp_path, "\n".join(["t_s,sensor,azimuth_deg", *rows]) + "\n"))
    stderr = capsys.readouterr().err
    assert said in stderr
    assert ("warning" in stderr) is bool(said)
