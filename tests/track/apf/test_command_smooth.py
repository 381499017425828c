"""`occlog track --smooth` and `--lag` on files: what changes, what stays, and which methods take them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import observe, room100, walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.tables import Bearings, Diagnostics, Tracks, Truth

pytestmark = pytest.mark.jit

SCENE = room100(pillar=False, unit="m")
STEPS = 15


def path(target: int):
    return walk(STEPS, np.random.default_rng([1, target]))


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(SCENE))
    made = [observe(SCENE, path(k), np.random.default_rng([2, k]), target=k) for k in (0, 3)]
    write_table(tmp_path / "bearings.parquet", Bearings.merge(made), Provenance("detect"))
    return tmp_path


def track(folder: Path, *args: str, output: str = "tracks.parquet") -> int:
    scene, name = str(folder / "scene.yaml"), str(folder / output)
    return run(["track", str(folder / "bearings.parquet"), "--scene", scene, "-o", name, "-q", *args])


def few(*args: str) -> tuple[str, ...]:
    return ("--particles", "200", "--seed", "5", "--overwrite", *args)


def test_smoothed_tracks_have_the_rows_of_filtered_ones_and_smaller_covariances(folder) -> None:
    tables = {}
    for name, args in {"filtered": (), "smooth": ("--smooth",), "lag": ("--lag", "3")}.items():
        assert track(folder, *few(*args), output=f"{name}.parquet") == ExitCode.DONE
        tables[name] = read_table(folder / f"{name}.parquet", Tracks)
    plain = tables["filtered"]
    for name in ("smooth", "lag"):
        np.testing.assert_array_equal(tables[name].t_ns, plain.t_ns)
        np.testing.assert_array_equal(tables[name].target_id, plain.target_id)
        early = plain.t_ns < np.unique(plain.t_ns)[-3]
        assert np.median(tables[name].cov_xx[early] / plain.cov_xx[early]) < 0.95
    parameters = read_provenance(folder / "lag.parquet").parameters
    assert (parameters["smooth"], parameters["lag_s"]) == (False, 3.0)
    assert read_provenance(folder / "smooth.parquet").parameters["smooth"] is True


def test_a_lag_over_the_record_gives_the_table_of_smoothing(folder) -> None:
    assert track(folder, *few("--smooth"), output="smooth.parquet") == ExitCode.DONE
    assert track(folder, *few("--lag", "100"), output="lag.parquet") == ExitCode.DONE
    smooth, lag = (read_table(folder / name, Tracks) for name in ("smooth.parquet", "lag.parquet"))
    for name in ("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy"):
        np.testing.assert_array_equal(getattr(smooth, name), getattr(lag, name))


def test_diagnostics_are_those_of_the_filter(folder) -> None:
    found = []
    for args in ((), ("--smooth",)):
        name = ("--diagnostics", str(folder / "d.parquet"))
        assert track(folder, *few(*args), *name) == ExitCode.DONE
        found.append(read_table(folder / "d.parquet", Diagnostics))
    np.testing.assert_array_equal(found[0].ess, found[1].ess)
    np.testing.assert_array_equal(found[0].log_likelihood, found[1].log_likelihood)


def test_the_same_seed_gives_the_same_bytes(folder) -> None:
    once, again = folder / "once.parquet", folder / "again.parquet"
    assert track(folder, *few("--smooth"), output=once.name) == ExitCode.DONE
    first = once.read_bytes()
    assert track(folder, *few("--smooth"), output=once.name) == ExitCode.DONE
    assert once.read_bytes() == first
    assert track(folder, *few("--smooth", "--seed", "6"), output=again.name) == ExitCode.DONE
    assert not np.array_equal(read_table(again, Tracks).x, read_table(once, Tracks).x)


@pytest.mark.parametrize("method", ["fix", "map", "idmot"])
def test_smooth_is_refused_by_methods_that_have_none(folder, capsys, method) -> None:
    scene = ("--scene", str(folder / "scene.yaml"), "-o", str(folder / "t.parquet"))
    code = run(["track", str(folder / "bearings.parquet"), *scene, "--method", method, "--smooth"])
    assert code == ExitCode.USAGE
    assert "--smooth is an option of --method apf" in capsys.readouterr().err
    assert not (folder / "t.parquet").exists()


@pytest.mark.parametrize("method", ["fix"])
def test_a_lag_is_refused_by_methods_that_do_not_look_back(folder, capsys, method) -> None:
    scene = ("--scene", str(folder / "scene.yaml"), "-o", str(folder / "t.parquet"))
    code = run(["track", str(folder / "bearings.parquet"), *scene, "--method", method, "--lag", "2"])
    assert code == ExitCode.USAGE
    assert "--lag is an option of --method" in capsys.readouterr().err


@pytest.mark.parametrize("lag", ["0", "-1", "nan", "inf", "soon"])
def test_a_lag_that_is_no_time_is_refused(folder, capsys, lag) -> None:
    assert track(folder, "--lag", lag) == ExitCode.USAGE
    assert "--lag" in capsys.readouterr().err


def test_fewer_than_two_trajectories_are_refused(folder, capsys) -> None:
    assert track(folder, *few("--smooth", "--set", "smoothing_trajectories=1")) == ExitCode.USAGE
    assert "trajectories=1: must be " in capsys.readouterr().err
    assert track(folder, *few("--smooth", "--set", "smoothing_trajectories=2")) == ExitCode.DONE


def test_evaluation_of_smoothed_tracks_has_the_bound_of_smoothing(folder, capsys) -> None:
    assert track(folder, *few("--smooth")) == ExitCode.DONE
    tracks = read_table(folder / "tracks.parquet", Tracks)
    xy = {k: path(k) for k in (0, 3)}
    positions = np.array(
        [xy[k][t // 1_000_000_000] for k, t in zip(tracks.target_id.tolist(), tracks.t_ns.tolist(), strict=True)]
    )
    nothing = np.zeros(len(tracks))
    role = np.full(len(tracks), "target")
    truth = Truth.of(
        t_ns=tracks.t_ns, target_id=tracks.target_id, role=role, x=positions[:, 0], y=positions[:, 1], z=nothing
    )
    write_table(folder / "truth.parquet", truth, Provenance("simulate"))
    files = ["--truth", "truth.parquet", "--bearings", "bearings.parquet", "--scene", "scene.yaml"]
    capsys.readouterr()
    given = [str(folder / part) if "." in part else part for part in files]
    assert run(["evaluate", str(folder / "tracks.parquet"), *given, "--json"]) == ExitCode.DONE
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["tracks_smoothed"] == 1.0
    assert metrics["smoothed_bound_ratio"] > metrics["bound_ratio"]
