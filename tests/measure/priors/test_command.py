"""`occlog priors` on files: every source, options, bad input, and as a stage of a run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.losses import Loss
from occlog.records.tables import APPEARANCE_BINS, Bearings, Hulls, Occluders, Tracks, Truth, Views

pytestmark = pytest.mark.jit

SCENE = """
occlog_scene: 1
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
cameras:
- {name: a, position: [0, 0], yaw_deg: 40, focal_px: 300, fov_deg: 100, noise: {measurement_noise_px: 2}}
- {name: b, position: [8, 0], yaw_deg: 140, focal_px: 300, fov_deg: 100, noise: {measurement_noise_px: 2}}
- {name: c, position: [4, 6], yaw_deg: 270, focal_px: 300, fov_deg: 140, noise: {measurement_noise_px: 2}}
microphone_arrays:
- {name: m0, position: [1, 1, 1]}
- {name: m1, position: [7, 1, 1]}
- {name: m2, position: [4, 5, 1]}
"""
PERSON = (4.0, 2.5)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("priors")
    (folder / "room.yaml").write_text(SCENE)
    made = ["simulate", str(folder / "room.yaml"), "-o", str(folder / "room.mcap"), "--steps", "20", "--occluders", "2"]
    assert run([*made, "--seed", "3", "-q"]) == ExitCode.DONE
    return folder / "room.mcap"


def views(steps: int = 5) -> Views:
    """What three cameras see of one person who stands still, in unplaced-bearing columns of a detector."""
    rows = []
    for k in range(steps):
        for name, (x, y, yaw) in {"a": (0, 0, 40), "b": (8, 0, 140), "c": (4, 6, 270)}.items():
            off = np.arctan2(PERSON[1] - y, PERSON[0] - x) - np.radians(yaw)
            rows.append((k * 100_000_000, name, -300 * np.tan(off)))
    n = len(rows)
    nan = dict.fromkeys(("bearing", "sigma", "u_px", "sigma_px", "confidence", "similarity"), np.full(n, np.nan))
    one = dict.fromkeys(("cov_xx_px", "cov_yy_px", "area_px"), np.ones(n))
    middle = np.array([principal() + r[2] for r in rows])
    return Views.of(
        t_ns=[r[0] for r in rows],
        sensor=[r[1] for r in rows],
        frame=np.zeros(n, int),
        cluster=np.zeros(n, np.int32),
        x_px=middle,
        y_px=np.zeros(n),
        cov_xy_px=np.zeros(n),
        left_px=middle - 15,
        top_px=np.full(n, 100.0),
        width_px=np.full(n, 30.0),
        height_px=np.full(n, 90.0),
        target_id=np.full(n, -1, np.int32),
        appearance=np.full((n, APPEARANCE_BINS), np.nan, np.float32),
        **nan,
        **one,
    ).sorted()


def principal() -> float:
    from occlog.io.formats.scenes.scene import scene_from_yaml

    return float(scene_from_yaml(SCENE, "room").cameras[0].principal_px[0])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "room.yaml").write_text(SCENE)
    write_table(tmp_path / "views.parquet", views(), Provenance("detect"))
    return tmp_path


def last_json(capsys) -> dict:
    return json.loads(capsys.readouterr().out)


def test_kalman_of_a_recording(recording, tmp_path, capsys) -> None:
    out = tmp_path / "o.parquet"
    args = ["priors", "kalman", str(recording), "-o", str(out), "--measurement-noise", "0.4", "--seed", "5", "--json"]
    assert run(args) == ExitCode.DONE
    summary = last_json(capsys)
    table = read_table(out, Occluders)
    assert summary["identities"] == 2
    assert summary["times"] == 20
    assert len(table) == 40
    made = read_provenance(out)
    assert (made.command, made.seed, made.parameters["measurement_noise"]) == ("priors", 5, 0.4)
    assert describe(out)["length_unit"] == "m"
    again = tmp_path / "again.parquet"
    assert run(["priors", "kalman", str(recording), "-o", str(again), "--measurement-noise", "0.4", "--seed", "5"]) == 0
    assert np.array_equal(read_table(again, Occluders).x, table.x)


def test_what_was_lost_of_the_bearings_is_lost_for_hulls_too(tmp_path, capsys) -> None:
    (tmp_path / "room.yaml").write_text(SCENE)
    seen, looked, out = tmp_path / "views.parquet", tmp_path / "bearings.parquet", tmp_path / "occluders.parquet"
    table, lost = views(), Loss("a.mp4", "frame 7", "cannot be decoded", 1)
    write_table(seen, table, Provenance("detect"))
    frames = {n: getattr(table, n) for n in ("t_ns", "sensor", "bearing", "sigma", "u_px", "sigma_px")}
    empty = {"target_id": np.full(len(table), -1, np.int32), "seen": np.zeros(len(table), bool)}
    write_table(looked, Bearings.of(**frames, **empty, score=frames["sigma"]), Provenance("detect", losses=(lost,)))
    args = ["--scene", str(tmp_path / "room.yaml"), "--bearings", str(looked), "-o", str(out)]
    assert run(["priors", "hull", str(seen), *args]) == ExitCode.DONE
    assert read_provenance(out).losses == (lost,)
    assert "a.mp4: frame 7" in capsys.readouterr().err


def test_kalman_of_measured_positions_and_tracks(tmp_path, capsys) -> None:
    n = 4
    t_ns, zero = np.arange(n) * 100_000_000, np.zeros(n)
    truth = Truth.of(t_ns=t_ns, target_id=np.ones(n, np.int32), role=["occluder"] * n, x=zero, y=zero, z=zero)
    write_table(tmp_path / "badges.parquet", truth, Provenance("ingest"))
    tracks = Tracks.of(
        t_ns=t_ns,
        target_id=np.ones(n, np.int32),
        x=zero,
        y=zero,
        vx=zero,
        vy=zero,
        cov_xx=zero + 1,
        cov_xy=zero,
        cov_yy=zero + 1,
    )
    write_table(tmp_path / "tracks.parquet", tracks, Provenance("track"))
    base = ["priors", "kalman", "--json", "--measured", "--overwrite", "-o", str(tmp_path / "o.parquet")]
    assert run([*base, str(tmp_path / "badges.parquet"), "--measurement-noise", "0.2"]) == 0
    assert not read_table(tmp_path / "o.parquet", Occluders).x.any()  # no noise was added
    assert run([*base, str(tmp_path / "tracks.parquet")]) == 0
    assert read_table(tmp_path / "o.parquet", Occluders).cov_xx[0] == 1.0
    capsys.readouterr()
    assert run([*base, str(tmp_path / "badges.parquet"), "--measurement-noise", "0"]) == ExitCode.USAGE
    assert "--measurement-noise above 0" in capsys.readouterr().err
    base.remove("--measured")
    assert run([*base, str(tmp_path / "tracks.parquet")]) == ExitCode.USAGE
    assert "add --measured" in capsys.readouterr().err


def test_hull_of_views(folder, capsys) -> None:
    outputs = ["-o", str(folder / "o.parquet"), "--hulls", str(folder / "h.parquet")]
    args = ["priors", "hull", str(folder / "views.parquet"), "--scene", str(folder / "room.yaml"), *outputs]
    assert run([*args, "--json"]) == ExitCode.DONE
    assert last_json(capsys)["identities"] == 1
    hulls, gaussians = read_table(folder / "h.parquet", Hulls), read_table(folder / "o.parquet", Occluders)
    sure = gaussians.take(gaussians.occluder_id >= 0)
    assert len(sure) == 3  # it must have persisted for 0.2 s
    assert np.hypot(sure.x - PERSON[0], sure.y - PERSON[1]).max() < 0.1
    assert np.unique(hulls.t_ns).tolist() == np.unique(gaussians.t_ns).tolist()
    assert run(args) == ExitCode.EXISTS
    assert run([*args, "--overwrite", "--without", "a,b"]) == ExitCode.USAGE
    assert "at least 2" in capsys.readouterr().err


@pytest.mark.drawn
def test_hulls_are_shown_in_the_report(folder) -> None:
    hulls = folder / "h.parquet"
    scene = str(folder / "room.yaml")
    assert (
        run(
            [
                "priors",
                "hull",
                str(folder / "views.parquet"),
                "--scene",
                scene,
                "-o",
                str(folder / "o.parquet"),
                "--hulls",
                str(hulls),
            ]
        )
        == 0
    )
    for name in ("h", "o"):
        page = folder / f"{name}.html"
        assert run(["report", "--scene", scene, "--occluders", str(folder / f"{name}.parquet"), "-o", str(page)]) == 0
        assert "of a moving occluder" in page.read_text()
    plain = folder / "plain.html"
    assert run(["report", "--scene", scene, "-o", str(plain)]) == 0
    assert "of a moving occluder" not in plain.read_text()


def test_acoustic_of_a_recording(recording, tmp_path, capsys) -> None:
    assert run(["priors", "acoustic", str(recording), "-o", str(tmp_path / "o.parquet"), "--json"]) == ExitCode.DONE
    assert last_json(capsys)["times"] == 20


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["kalman", "none.mcap"], ExitCode.BAD_INPUT, "none.mcap"),
        (["hull", "views.parquet"], ExitCode.USAGE, "--scene"),
        (["hull", "views.parquet", "--scene", "room.yaml", "--cameras", "x"], ExitCode.USAGE, "no camera 'x'"),
        (["hull", "room.yaml", "--scene", "room.yaml"], ExitCode.BAD_INPUT, "room.yaml"),
        (["kalman", "views.parquet"], ExitCode.BAD_INPUT, "views.parquet"),
        (["acoustic", "views.parquet", "--scene", "room.yaml"], ExitCode.BAD_INPUT, "views.parquet"),
        (["hull", "views.parquet", "--scene", "room.yaml", "--dilation", "nan"], None, "--dilation"),
    ],
)
def test_bad_input_is_one_line(folder, monkeypatch, capsys, args, code, message) -> None:
    monkeypatch.chdir(folder)
    got = run(["priors", *args, "-o", "o.parquet"])
    assert got == code or (code is None and got != 0)
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "Traceback" not in error
    assert len(error.splitlines()) == 1 or "Usage" in error
    assert not (folder / "o.parquet").exists()


RUN = """
occlog_run: 1
seed: 3
simulate: {scene: room.yaml, steps: 10, occluders: 2}
priors: {source: kalman, measurement_noise: 0.4}
track: {particles: 200}
"""


def test_stage_of_a_run(folder, capsys) -> None:
    (folder / "run.yaml").write_text(RUN)
    assert run(["run", str(folder / "run.yaml"), "-o", str(folder / "run"), "--json"]) == 0
    assert last_json(capsys)["stages"]["priors"] == "done"
    table = read_table(folder / "run" / "occluders.parquet", Occluders)
    assert len(table) == 20
    named = dict(read_provenance(folder / "run" / "tracks.parquet").inputs)
    assert "occluders.parquet" in named
    assert run(["run", str(folder / "run.yaml"), "-o", str(folder / "run"), "--json"]) == 0
    assert set(last_json(capsys)["stages"].values()) == {"up to date"}
    (folder / "run.yaml").write_text(RUN.replace("measurement_noise: 0.4", "measurement_noise: 0.5"))
    assert run(["run", str(folder / "run.yaml"), "-o", str(folder / "run"), "--json"]) == 0
    stages = last_json(capsys)["stages"]
    assert (stages["detect"], stages["priors"], stages["track"]) == ("up to date", "done", "done")


@pytest.mark.parametrize(
    ("change", "message"),
    [("source: kalman", "'magic'"), ("measurement_noise: 0.4", "sigmas")],
)
def test_bad_keys_of_the_stage_are_named(folder, capsys, change, message) -> None:
    new = "source: magic" if "source" in change else "sigmas: 0.4"
    (folder / "run.yaml").write_text(RUN.replace(change, new))
    assert run(["run", str(folder / "run.yaml"), "-o", str(folder / "run")]) == ExitCode.BAD_INPUT
    assert message in capsys.readouterr().err
