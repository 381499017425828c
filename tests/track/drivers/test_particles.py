"""Particles that are given out are those of the filters, thinned, and asking for them changes no track."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import observe, room100, walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Particles, Tracks
from occlog.track.drivers.rows import MAX_PARTICLES, downsample, particle_rows
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.interface import ParticleSet
from occlog.track.methods.apf.config import ApfConfig

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def cloud(n: int, seed: int = 1) -> ParticleSet:
    rng = np.random.default_rng(seed)
    weights = rng.random(n) ** 3
    return ParticleSet(rng.normal(size=(n, 2)), weights / weights.sum())


def test_a_cloud_that_is_small_enough_stays_as_it_is() -> None:
    kept = cloud(MAX_PARTICLES)
    assert downsample(kept) is kept
    assert len(downsample(cloud(MAX_PARTICLES + 1)).weights) == MAX_PARTICLES


@pytest.mark.parametrize("seed", range(5))
def test_a_larger_cloud_keeps_each_particle_by_its_weight(seed: int) -> None:
    whole = cloud(5000, seed)
    found = downsample(whole, 100)
    assert found.weights.sum() == pytest.approx(1.0, abs=1e-12)
    rows = [int(np.flatnonzero((whole.xy == xy).all(axis=1))[0]) for xy in found.xy]
    counts, expected = np.bincount(rows, minlength=5000), 100 * whole.weights
    assert (np.abs(counts - expected) < 1.0).all()


def test_rows_have_times_targets_and_numbers_of_their_own() -> None:
    two = [(5, 1, ParticleSet(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.25, 0.75])))]
    table = particle_rows([*two, (5, 2, ParticleSet(np.array([[5.0, 6.0]]), np.ones(1)))])
    assert table.t_ns.tolist() == [5, 5, 5]
    assert table.target_id.tolist() == [1, 1, 2]
    assert table.particle.tolist() == [0, 1, 0]
    assert table.x.tolist() == [1.0, 3.0, 5.0]
    assert table.y.tolist() == [2.0, 4.0, 6.0]
    assert table.weight.tolist() == [0.25, 0.75, 1.0]
    assert len(particle_rows([])) == 0


@pytest.mark.jit
@pytest.mark.parametrize("smooth", [False, True])
def test_the_mean_of_the_particles_is_the_estimate_of_the_filter(smooth: bool) -> None:
    scene = room100()
    rng = np.random.default_rng(5)
    bearings = observe(scene, walk(30, rng), rng)
    settings = ApfConfig(particles=MAX_PARTICLES)
    filtered = Tracks.concat([p.tracks for p in track([bearings], scene, TrackingTask(settings, 3))])
    config = ApfConfig(particles=MAX_PARTICLES, smooth=smooth)
    plain = list(track([bearings], scene, TrackingTask(config, 3)))
    parts = list(track([bearings], scene, TrackingTask(config, 3, particles=True)))
    assert all(p.particles is None or not len(p.particles) for p in plain)
    tracks, before = (Tracks.concat([p.tracks for p in each]) for each in (parts, plain))
    for name in ("t_ns", "target_id", "x", "y", "cov_xx"):
        np.testing.assert_array_equal(getattr(tracks, name), getattr(before, name))
    particles = Particles.concat([p.particles for p in parts if p.particles is not None])
    particles.check()
    assert len(particles) == MAX_PARTICLES * len(tracks)
    weights = particles.weight.reshape(-1, MAX_PARTICLES)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    for name in ("x", "y"):
        mean = (weights * getattr(particles, name).reshape(-1, MAX_PARTICLES)).sum(axis=1)
        np.testing.assert_allclose(mean, getattr(filtered, name), atol=1e-9)


@pytest.mark.jit
@pytest.mark.parametrize("method", ["apf", "direct3d"])
def test_the_command_writes_them(tmp_path: Path, method: str) -> None:
    recording, out, written = (str(tmp_path / name) for name in ("r.mcap", "t.parquet", "particles.parquet"))
    scene = str(EXAMPLES / ("room.yaml" if method == "apf" else "arrays.yaml"))
    assert run(["simulate", scene, "-o", recording, "--steps", "12", "--seed", "1", "-q"]) == ExitCode.DONE
    asked = [
        "track",
        recording,
        "-o",
        out,
        "--method",
        method,
        "--set",
        "particles=500",
        "--particle-cloud",
        written,
        "-q",
    ]
    assert run(asked) in (ExitCode.DONE, ExitCode.LOSSY)
    particles, tracks = read_table(Path(written), Particles), read_table(Path(out), Tracks)
    assert set(particles.t_ns.tolist()) == set(tracks.t_ns.tolist())
    assert np.bincount(np.searchsorted(np.unique(particles.t_ns), particles.t_ns)).max() <= MAX_PARTICLES
    middle = np.array([particles.x[particles.t_ns == t].mean() for t in tracks.t_ns.tolist()])
    deviation = np.sqrt(tracks.cov_xx + 1e-6)
    assert (np.abs(middle - tracks.x) < deviation).all()


def test_methods_without_particles_have_none_to_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = [
        "track",
        str(EXAMPLES / "room.yaml"),
        "-o",
        str(tmp_path / "t.parquet"),
        "--method",
        "fix",
        "--particle-cloud",
        str(tmp_path / "c"),
    ]
    assert run(asked) == ExitCode.USAGE
    assert "--particle-cloud" in capsys.readouterr().err
