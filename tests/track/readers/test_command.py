"""Readers as programs: `occlog ingest`, `occlog fit-readers`, and `occlog track` with `virtual` and `rssi`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.formats.models.motion_models import read_path_loss
from occlog.records.tables import Bearings, TagTracks, Tracks, VirtualSensors

READERS = [(x, y) for x in (1.0, 5.0, 9.0) for y in (1.0, 5.0, 9.0)]
SCENE = "occlog_scene: 1\nroom: [[0, 0], [10, 0], [10, 10], [0, 10]]\n"


def write_log(folder: Path, name: str, seed: int, seconds: int = 60) -> None:
    """Reads of two tags on circles, and where they truly are."""
    rng = np.random.default_rng(seed)
    reads, truth = ["t,reader,tag,rssi"], ["t,id,x,y"]
    for k in range(seconds * 4):
        t = 1000.0 + 0.25 * k
        for tag in (3, 8):
            turn = 0.12 * 0.25 * k + tag
            x, y = 5.0 + 3.0 * np.cos(turn), 5.0 + 3.0 * np.sin(turn)
            truth.append(f"{t:.3f},{tag},{x:.4f},{y:.4f}")
            for n, (rx, ry) in enumerate(READERS):
                strength = (
                    -60.0 - 20.0 * np.log10(np.hypot(np.hypot(x - rx, y - ry), 1.0)) + 3.0 * rng.standard_normal()
                )
                if rng.random() < 0.5:
                    reads.append(f"{t:.3f},r{n},{tag},{strength:.1f}")
    (folder / f"{name}.reads.csv").write_text("\n".join(reads) + "\n")
    (folder / f"{name}.truth.csv").write_text("\n".join(truth) + "\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of the same readers, and path losses that were fitted to the first."""
    at = tmp_path_factory.mktemp("tags")
    (at / "scene.yaml").write_text(SCENE)
    rows = [f"r{n},{x},{y},2.2" for n, (x, y) in enumerate(READERS)]
    (at / "readers.csv").write_text("\n".join(["reader,x,y,z", *rows]) + "\n")
    for name, seed in (("a", 1), ("b", 2)):
        write_log(at, name, seed)
        scene = ["--scene", str(at / "scene.yaml"), "--readers", str(at / "readers.csv")]
        log = ["--reads", str(at / f"{name}.reads.csv"), "--truth", str(at / f"{name}.truth.csv")]
        assert run(["ingest", *scene, *log, "-o", str(at / f"{name}.mcap"), "-q"]) == ExitCode.DONE
    assert run(["fit-readers", str(at / "a.mcap"), "-o", str(at / "loss.json"), "-q"]) == ExitCode.DONE
    return at


def errors(folder: Path, tracks: Path) -> dict[str, float]:
    out = tracks.with_suffix(".json")
    assert run(["evaluate", str(tracks), "--truth", str(folder / "b.mcap"), "-o", str(out), "-q"]) == ExitCode.DONE
    found: dict[str, float] = json.loads(out.read_text())
    return found


def test_the_fit_finds_the_path_loss(folder: Path) -> None:
    spec = read_path_loss(folder / "loss.json")
    assert abs(spec.exponent - 2.0) < 0.1
    assert np.abs(np.array([r.power for r in spec.readers]) + 60.0).max() < 1.0
    assert abs(spec.noise_db - 3.0) < 0.2
    assert spec.coverage.detection > 0.7 > spec.coverage.stray


def test_signals_locate_better_than_virtual_sensors_and_both_know_how_well(folder: Path) -> None:
    found = {}
    for method in ("virtual", "rssi"):
        out = folder / f"{method}.parquet"
        options = ["--method", method, "--path-loss", str(folder / "loss.json"), "-q"]
        assert run(["track", str(folder / "b.mcap"), "-o", str(out), *options]) == ExitCode.DONE
        found[method] = errors(folder, out)
        table = read_table(out, TagTracks)
        assert set(table.target_id.tolist()) == {3, 8}
        assert len(read_table(out, Tracks)) == len(table)
        assert read_provenance(out).parameters["method"] == method
    assert found["rssi"]["rmse_m"] < 0.7 * found["virtual"]["rmse_m"]
    assert 0.8 < found["rssi"]["nees_mean"] < 3.5
    assert 0.8 < found["virtual"]["nees_mean"] < 3.5


def test_later_reads_make_tracks_better_and_a_lag_gives_nearly_the_same(folder: Path) -> None:
    tables, found = {}, {}
    for name, how in (("filter", []), ("smooth", ["--smooth"]), ("lag", ["--lag", "8"])):
        out = folder / f"{name}.parquet"
        options = ["--method", "rssi", "--path-loss", str(folder / "loss.json"), "--set", "particles=2000", "-q", *how]
        assert run(["track", str(folder / "b.mcap"), "-o", str(out), *options]) == ExitCode.DONE
        tables[name], found[name] = read_table(out, TagTracks), errors(folder, out)
    assert found["smooth"]["rmse_m"] < 0.85 * found["filter"]["rmse_m"]
    assert 0.8 < found["smooth"]["nees_mean"] < 3.5
    # The same rows in the same order, and the filter's flags
    for name in ("smooth", "lag"):
        for column in ("t_ns", "target_id", "read_by", "quality_flags"):
            assert getattr(tables[name], column).tolist() == getattr(tables["filter"], column).tolist()
    apart = np.hypot(tables["smooth"].x - tables["lag"].x, tables["smooth"].y - tables["lag"].y)
    assert 0.0 < apart.max() < 0.2


@pytest.mark.parametrize("method", ["virtual", "rssi", "map"])
def test_what_was_lost_of_the_reads_of_a_path_loss_is_lost_for_tracks_too(folder: Path, method: str) -> None:
    loss, tracks = json.loads((folder / "loss.json").read_text()), folder / "lossy.parquet"
    lost = {"source": "a.mcap", "place": "after 5 s", "what": "is cut", "count": 3}
    loss["_provenance"]["losses"] = [lost]
    (folder / "lossy.json").write_text(json.dumps(loss))
    options = ["--method", method, "--path-loss", str(folder / "lossy.json"), "-q", "--overwrite"]
    assert run(["track", str(folder / "b.mcap"), "-o", str(tracks), *options]) == ExitCode.DONE
    assert [each.as_dict() for each in read_provenance(tracks).losses] == [lost]


@pytest.mark.jit
def test_strengths_of_reads_are_measurements_of_other_methods_with_the_fitted_path_loss(folder: Path) -> None:
    tracks, loss = folder / "b.map.parquet", folder / "loss.json"
    args = ["track", str(folder / "b.mcap"), "--method", "map", "--path-loss", str(loss), "-o", str(tracks), "-q"]
    assert run(args) == ExitCode.DONE
    found = errors(folder, tracks)
    assert found["rmse_m"] < 0.6  # one read of 3 dB at 4 m is good for 1.4 m
    assert 1.0 < found["nees_mean"] < 3.5
    parameters = read_provenance(tracks).parameters["measurements"]
    assert parameters["radio"]["exponent"] == read_path_loss(loss).exponent
    assert parameters["path_loss"] == "loss.json"


def test_virtual_sensors_are_written_with_their_readers(folder: Path) -> None:
    out, regions = folder / "stated.parquet", folder / "regions.parquet"
    options = ["--method", "virtual", "--set", "reader_range=4", "--virtual-sensors", str(regions), "-q"]
    assert run(["track", str(folder / "b.mcap"), "-o", str(out), *options]) == ExitCode.DONE
    table = read_table(regions, VirtualSensors)
    assert table.area.sum() == pytest.approx(100.0, rel=1e-3)
    assert "r4" in table.readers.tolist() or any("r4" in names.split(",") for names in table.readers.tolist())
    assert [len(names.split(",")) for names in table.readers.tolist()] == table.count.tolist()


def write_sights(folder: Path, *, labelled: bool) -> tuple[Path, Path]:
    """A scene with two cameras at the walls, and what they see of both tags, 4 times a second."""
    lines = ["cameras:"]
    places = {"left": (0.0, 5.0, 0.0), "bottom": (5.0, 0.0, 90.0)}
    for name, (x, y, yaw) in places.items():
        lines.append(f"- {{name: {name}, position: [{x}, {y}], yaw_deg: {yaw}, focal_px: 500, fov_deg: 160}}")
    lines.append("readers:")
    lines += [f"- {{name: r{n}, position: [{x}, {y}, 2.2]}}" for n, (x, y) in enumerate(READERS)]
    scene = folder / "cameras.yaml"
    scene.write_text(SCENE + "\n".join(lines) + "\n")
    truth = np.genfromtxt(folder / "b.truth.csv", delimiter=",", names=True)
    rng, rows = np.random.default_rng(7), []
    for name, (x, y, _) in places.items():
        bearing = np.arctan2(truth["y"] - y, truth["x"] - x) + 0.01 * rng.standard_normal(len(truth))
        for t, tag, b in zip(truth["t"], truth["id"], bearing, strict=True):
            rows.append((round(t * 1e9), name, int(tag) if labelled else -1, b))
    rows.sort()
    t, sensor, tag, bearing = zip(*rows, strict=True)
    nothing = np.full(len(t), np.nan)
    table = Bearings.of(
        t_ns=t,
        sensor=sensor,
        target_id=np.array(tag, dtype=np.int32),
        seen=np.ones(len(t), dtype=np.bool_),
        bearing=bearing,
        sigma=np.full(len(t), 0.01),
        u_px=nothing,
        sigma_px=nothing,
        score=nothing,
    )
    sights = folder / f"sights_{labelled}.parquet"
    with TableWriter(sights, Bearings, Provenance("detect"), overwrite=True) as writer:
        writer.write(table)
    return scene, sights


@pytest.mark.parametrize(
    ("method", "labelled"),
    [
        ("virtual", False),
        ("rssi", True),
        *(pytest.param(*case, marks=pytest.mark.statistics) for case in (("virtual", True), ("rssi", False))),
    ],
)
def test_cameras_refine_positions_with_labels_or_by_the_coarse_position(
    folder: Path, method: str, labelled: bool
) -> None:
    scene, sights = write_sights(folder, labelled=labelled)
    options = ["--scene", str(scene), "--method", method, "--path-loss", str(folder / "loss.json"), "-q"]
    found = {}
    for name, more in (("coarse", []), ("rays", ["--refine", "left,bottom", "--refine-bearings", str(sights)])):
        out = folder / f"{method}_{name}_{labelled}.parquet"
        assert run(["track", str(folder / "b.mcap"), "-o", str(out), *options, *more]) == ExitCode.DONE
        found[name] = errors(folder, out)
    table = read_table(out, TagTracks)
    assert (table.refined_by != "").mean() > 0.9
    # Candidates of two tags without labels may be exchanged where the tags are near each other
    assert found["rays"]["error_median_m"] < (0.4 if labelled else 0.7) * found["coarse"]["error_median_m"]
    if labelled:
        assert found["rays"]["nees_mean"] < 4.0


def test_refinement_says_what_it_wants(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, sights = write_sights(folder, labelled=True)
    base = ["track", str(folder / "b.mcap"), "-o", str(folder / "never.parquet"), "--method", "virtual"]
    base += ["--set", "reader_range=4", "--scene", str(scene)]
    for more, says in (
        (
            ["--refine", "right", "--refine-bearings", str(sights)],
            "no camera 'right' with a pose in the scene; cameras: left",
        ),
        (
            ["--refine", "left", "--refine-method", "parallel", "--refine-bearings", str(sights)],
            "parallel requires exactly two cameras",
        ),
        (["--refine-bearings", str(sights)], "name them with --set refine="),
    ):
        assert run([*base, *more]) == ExitCode.USAGE
        assert says in capsys.readouterr().err
    assert run([*base, "--refine", "left"]) == ExitCode.BAD_INPUT
    assert "holds no bearings; give bearings of the cameras that refine" in capsys.readouterr().err


def test_one_reader_and_one_tag_can_be_chosen(folder: Path) -> None:
    out = folder / "one.parquet"
    options = ["--method", "virtual", "--set", "reader_range=4", "--cameras", "r4", "--target", "8", "-q"]
    assert run(["track", str(folder / "b.mcap"), "-o", str(out), *options]) == ExitCode.DONE
    table = read_table(out, TagTracks)
    assert set(table.read_by.tolist()) == {"r4"}
    assert set(table.target_id.tolist()) == {8}
    np.testing.assert_allclose(np.column_stack([table.x, table.y]), 5.0)
    np.testing.assert_allclose(table.cov_xx, 4.0, rtol=1e-2)


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["--method", "virtual"], ExitCode.BAD_INPUT, "how far reader r0 reads is not known"),
        (["--method", "virtual", "--set", "reader_range=-2"], ExitCode.USAGE, "--set reader_range=-2: must be above 0"),
        (["--method", "virtual", "--set", "reader_range=4", "--window", "0"], ExitCode.USAGE, "give one above 0 s"),
        (["--method", "rssi", "--cameras", "r44"], ExitCode.USAGE, "no reader 'r44'"),
        (["--method", "rssi", "--target", "5"], ExitCode.BAD_INPUT, "no RFID reads of the chosen tags"),
        (
            ["--method", "virtual", "--set", "reader_range=4", "--set", "min_rssi_dbm=20"],
            ExitCode.BAD_INPUT,
            "no read reaches the threshold",
        ),
        (
            ["--method", "rssi", "--set", "false_alarm_probability=0.96"],
            ExitCode.USAGE,
            "--set false_alarm_probability=0.96: must be below detection",
        ),
        (
            ["--method", "rssi", "--path-loss", "LOSS", "--set", "path_loss_exponent=3"],
            ExitCode.USAGE,
            "--path-loss and --set path_loss_exponent= state the same quantity",
        ),
        (["--method", "apf"], ExitCode.BAD_INPUT, "track the reads of its tags with method rssi or virtual"),
    ],
)
def test_wrong_options_are_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], code: ExitCode, says: str
) -> None:
    out = folder / "never.parquet"
    given = [str(folder / "loss.json") if text == "LOSS" else text for text in options]
    assert run(["track", str(folder / "b.mcap"), "-o", str(out), *given]) == code
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert says in error[0]
    assert not out.exists()


def test_a_recording_without_reads_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, truth = str(folder / "scene.yaml"), str(folder / "a.truth.csv")
    recording, doa = folder / "silent.mcap", folder / "doa.csv"
    doa.write_text("t,sensor,azimuth_deg\n1,h,30\n")
    arrays = folder / "h.csv"
    arrays.write_text("x,y,z\n0,0,0\n")
    given = ["--scene", scene, "--truth", truth, "--arrays", f"h={arrays}", "--doa", f"h={doa}"]
    assert run(["ingest", *given, "-o", str(recording), "-q"]) == ExitCode.DONE
    out = str(folder / "never.parquet")
    assert run(["track", str(recording), "-o", out, "--method", "rssi"]) == ExitCode.BAD_INPUT
    assert "holds no reads of tags; make a recording with reads" in capsys.readouterr().err


def test_an_unknown_reader_stops_the_ingest(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = folder / "bad.csv"
    bad.write_text("t,reader,tag\n1,r0,3\n2,r99,3\n")
    out = folder / "bad.mcap"
    options = ["--readers", str(folder / "readers.csv"), "--reads", str(bad), "-o", str(out)]
    assert run(["ingest", *options]) == ExitCode.BAD_INPUT
    assert "line 3: reader 'r99' has no position; readers: r0, r1" in capsys.readouterr().err
    assert not out.exists()


def test_a_reader_may_not_have_the_name_of_another_sensor(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = folder / "named.yaml"
    scene.write_text(SCENE + "readers: [{name: r0, position: [0, 0]}]\n")
    options = ["--scene", str(scene), "--readers", str(folder / "readers.csv")]
    log = ["--reads", str(folder / "a.reads.csv"), "-o", str(folder / "bad.mcap")]
    assert run(["ingest", *options, *log]) == ExitCode.USAGE
    assert "reader r0 has the name of another sensor" in capsys.readouterr().err


def test_a_fit_without_truth_of_the_tag_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = folder / "other.csv"
    truth.write_text("t,id,x,y\n1000,1,5,5\n1060,1,5,5\n")
    recording = folder / "other.mcap"
    options = ["--readers", str(folder / "readers.csv"), "--reads", str(folder / "a.reads.csv"), "--truth", str(truth)]
    assert run(["ingest", *options, "-o", str(recording), "-q"]) == ExitCode.DONE
    assert run(["fit-readers", str(recording), "-o", str(folder / "never.json")]) == ExitCode.BAD_INPUT
    assert "the truth has no target 3" in capsys.readouterr().err


def test_reads_without_a_method_are_tracked_by_virtual_sensors(folder, tmp_path):
    path = tmp_path / "t.parquet"
    assert run(["track", str(folder / "a.mcap"), "--set", "reader_range=5", "-o", str(path), "-q"]) == ExitCode.DONE
    assert read_provenance(path).parameters["method"] == "virtual"
