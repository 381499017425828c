"""Tracks in the world from tracks in images: places, covariance, lenses, times, single views, cameras left out."""

from dataclasses import replace

import numpy as np
import pytest
from epipolar_rigs import looking
from view_scenes import TICK, view_tracks, walks

from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.records.tables import FusedTracks, Tracks
from occlog.track.methods.images.ground.config import GroundConfig, in_scene
from occlog.track.methods.images.ground.stage import ground_tracks

BROWN = np.array([-0.25, 0.06, 0.002, -0.001, 0.0])
PLACES = {"a": (7, 0, 2.5), "b": (0, 7, 2.5), "c": (-5, -5, 3)}
EXACT = GroundConfig(centre_error_share=0.0, identity_switch_rate=0.0)


def cameras(**more):
    return tuple(looking(name, np.array(p, dtype=float), (0, 0, 1), 500.0, **more) for name, p in PLACES.items())


def fused(chunks, scene, config=EXACT, only=()):
    parts = list(ground_tracks(chunks, scene, config, only))
    counts = parts[0].counts.copy()
    for part in parts[1:]:
        counts.update(part.counts)
    return FusedTracks.concat([part.tracks for part in parts]), counts


def errors(tracks, places):
    truth = places[(tracks.t_ns + TICK // 2) // TICK, tracks.target_id]
    return np.column_stack([tracks.x, tracks.y, tracks.z]) - truth


def nees(tracks, places):
    names = ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz")
    cov = np.stack([getattr(tracks, f"cov_{name}") for name in names], axis=1).reshape(-1, 3, 3)
    e = errors(tracks, places)
    return np.einsum("ni,nij,nj->n", e, np.linalg.inv(cov), e)


@pytest.mark.parametrize("lens", [np.zeros(5), BROWN])
def test_places_and_covariances_are_right_with_and_without_lens_distortion(lens):
    """1200 places of 3 degrees of freedom: the mean has a standard error of 0.07."""
    scene, positions = Scene(cameras=cameras(distortion=lens)), walks(600)
    tracks, counts = fused([view_tracks(scene.cameras, positions, np.random.default_rng(1))], scene)
    assert counts["times"] == len(tracks) + counts["inconsistent"] == 1200
    assert counts["inconsistent"] + counts["skipped"] < 8
    assert nees(tracks, positions).mean() == pytest.approx(3.0, abs=0.3)
    assert np.sqrt((errors(tracks, positions) ** 2).mean()) < 0.04
    assert np.isnan(tracks.vx).all()
    assert np.isnan(tracks.vz).all()


def test_where_chunks_are_cut_does_not_matter():
    scene, positions = Scene(cameras=cameras()), walks(20)
    rows = view_tracks(scene.cameras, positions, np.random.default_rng(2))
    whole, counts = fused([rows], scene)
    for size in (1, 5, 7):
        cut, again = fused([rows.take(slice(k, k + size)) for k in range(0, len(rows), size)], scene)
        assert all(
            np.array_equal(getattr(cut, c.name), getattr(whole, c.name), equal_nan=True)
            for c in Tracks.columns()
            if c.kind != "U"
        )
        assert again == counts


def test_frames_within_the_window_are_of_one_time():
    scene, positions = Scene(cameras=cameras()), walks(50)
    rows = view_tracks(scene.cameras, positions, np.random.default_rng(3), delay_ns=3_000_000)
    alone, counts = fused([rows], scene, replace(EXACT, target_height=0.0))
    assert len(alone) == 0
    assert counts["single_view"] == counts["times"] == 300
    tracks, counts = fused([rows], scene, replace(EXACT, window_s=0.010))
    assert (len(tracks), counts["views_3"]) == (100, 100)
    assert np.array_equal(np.unique(tracks.t_ns), np.arange(50) * TICK + 6_000_000)  # the time of the last view
    # A window of several frames does not put two frames of a view together.
    tracks, counts = fused([rows], scene, replace(EXACT, window_s=0.1))
    assert (len(tracks), counts["views_3"]) == (100, 100)


def test_one_view_needs_a_height():
    scene, positions = Scene(cameras=cameras()[:1]), walks(400)
    positions[:, :, 2] = np.random.default_rng(0).normal(0.9, 0.1, positions.shape[:2])
    rows = view_tracks(scene.cameras, positions, np.random.default_rng(4))
    tracks, counts = fused([rows], scene)
    assert counts["views_1"] == len(tracks) == 800
    assert nees(tracks, positions).mean() == pytest.approx(3.0, abs=0.4)
    assert np.allclose(tracks.z, 0.9)
    assert len(fused([rows], replace(scene, length_unit="px"))[0]) == 0
    assert in_scene(GroundConfig(), replace(scene, length_unit="ft")).target_height == pytest.approx(0.9 / 0.3048)
    other, _ = fused(
        [rows], replace(scene, length_unit="unit"), replace(EXACT, target_height=0.9, sigma_target_height=0.1)
    )
    assert np.array_equal(other.x, tracks.x)


def test_the_share_of_the_shape_widens_the_covariance_along_its_axes():
    """Ellipses of 40 px up and 12 px across, cameras nearly level: heights become the least sure."""
    scene, positions = Scene(cameras=cameras()), walks(10)
    rows = view_tracks(scene.cameras, positions, np.random.default_rng(5), sigma=0.5)
    none, some = (fused([rows], scene, replace(EXACT, centre_error_share=share))[0] for share in (0.0, 0.1))
    assert (none.cov_zz < none.cov_xx).all()
    assert (some.cov_zz > some.cov_xx).all()
    assert (some.cov_xx > 2 * none.cov_xx).all()


def test_a_view_on_another_target_is_left_out():
    scene, positions = Scene(cameras=cameras()), walks(100)
    rows = view_tracks(scene.cameras, positions, np.random.default_rng(6))
    x, y, swapped = rows.x_px.copy(), rows.y_px.copy(), rows.sensor == "b"
    for values in (x, y):
        values[swapped] = values[swapped].reshape(-1, 2)[:, ::-1].ravel()
    tracks, counts = fused([replace(rows, x_px=x, y_px=y)], scene)
    assert counts["skipped"] > 150
    assert np.median(np.linalg.norm(errors(tracks, positions), axis=1)) < 0.06


def test_last_rows_of_trackers_that_are_gone_are_not_used():
    scene, positions = Scene(cameras=cameras()[:2]), walks(3, 1)
    rows = view_tracks(scene.cameras, positions, np.random.default_rng(7))
    event = rows.lifecycle.astype("U10")
    event[-1] = "terminated"
    _, counts = fused([replace(rows, lifecycle=event)], scene, replace(EXACT, target_height=0.0))
    assert (counts["views_2"], counts["single_view"]) == (2, 1)


def test_cameras_without_a_pose_are_named():
    a, b, c = cameras()
    scene, positions = Scene(cameras=(a, replace(b, placed=False), c)), walks(3)
    rows = view_tracks((a, b, c), positions, np.random.default_rng(8))
    with pytest.raises(InputError, match="camera b has no pose"):
        fused([rows], scene)
    assert len(fused([rows], scene, only=("a", "c"))[0]) == 6
    with pytest.raises(InputError, match="no camera named 'b'; the scene has: a, c"):
        fused([rows], Scene(cameras=(a, c)))
    with pytest.raises(InputError, match="sort by t_ns"):
        fused([rows.take(slice(9, None)), rows.take(slice(0, 9))], Scene(cameras=(a, b, c)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("target_height", -1.0),
        ("target_height", float("nan")),
        ("sigma_target_height", 0.0),
        ("centre_error_share", -0.1),
        ("false_rejection_probability", 1.0),
        ("min_triangulation_angle_deg", 90.0),
        ("window_s", -1.0),
    ],
)
def test_settings_that_cannot_be_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        GroundConfig(**{name: value})


def test_doubts_and_views_stand_in_the_rows():
    """View b has target 0 where target 1 is; target 1 is lost by all views but c after half of the time."""
    scene, positions = Scene(cameras=cameras()), walks(50)
    rows = view_tracks(scene.cameras, positions, np.random.default_rng(9))
    x, y = rows.x_px.copy(), rows.y_px.copy()
    first, second = ((rows.sensor == "b") & (rows.target_id == k) for k in (0, 1))
    x[first], y[first] = x[second], y[second]
    late = (rows.t_ns >= 25 * TICK) & (rows.target_id == 1) & (rows.sensor != "c")
    tracks, _ = fused([replace(rows, x_px=x, y_px=y).take(~late)], scene, GroundConfig(centre_error_share=0.0))
    crossed = tracks.take(tracks.target_id == 0)
    assert np.mean(np.char.find(crossed.quality_flags, "inconsistent_views") >= 0) > 0.9
    assert np.mean(crossed.seen_by == "a,c") > 0.9
    assert crossed.quality_flags[-1] == "inconsistent_views,possible_switch"
    alone = tracks.take((tracks.target_id == 1) & (tracks.t_ns >= 25 * TICK))
    assert np.all(np.char.startswith(alone.quality_flags, "single_view"))
    assert np.all(alone.seen_by == "c")
