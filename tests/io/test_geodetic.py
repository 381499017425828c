"""Positions on the earth, in a scene: against a conversion of its own, and by files and bags on the command line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import ros1_bags
import ros_bags as ros

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.geodetic import Origin, degrees_of, places_of_degrees, scene_of_earth
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Truth

BERLIN = (52.5163, 13.3777)
STATED = "52.5163,13.3777"
X, Y = 2 + 0.5 * np.arange(6), 3 - 0.25 * np.arange(6)


def ecef(latitude: float, longitude: float, height: float) -> np.ndarray:
    """Earth-centred, earth-fixed coordinates by the closed form, with half axes of WGS 84."""
    a, b = 6378137.0, 6356752.314245179
    phi, lam = math.radians(latitude), math.radians(longitude)
    n = a * a / math.sqrt((a * math.cos(phi)) ** 2 + (b * math.sin(phi)) ** 2)
    return np.array([
        (n + height) * math.cos(phi) * math.cos(lam),
        (n + height) * math.cos(phi) * math.sin(lam),
        (n * b * b / (a * a) + height) * math.sin(phi),
    ])  # fmt: skip


def east_north_up(latitude: float, longitude: float) -> np.ndarray:
    """(3, 3) rows: east, north and up at a position, by differences of the closed form."""
    d = 1e-4
    east = ecef(latitude, longitude + d, 0) - ecef(latitude, longitude - d, 0)
    north = ecef(latitude + d, longitude, 0) - ecef(latitude - d, longitude, 0)
    east, north = east / np.linalg.norm(east), north / np.linalg.norm(north)
    return np.array([east, north, np.cross(east, north)])


@pytest.mark.parametrize(("latitude", "longitude"), [BERLIN, (-33.86, 151.21), (0.0, -179.9995), (71.2, 25.8)])
@pytest.mark.parametrize("turned", [0.0, 37.0])
def test_positions_are_those_of_the_closed_form(latitude: float, longitude: float, turned: float) -> None:
    """Within 0.1 mm over 10 km, and the plane of positions without heights within d^3 / 2 R^2 (1 mm at 5 km)."""
    random = np.random.default_rng(5)
    degrees = np.column_stack([longitude + random.uniform(-0.05, 0.05, 50), latitude + random.uniform(-0.05, 0.05, 50)])
    heights = random.uniform(-100, 500, 50)
    found = scene_of_earth(degrees, heights, Origin(latitude, longitude, turned, 40.0))
    axes, own = east_north_up(latitude, longitude), ecef(latitude, longitude, 40.0)
    wanted = np.array([axes @ (ecef(la, lo, h) - own) for (lo, la), h in zip(degrees, heights, strict=True)])
    c, s = math.cos(math.radians(turned)), math.sin(math.radians(turned))
    wanted[:, :2] = wanted[:, :2] @ np.array([[c, -s], [s, c]])
    assert np.abs(found - wanted).max() < 1e-4
    plane = places_of_degrees(degrees, Origin(latitude, longitude, turned))
    on_ground = scene_of_earth(degrees, np.zeros(50), Origin(latitude, longitude, turned, 0.0))[:, :2]
    distance = np.hypot(*on_ground.T)
    assert (np.hypot(*(plane - on_ground).T) < distance**3 / (2 * 6.33e6**2) * 1.1 + 1e-6).all()


def degrees() -> list[list[float]]:
    return degrees_of(np.column_stack([X, Y]), Origin(*BERLIN)).tolist()


def write_files(folder: Path) -> None:
    t = (1714564800 + np.arange(6)).tolist()
    rows = zip(t, degrees(), strict=True)
    text = "".join(f"{a},0,{lat!r},{lon!r},34.5\n" for a, (lon, lat) in rows)
    (folder / "truth.csv").write_text(f"time,id,latitude,longitude,altitude\n{text}")
    (folder / "tracks.csv").write_text(
        "time,id,x,y\n" + "".join(f"{a},0,{x},{y}\n" for a, x, y in zip(t, X, Y, strict=True))
    )
    points = "".join(
        f'<trkpt lat="{lat!r}" lon="{lon!r}"><ele>34.5</ele><time>2024-05-01T12:00:0{k}Z</time></trkpt>\n'
        for k, (lon, lat) in enumerate(degrees())
    )
    head = '<?xml version="1.0"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">'
    (folder / "truth.gpx").write_text(f"{head}<trk><name>a</name><trkseg>{points}</trkseg></trk></gpx>\n")


@pytest.mark.parametrize("name", ["truth.csv", "truth.gpx"])
def test_files_with_latitudes_are_truth_and_tracks(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """H10: GPX and latitude, longitude were refused, though GeoJSON was written with an origin."""
    write_files(tmp_path)
    path, tracks, out = str(tmp_path / name), str(tmp_path / "tracks.csv"), tmp_path / "out.mcap"
    assert run(["evaluate", tracks, "--truth", path, "--origin", STATED, "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["rmse_m"] < 1e-6
    assert run(["evaluate", path, "--truth", tracks, "--origin", STATED, "--json"]) == ExitCode.DONE
    found = capsys.readouterr()
    assert json.loads(found.out)["rmse_m"] < 1e-6
    assert found.err.count("heights are not used") == 1
    assert run(["ingest", "--truth", path, "-o", str(out), "--origin", f"{STATED},0,30"]) == ExitCode.DONE
    recording = open_recording(out)
    truth = recording.read(Truth)
    assert np.abs(truth.x - X).max() < 1e-4
    assert np.abs(truth.y - Y).max() < 1e-4
    assert np.abs(truth.z - 4.5).max() < 1e-4
    assert recording.provenance.input_units == (f"origin={STATED},0,30",)
    assert run(["info", path, "--origin", STATED]) == ExitCode.DONE


def test_latitude_and_longitude_that_are_exchanged_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    latitude, longitude = STATED.split(",")[:2]
    (tmp_path / "t.csv").write_text(f"time,id,lat,lon\n0,1,{longitude},{latitude}\n1,1,{longitude},{latitude}\n")
    assert run(["evaluate", str(tmp_path / "t.csv"), "--truth", str(tmp_path / "t.csv"), "--origin", STATED]) == (
        ExitCode.BAD_INPUT
    )
    assert "exchange latitude and longitude" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["truth.csv", "truth.gpx"])
def test_without_an_origin_the_first_position_is_suggested(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_files(tmp_path)
    ask = ["evaluate", str(tmp_path / "tracks.csv"), "--truth", str(tmp_path / name)]
    assert run(ask) == ExitCode.USAGE
    (line,) = capsys.readouterr().err.splitlines()
    suggested = line.split("--origin ")[1].split(" ")[0]
    lon, lat = degrees()[0]
    assert suggested == f"{lat:.7f},{lon:.7f}"
    assert run([*ask, "--origin", suggested, "-q"]) == ExitCode.DONE  # the hint is a command that works
    capsys.readouterr()
    assert run([*ask, "--origin", "13.3777,52.5163"]) == ExitCode.BAD_INPUT
    assert "km from the origin 13.3777,52.5163; exchange latitude and longitude" in capsys.readouterr().err
    assert run([*ask, "--origin", "52.5163"]) == ExitCode.USAGE
    assert "'52.5163' is not LAT,LON[,DEG[,HEIGHT]]" in capsys.readouterr().err
    tracks = str(tmp_path / "tracks.csv")
    assert run(["evaluate", tracks, "--truth", tracks, "--origin", STATED]) == ExitCode.USAGE
    assert "--origin: nothing that was read has latitudes" in capsys.readouterr().err


def test_faulty_positions_are_refused_with_their_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_files(tmp_path)
    tracks, path = str(tmp_path / "tracks.csv"), tmp_path / "faulty.gpx"
    text = (tmp_path / "truth.gpx").read_text()
    for old, new, words in (
        ("<time>2024-05-01T12:00:02Z</time>", "", "point 3: has no <time>"),
        ('lat="', 'lat="x', "point 1: lat, lon or <ele> is not a number"),
        ("</trk>", "", "not XML"),
        ("trkpt", "rtept", "no track (<trk>) has a point"),
        ('lat="52', 'lat="152', "are not on the earth; are they exchanged?"),
    ):
        path.write_text(text.replace(old, new))
        assert run(["evaluate", tracks, "--truth", str(path), "--origin", STATED]) == ExitCode.BAD_INPUT
        (line,) = [each for each in capsys.readouterr().err.splitlines() if "error:" in each]
        assert words in line


def test_stations_by_latitude_and_longitude_are_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    corners = degrees_of(np.array([[0.0, 40.0], [45.0, -5.0], [-40.0, 0.0]]), Origin(*BERLIN)).tolist()
    rows = "".join(f"{name},{lat!r},{lon!r}\n" for name, (lon, lat) in zip("abc", corners, strict=True))
    (tmp_path / "stations.csv").write_text(f"name,lat,lon\n{rows}")
    target, lines = np.array([3.0, 7.0]), ["time,sensor,bearing_deg,sigma_deg"]
    for k in range(4):
        for name, at in zip("abc", [(0, 40), (45, -5), (-40, 0)], strict=True):
            angle = math.degrees(math.atan2(*(target - at)[::-1]))
            lines.append(f"{k},{name},{angle!r},1")
    (tmp_path / "bearings.csv").write_text("\n".join(lines) + "\n")
    out = tmp_path / "out.csv"
    ask = ["track", str(tmp_path / "bearings.csv"), "--scene", str(tmp_path / "stations.csv"), "--method", "fix"]
    tracks = tmp_path / "tracks.parquet"
    assert run([*ask, "-o", str(tracks), "--origin", STATED]) == ExitCode.DONE
    assert run(["export", str(tracks), "-o", str(out)]) == ExitCode.DONE
    head, first, *_ = out.read_text().splitlines()
    row = dict(zip(head.split(","), first.split(","), strict=True))
    assert abs(float(row["x_m"]) - 3) < 1e-3
    assert abs(float(row["y_m"]) - 7) < 1e-3
    capsys.readouterr()
    assert run([*ask, "-o", str(tracks), "--overwrite"]) == ExitCode.USAGE
    assert f"--origin {corners[0][1]:.7f},{corners[0][0]:.7f} (its first position)" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_positions_of_satellite_receivers_in_bags_are_truth(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Log of the wild, mcap#943: NavSatFix as truth was refused. A message without a fix is a listed loss."""
    pytest.importorskip("rosbags")
    rows = ros.two_cameras(6)
    for k, (lon, lat) in enumerate(degrees()):
        t = ros.START + k * ros.STEP
        fix = ros.fix(t, lat, lon, 34.5, status=-1 if k == 4 else 0)
        rows.append(("/gps/fix", "sensor_msgs/msg/NavSatFix", t, fix))
    writers = {"ros1": (ros1_bags.write_bag, "gps.bag"), "ros2": (ros.write_mcap, "gps.mcap")}
    write, name = writers[kind]
    bag, out = write(tmp_path / name, rows), tmp_path / "out.mcap"
    ask = ["ingest", str(bag), "-o", str(out), "--topic", "0=/gps/fix"]
    assert run(ask) == ExitCode.USAGE
    lon, lat = degrees()[0]
    assert f"--origin {lat:.7f},{lon:.7f} (its first position)" in capsys.readouterr().err
    assert run([*ask, "--origin", f"{STATED},0,30"]) == ExitCode.LOSSY
    recording = open_recording(out)
    truth = recording.read(Truth)
    kept = [0, 1, 2, 3, 5]
    assert np.abs(truth.x - X[kept]).max() < 1e-4
    assert np.abs(truth.z - 4.5).max() < 1e-4
    (loss,) = recording.losses
    assert (loss.count, "the satellite receiver had no position fix (status -1)" in loss.what) == (1, True)


def test_longitudes_go_on_beyond_the_180th_meridian() -> None:
    for longitude in (180.0, -180.0):
        origin = Origin(10.0, longitude)
        xy = np.array([[500.0, 0.0], [-500.0, 0.0]])
        degrees = degrees_of(xy, origin)
        assert np.abs(degrees[:, 0]).max() <= 180.0
        assert sorted(np.sign(degrees[:, 0])) == [-1.0, 1.0]
        np.testing.assert_allclose(places_of_degrees(degrees, origin), xy, atol=1e-6)
