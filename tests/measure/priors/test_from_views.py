"""Views to hulls and Gaussians: frames, moments, targets, room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from occlog.errors import InputError
from occlog.measure.priors.config import HullConfig
from occlog.measure.priors.from_views import hull_priors
from occlog.records.scene import Camera, Scene, camera_rotation, scene_from
from occlog.records.tables import APPEARANCE_BINS, Bearings, Hulls, Occluders, Views

ROOM = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
PLACES = {"a": (0, 0, 39), "b": (10, 0, 141), "c": (10, 8, 219), "d": (0, 8, -39)}
TENTH = 100_000_000
CONFIG = replace(HullConfig.in_unit("m"), confirmation_time_s=0.0)


def scene(names="abcd", pitch_deg: float = 0.0) -> Scene:
    cameras = tuple(
        Camera(
            n,
            np.array([x, y, 1.2]),
            camera_rotation(np.radians(yaw), np.radians(pitch_deg), 0.0),
            np.array([450.0, 450.0]),
            np.array([320.0, 240.0]),
            (640, 480),
            fov=np.radians(71.0),
        )
        for n, (x, y, yaw) in PLACES.items()
        if n in names
    )
    return Scene(cameras=cameras, room=ROOM)


def views_of(made_scene: Scene, people, t_ns: int = 0, target: int | None = None, missing=()) -> Views:
    """Boxes around people, 0.5 m wide and 1.7 m high, as their silhouettes project."""
    rows = []
    for c in made_scene.cameras:
        for k, p in enumerate(people):
            if (c.name, k) in missing:
                continue
            aside = np.array([-(p[1] - c.ground[1]), p[0] - c.ground[0]])
            aside = 0.25 * aside / np.hypot(*aside)
            corners = [[*(np.array(p) + s * aside), z] for s in (-1, 1) for z in (0.0, 1.7)]
            px = c.project(np.array(corners))
            if np.isfinite(px).all() and 0 < px[:, 0].mean() < 640:
                low, high = px.min(axis=0), px.max(axis=0)
                rows.append((c.name, k, *low, *(high - low), -1 if k != target else 0))
    n = len(rows)
    nan = dict.fromkeys(("bearing", "sigma", "u_px", "sigma_px", "confidence", "similarity"), np.full(n, np.nan))
    one = dict.fromkeys(("cov_xx_px", "cov_yy_px", "area_px"), np.ones(n))
    box = dict(zip(("left_px", "top_px", "width_px", "height_px"), np.array([r[2:6] for r in rows]).T, strict=True))
    return Views.of(
        t_ns=np.full(n, t_ns),
        sensor=[r[0] for r in rows],
        frame=np.zeros(n, int),
        cluster=np.array([r[1] for r in rows], np.int32),
        x_px=np.zeros(n),
        y_px=np.zeros(n),
        cov_xy_px=np.zeros(n),
        target_id=np.array([r[6] for r in rows], np.int32),
        appearance=np.full((n, APPEARANCE_BINS), np.nan, np.float32),
        **nan,
        **one,
        **box,
    ).sorted()


def frames_of(made_scene: Scene, t_ns: int) -> Bearings:
    n = len(made_scene.cameras)
    nan = dict.fromkeys(("bearing", "sigma", "u_px", "sigma_px", "score"), np.full(n, np.nan))
    return Bearings.of(
        t_ns=np.full(n, t_ns),
        sensor=[c.name for c in made_scene.cameras],
        target_id=np.full(n, -1, np.int32),
        seen=np.zeros(n, bool),
        **nan,
    ).sorted()


def run(views, made_scene: Scene, config: HullConfig = CONFIG, frames=None) -> tuple[Hulls, Occluders]:
    parts = list(hull_priors(views, made_scene, config, frames))
    return Hulls.concat(p.hulls for p in parts), Occluders.concat(p.occluders for p in parts)


def shapes(hulls: Hulls) -> list[shapely.Polygon]:
    xy = np.column_stack([hulls.x, hulls.y])
    return [shapely.Polygon(xy[hulls.occluder_id == k]) for k in np.unique(hulls.occluder_id) if k >= 0]


PEOPLE = ((3.0, 4.0), (7.0, 5.0))


def test_people_are_in_their_polygons_and_gaussians_have_their_moments() -> None:
    hulls, gaussians = run([views_of(scene(), PEOPLE)], scene())
    found = shapes(hulls)
    assert len(found) == len(gaussians) == 2
    assert all(any(s.contains(shapely.Point(p)) for s in found) for p in PEOPLE)
    assert all(s.exterior.is_ccw for s in found)
    rng = np.random.default_rng(0)
    for s, x, y, xx, yy in zip(found, gaussians.x, gaussians.y, gaussians.cov_xx, gaussians.cov_yy, strict=True):
        low, high = np.array(s.bounds[:2]), np.array(s.bounds[2:])
        xy = low + (high - low) * rng.random((40_000, 2))
        xy = xy[shapely.contains_xy(s, xy)]
        error = 5 * xy.std(axis=0) / len(xy) ** 0.5
        assert np.all(np.abs(xy.mean(axis=0) - (x, y)) < error)
        assert xy.var(axis=0) == pytest.approx([xx, yy], rel=0.05)


def test_coordinates_of_maps_lose_no_one() -> None:
    origin, rng = np.array([500_000.0, 4_000_000.0]), np.random.default_rng(0)
    walks = rng.uniform([2.0, 2.0], [8.0, 6.0], (20, 3, 2))
    views = [views_of(scene(), people, t * TENTH) for t, people in enumerate(walks)]
    near, _ = run(views, scene())
    far, gaussians = run(views, scene_from(scene(), -origin))
    # The order of polygons at one time depends on the last digits
    for t in np.unique(near.t_ns):
        a, b = (np.column_stack([h.x, h.y])[h.t_ns == t] - shift for h, shift in ((far, origin), (near, np.zeros(2))))
        assert a.shape == b.shape
        assert np.abs(a[:, None] - b).max(axis=2).min(axis=1).max(initial=0.0) < 1e-6
    assert gaussians.y.min() > 3_999_999.0


@pytest.mark.parametrize("pitch", [-20.0, 0.0, 15.0])
def test_pitched_cameras(pitch: float) -> None:
    made_scene = scene(pitch_deg=pitch)
    found = shapes(run([views_of(made_scene, PEOPLE)], made_scene)[0])
    assert len(found) == 2
    assert all(any(s.contains(shapely.Point(p)) for s in found) for p in PEOPLE)


def test_target_is_left_out_and_hides_what_is_behind() -> None:
    place, behind = scene("abc"), (5.0, 4.0)
    target = (2.5, 2.0)  # in front of `behind` as seen from a
    people = (target, behind)
    views = views_of(place, people, target=0, missing={("a", 1)})
    found = shapes(run([views], place, replace(CONFIG, max_missed_views=0))[0])
    assert len(found) == 1
    assert found[0].contains(shapely.Point(behind))
    both = shapes(run([views], place, replace(CONFIG, max_missed_views=0, exclude_targets=False))[0])
    assert any(s.contains(shapely.Point(target)) for s in both)


def test_frames_without_anybody_count_only_if_stated() -> None:
    made_scene = scene()
    views = views_of(made_scene, PEOPLE[:1], missing={("d", 0)})
    strict = replace(CONFIG, max_missed_views=0)
    assert len(shapes(run([views], made_scene, strict)[0])) == 1  # d may not have had a frame
    hulls, gaussians = run([views], made_scene, strict, [frames_of(made_scene, 0)])
    assert hulls.occluder_id.tolist() == gaussians.occluder_id.tolist() == [-1]
    assert len(shapes(run([views], made_scene, CONFIG, [frames_of(made_scene, 0)])[0])) == 1  # one camera may miss him


def test_moments_without_clusters_are_rows() -> None:
    made_scene = scene()
    hulls, _ = run(
        [views_of(made_scene, PEOPLE)], made_scene, CONFIG, [frames_of(made_scene, t) for t in (0, TENTH, 9 * TENTH)]
    )
    assert np.unique(hulls.t_ns).tolist() == [0, TENTH, 9 * TENTH]
    assert hulls.occluder_id[hulls.t_ns == 9 * TENTH].tolist() == [-1]


def test_chunks_do_not_matter_and_identities_stay() -> None:
    made_scene = scene()
    table = Views.concat(views_of(made_scene, [(x + 0.1 * k, y) for x, y in PEOPLE], k * TENTH) for k in range(6))
    whole, _ = run([table], made_scene)
    cut, _ = run([table.take(slice(k, k + 3)) for k in range(0, len(table), 3)], made_scene)
    assert all(np.array_equal(getattr(whole, c.name), getattr(cut, c.name)) for c in Hulls.columns())
    assert len(np.unique(whole.occluder_id)) == 2


def test_window_gathers_cameras_that_are_not_in_step() -> None:
    made_scene = scene()
    whole = views_of(made_scene, PEOPLE)
    shift = np.array([1_000_000 * "abcd".index(s) for s in whole.sensor.tolist()])
    late = replace_times(whole, shift)
    assert shapes(run([late], made_scene)[0]) == []
    hulls, _ = run([late], made_scene, replace(CONFIG, window_s=0.01))
    assert len(shapes(hulls)) == 2
    assert np.unique(hulls.t_ns).tolist() == [3_000_000]


def replace_times(table: Views, t_ns) -> Views:
    return Views(**{c.name: getattr(table, c.name) for c in Views.columns()} | {"t_ns": t_ns}).sorted()


def test_bad_input_is_named() -> None:
    made_scene = scene()
    views = views_of(made_scene, PEOPLE)
    with pytest.raises(InputError, match="no camera 'd'"):
        run([views], scene("abc"))
    with pytest.raises(InputError, match="sort"):
        run([replace_times(views, np.full(len(views), 5)), views], made_scene)
    with pytest.raises(InputError, match="dilation is -1"):
        HullConfig(dilation=-1.0)
