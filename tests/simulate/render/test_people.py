import dataclasses

import numpy as np
import pytest

from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import InputError
from occlog.measure.regions.regions import histogram, similarity
from occlog.records.scene import Camera, Occluder, Scene
from occlog.records.tables import Truth, TruthBoxes
from occlog.simulate.config import RenderConfig
from occlog.simulate.render.people import reference_appearances, render, scene_metre

ROOM = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
PILLAR = np.array([[4.0, 2.0], [4.5, 2.0], [4.5, 2.5], [4.0, 2.5]])
QUIET = RenderConfig(noise=0.0, colour_noise=0.0, light_drift=0.0)

pytestmark = pytest.mark.jit


def camera(name="a", position=(0.2, 0.3, 1.4), yaw_deg=40.0, size=(96, 72), **values):
    settings = {"image_size": size} | values
    return Camera(
        name,
        np.array(position),
        rotation_from_angles(np.radians(yaw_deg), 0.0, 0.0),
        np.array([0.6 * size[0], 0.6 * size[0]]),
        np.array([0.5 * (size[0] - 1), 0.5 * (size[1] - 1)]),
        **settings,
    )


def scene(*cameras):
    return Scene(cameras=cameras or (camera(),), room=ROOM, occluders=(Occluder("pillar", PILLAR, 3.0),), room_height=3)


def truth_of(places, targets=1, step_ns=100_000_000):
    t, n = places.shape[:2]
    return Truth.of(
        t_ns=np.repeat(np.arange(t) * step_ns, n),
        target_id=np.tile(np.arange(n, dtype=np.int32), t),
        role=np.tile(["target"] * targets + ["occluder"] * (n - targets), t),
        x=places[..., 0].ravel(),
        y=places[..., 1].ravel(),
        z=np.full(t * n, np.nan),
    )


def still(*places, frames=1):
    return truth_of(np.tile(np.array(places, dtype=float), (frames, 1, 1)))


def walk(frames=8):
    s = np.linspace(0, 1, frames)[:, None]
    return truth_of(np.stack([[2.0, 2.5] + s * [1.0, 0.5], [3.4, 3.5] - s * [1.0, 0.5]], axis=1))


def frames_of(where, truth, config=QUIET, seed=1):
    return list(render(where, [truth], config, seed))


def test_frames_come_in_order_of_time_with_their_numbers():
    where = scene(camera("a"), camera("b", rate_hz=4.0))
    got = [(r.t_ns, r.sensor, r.index) for r in frames_of(where, walk(6))]
    a = [(k * 10**8, "a", k) for k in range(6)]
    b = [(k * 25 * 10**7, "b", k) for k in range(3)]
    assert got == sorted(a + b)


def test_neither_workers_nor_chunks_nor_other_cameras_change_a_frame():
    where, table = scene(camera("a"), camera("b", (7.8, 0.3, 1.4), 140.0, rate_hz=7.0)), walk(8)
    config = RenderConfig()
    one = frames_of(where, table, config)
    two = frames_of(where, table, dataclasses.replace(config, workers=2))
    cut = list(render(where, [table.take(slice(0, 6)), table.take(slice(6, None))], config, 1))
    alone = frames_of(scene(where.cameras[0]), table, config)
    assert len(one) == 8 + 5
    for other in (two, cut):
        assert all((x.image == y.image).all() for x, y in zip(one, other, strict=True))
        assert all((x.share == y.share).all() for x, y in zip(one, other, strict=True))
    assert all((x.image == y.image).all() for x, y in zip([r for r in one if r.sensor == "a"], alone, strict=True))
    assert (frames_of(where, table, config, seed=2)[0].image != one[0].image).any()


@pytest.mark.parametrize(("common", "single"), [(4.0, 0.0), (0.0, 4.0), (3.0, 2.0)])
def test_noise_has_the_stated_size_and_no_memory(common, single):
    """Variance, covariance of two colours and of two frames, each within 4 standard errors of 23 independent frames."""
    got = frames_of(
        scene(), still((3.0, 3.0), frames=24), dataclasses.replace(QUIET, noise=common, colour_noise=single)
    )
    images = np.stack([r.image for r in got]).astype(float)
    middle = (images > 25).all(axis=(0, 3)) & (images < 230).all(axis=(0, 3))
    values = images[:, middle] - images[:, middle].mean(axis=0)
    n = 23 * values.shape[1]
    variance = np.sum(values**2, axis=(0, 1)) / n
    want = common**2 + single**2 + 1 / 12  # rounding
    assert np.abs(variance - want).max() < 4 * want * np.sqrt(2 / n)
    between_colours = np.sum(values[..., 0] * values[..., 1]) / n
    assert abs(between_colours - common**2) < 4 * want / np.sqrt(n)
    between_frames = np.sum(values[:-1] * values[1:], axis=(0, 1)) / n
    assert np.abs(between_frames + want / 24).max() < 4 * want / np.sqrt(n)  # the mean was taken off
    beside = images[:, :, 1:, 0] - images[:, :, :-1, 0]
    beside = beside[:, middle[:, 1:] & middle[:, :-1]]
    beside -= beside.mean(axis=0)
    assert abs(beside.var() * 24 / 23 / (2 * want) - 1) < 0.03  # neighbours are independent


def test_light_drifts_by_the_stated_share_over_the_stated_period():
    config = dataclasses.replace(QUIET, light_drift=0.1, light_period_s=2.0)
    truth = still((3.0, 3.0), frames=41)  # 4 s: two periods
    images = np.stack([r.image for r in frames_of(scene(), truth, config)]).astype(float)
    usual = np.stack([r.image for r in frames_of(scene(), truth.take(slice(0, 2)))]).astype(float)[0]
    dark = (usual > 30) & (usual < 200)
    gain = images[:, dark].mean(axis=1) / usual[dark].mean()
    t = np.arange(41) * 0.1
    terms = np.column_stack([np.ones(41), np.sin(np.pi * t), np.cos(np.pi * t)])
    fit, residual, *_ = np.linalg.lstsq(terms, gain, rcond=None)
    assert np.hypot(fit[1], fit[2]) == pytest.approx(0.1, abs=0.003)
    assert fit[0] == pytest.approx(1.0, abs=0.003)
    assert np.sqrt(residual[0] / 41) < 0.003


def test_shadows_darken_the_floor_next_to_the_feet_only():
    where, place = scene(), (3.0, 3.0)
    with_shadow = frames_of(where, still(place))[0].image.astype(float)
    without = frames_of(where, still(place), dataclasses.replace(QUIET, shadows=False))[0].image.astype(float)
    ratio = with_shadow.sum(axis=2) / without.sum(axis=2)
    feet = where.cameras[0].project(np.array([[place[0], place[1], 0.0]]))[0]
    row, column = np.rint(feet).astype(int)[::-1]
    assert ratio[row - 2 : row + 3, column - 6 : column + 7].min() < 0.85
    assert ratio.max() <= 1.0 + 1e-9
    assert (ratio[:30] == 1.0).all()  # walls and ceiling


def test_boxes_are_whole_and_clipped_and_name_who_is_visible():
    cam = camera(size=(192, 144))
    hidden_behind_pillar = (7.5, 0.3 + (2.25 - 0.3) / (4.25 - 0.2) * 7.3)
    (r,) = frames_of(scene(cam), still((2.0, 1.8), (3.0, 2.75), hidden_behind_pillar, (0.1, 5.9)))
    assert r.boxes.target_id.tolist()[0] == 0
    assert 2 not in r.boxes.target_id
    assert 3 not in r.boxes.target_id
    assert r.share[0] == 1.0
    box = {int(k): i for i, k in enumerate(r.boxes.target_id)}
    if 1 in box:  # whole extent of the one behind, although partly hidden
        i = box[1]
        assert r.boxes.height_px[i] >= r.visible.height_px[i]
        assert r.share[i] < 1.0
    assert (r.boxes.left_px >= -0.5).all()
    assert (r.boxes.top_px + r.boxes.height_px <= 143.5).all()
    axis = cam.project(np.array([[2.0, 1.8, 0.9]]))[0]
    assert abs(r.boxes.left_px[0] + 0.5 * r.boxes.width_px[0] - axis[0]) < 0.2 * r.boxes.width_px[0]


def test_hidden_bodies_have_boxes_when_asked():
    cam = camera(size=(192, 144))
    behind_pillar = (7.5, 0.3 + (2.25 - 0.3) / (4.25 - 0.2) * 7.3)
    truth = still((2.0, 1.8), behind_pillar, (0.1, 5.9))
    (usual,) = frames_of(scene(cam), truth)
    (r,) = frames_of(scene(cam), truth, dataclasses.replace(QUIET, min_visibility=0.0))
    assert (r.image == usual.image).all()
    assert usual.boxes.target_id.tolist() == [0]
    assert r.boxes.target_id.tolist() == [0, 1]  # the third is outside the image
    assert r.boxes.visible.tolist() == r.share.tolist() == [1.0, 0.0]
    assert r.visible.target_id.tolist() == [0]
    pixel = cam.project(np.array([[*behind_pillar, 0.9]]))[0]
    assert 0 < pixel[0] - r.boxes.left_px[1] < r.boxes.width_px[1]
    assert 0 < pixel[1] - r.boxes.top_px[1] < r.boxes.height_px[1]


def test_targets_may_all_look_alike():
    cam, seed = camera(size=(320, 240)), 5
    config = dataclasses.replace(QUIET, identical_targets=True)
    truth = truth_of(np.array([[[2.2, 2.2], [3.4, 1.6]]]), targets=2)
    swapped = truth_of(np.array([[[3.4, 1.6], [2.2, 2.2]]]), targets=2)
    (one,), (other,) = (frames_of(scene(cam), t, config, seed) for t in (truth, swapped))
    # The gait differs; all else is the same
    assert (np.abs(one.image.astype(int) - other.image).max(axis=2) > 8).mean() < 0.01
    first, second = reference_appearances(scene(cam), [0, 1], config, seed)
    assert first["appearance"] == second["appearance"]


def test_a_frame_without_anybody_has_one_empty_row():
    (r,) = frames_of(scene(), still((0.1, 5.9)))
    assert r.boxes.box.tolist() == [-1]
    assert np.isnan(r.boxes.left_px).all()
    assert len(r.share) == 0
    assert isinstance(r.visible, TruthBoxes)


def test_targets_look_like_their_reference_and_others_do_not():
    cam, seed = camera(size=(320, 240)), 5
    truth = truth_of(np.array([[[2.2, 2.2], [3.4, 1.6], [4.0, 3.1], [2.2, 4.3]]]), targets=2)
    refs = reference_appearances(scene(cam), [0, 1], QUIET, seed)
    assert [r["target_id"] for r in refs] == [0, 1]
    models = np.array([r["appearance"] for r in refs])
    assert models.sum(axis=1) == pytest.approx(1.0)
    like = {}
    for lookalike in (False, True):
        (r,) = frames_of(scene(cam), truth, dataclasses.replace(QUIET, identical_clothes=lookalike), seed)
        for i, k in enumerate(r.visible.target_id):
            left, top, w, h = (
                int(np.rint(getattr(r.visible, c)[i] + 0.5 * (c[0] in "lt")))
                for c in ("left_px", "top_px", "width_px", "height_px")
            )
            cut = r.image[top : top + h, left + w // 4 : left + w - w // 4]
            like[lookalike, int(k)] = similarity(histogram(np.ascontiguousarray(cut))[None], models)[0]
    assert like[False, 0][0] > 0.75 > like[False, 0][1] + 0.1
    assert like[False, 1][1] > 0.75 > like[False, 1][0] + 0.1
    assert like[False, 2].max() < 0.6
    assert like[False, 3].max() < 0.6
    assert like[True, 2][0] > 0.7  # number 2 dresses like target 0, number 3 like target 1
    assert like[True, 3][1] > 0.7


@pytest.mark.parametrize(
    ("cam", "says"),
    [
        (camera(image_size=None), "camera a has no image size; give image_size_px"),
        (camera(position=(0.2, 0.3, 0.0)), "camera a is 0 above the floor, must be above 0; give position"),
    ],
)
def test_a_camera_that_cannot_be_rendered_is_reported(cam, says):
    with pytest.raises(InputError, match=says):
        frames_of(scene(cam), still((3.0, 3.0)))


@pytest.mark.parametrize("values", [{"noise": -1.0}, {"light_period_s": 0.0}, {"workers": 0}, {"light_drift": 1.0}])
def test_impossible_values_are_reported_by_render(values):
    with pytest.raises(InputError, match=f"render: {next(iter(values))} is"):
        RenderConfig(**values)


def test_a_scene_without_room_or_metres_can_be_rendered():
    open_air = Scene(cameras=(camera(), camera("b", (6.0, 5.0, 1.4), 220.0)))
    got = frames_of(open_air, still((3.0, 3.0)))
    assert len(got) == 2
    feet = dataclasses.replace(
        scene(camera(position=(0.2 / 0.3048, 0.3 / 0.3048, 1.4 / 0.3048))),
        room=ROOM / 0.3048,
        occluders=(Occluder("pillar", PILLAR / 0.3048, 3.0 / 0.3048),),
        room_height=3 / 0.3048,
        length_unit="ft",
    )
    a = frames_of(feet, still((3.0 / 0.3048, 3.0 / 0.3048)))[0]
    b = frames_of(scene(), still((3.0, 3.0)))[0]
    assert np.abs(a.image.astype(int) - b.image.astype(int)).mean() < 0.5
    assert a.boxes.width_px.tolist() == b.boxes.width_px.tolist()
    assert scene_metre(Scene(length_unit="unit"), 3.33) == pytest.approx(6.66)
