"""Method `fix`: labelled rows, candidates by consensus, scans without a position."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.records.scene import Camera, MicrophoneArray, Scene, camera_rotation
from occlog.records.tables import UNLABELLED, Bearings
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.fix.config import FixConfig

CORNERS = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
NS = 1_000_000_000


def make_scene() -> Scene:
    """Three arrays and a camera on the corners of a square."""
    arrays = tuple(MicrophoneArray(f"mic{i}", np.array([*xy, 1.0])) for i, xy in enumerate(CORNERS[1:]))
    eye = Camera("cam", np.array([0.0, 0.0, 1.5]), camera_rotation(np.pi / 4, 0.0, 0.0), np.full(2, 500.0), np.zeros(2))
    return Scene(cameras=(eye,), arrays=arrays)


def direction(name: str, xy: np.ndarray) -> float:
    place = CORNERS[0] if name == "cam" else CORNERS[int(name[3:]) + 1]
    return float(np.arctan2(xy[1] - place[1], xy[0] - place[0]))


def table(rows: list[tuple[int, str, int, float]], sigma: float = 0.02) -> Bearings:
    """Bearings of (step, sensor, target, azimuth)."""
    rows = sorted(rows)
    n = len(rows)
    return Bearings.of(
        t_ns=np.array([r[0] for r in rows], dtype=np.int64) * NS,
        sensor=np.array([r[1] for r in rows]),
        target_id=np.array([r[2] for r in rows], dtype=np.int32),
        seen=np.ones(n, dtype=np.bool_),
        bearing=np.array([r[3] for r in rows]),
        sigma=np.full(n, sigma),
        u_px=np.full(n, np.nan),
        sigma_px=np.full(n, np.nan),
        score=np.full(n, np.nan),
    )


NAMES = ("cam", "mic0", "mic1", "mic2")


def test_cameras_and_arrays_give_positions_and_scans_without_one_give_no_row() -> None:
    rng = np.random.default_rng(0)
    rows, true = [], {}
    for step in range(40):
        true[step] = rng.uniform(2, 8, 2)
        heard = NAMES[:1] if step % 4 == 3 else NAMES
        rows += [(step, s, 5, direction(s, true[step]) + 0.02 * rng.standard_normal()) for s in heard]
    config = FixConfig(covariance="stated")
    (found,) = track([table(rows)], make_scene(), TrackingTask(config, 0, method="fix"))
    steps = (found.tracks.t_ns // NS).tolist()
    assert steps == [k for k in range(40) if k % 4 != 3]
    assert set(found.tracks.target_id.tolist()) == {5}
    error = np.column_stack([found.tracks.x, found.tracks.y]) - np.array([true[k] for k in steps])
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.2
    assert np.isnan(found.tracks.vx).all()
    assert set(found.diagnostics.n_detected.tolist()) == {4}
    assert found.diagnostics.n_available.tolist()[3] == 5  # with the scan of one camera before it
    cov = found.tracks
    nees = [
        e @ np.linalg.solve([[cov.cov_xx[i], cov.cov_xy[i]], [cov.cov_xy[i], cov.cov_yy[i]]], e)
        for i, e in enumerate(error)
    ]
    assert np.mean(nees) == pytest.approx(2.0, abs=3 * 2 / np.sqrt(len(nees)))


def test_consensus_of_candidates_finds_the_target_among_false_directions() -> None:
    """Four sensors with the target's direction, two false ones each, and none at all of one: 50 scans."""
    rng = np.random.default_rng(2)
    rows, true = [], {}
    for step in range(50):
        true[step] = rng.uniform(2, 8, 2)
        for s in NAMES:
            angles = rng.uniform(-np.pi, np.pi, 2).tolist()
            if s != "mic1":
                angles.append(direction(s, true[step]) + 0.01 * rng.standard_normal())
            rows += [(step, s, UNLABELLED, a) for a in angles]
    (found,) = track([table(rows, 0.01)], make_scene(), TrackingTask(FixConfig(), 0, method="fix"))
    assert len(found.tracks) == 50
    error = np.hypot(found.tracks.x - [true[k][0] for k in range(50)], found.tracks.y - [true[k][1] for k in range(50)])
    assert np.median(error) < 0.15
    assert (error < 0.5).mean() > 0.8  # now and then false directions agree better
    assert not list(track([table(rows)], make_scene(), TrackingTask(FixConfig(candidates="ignore"), 0, method="fix")))


def test_where_chunks_are_cut_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    rows = [
        (k, s, 1, direction(s, np.array([5.0, 4.0])) + 0.02 * rng.standard_normal()) for k in range(9) for s in NAMES
    ]
    whole = table(rows)
    parts = [whole.take(slice(a, b)) for a, b in ((0, 7), (7, 8), (8, 30), (30, 36))]
    config = FixConfig(estimator="huber")
    one = [t.tracks for t in track([whole], make_scene(), TrackingTask(config, 0, method="fix"))]
    more = [t.tracks for t in track(parts, make_scene(), TrackingTask(config, 9, method="fix"))]
    assert np.array_equal(one[0].x, more[0].x)


def test_two_bearings_are_distinguished_from_more() -> None:
    rows = [
        (k, s, 1, direction(s, np.array([5.0, 4.0]))) for k, n in ((0, 2), (1, 4)) for s in NAMES[1 - n // 4 : 4][:n]
    ]
    (found,) = track([table(rows)], make_scene(), TrackingTask(FixConfig(), 0, method="fix"))
    assert found.diagnostics.fallback.tolist() == ["two_lines", ""]


@pytest.mark.parametrize(
    ("name", "value"),
    [("estimator", "mean"), ("loss_threshold", 0.0), ("gate", -1.0), ("covariance", "no")],
)
def test_settings_that_cannot_be(name: str, value: object) -> None:
    with pytest.raises(InputError, match=f"fix: {name}"):
        FixConfig(**{name: value})
