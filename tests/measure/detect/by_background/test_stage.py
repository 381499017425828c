from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from detect_scenes import BLUE, RED, SIZE, STEP_NS, background, broken, camera, frames, picture, replaced, scene, walk

from occlog.core.geometry.camera import wrap_angle
from occlog.errors import InputError, UsageError
from occlog.measure.detect.by_background.one_camera import Target, check_targets
from occlog.measure.detect.by_background.stage import Learned, batches, detect
from occlog.measure.detect.config import BATCH, DetectConfig
from occlog.measure.detections import Detections
from occlog.measure.regions.regions import histogram
from occlog.records.columns import ColumnTable
from occlog.records.frames import Frame
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Views
from occlog.settings import SettingError

N = 12

pytestmark = pytest.mark.jit  # whole recordings


def learned(made_scene: Scene) -> Learned:
    return Learned(empty={c.name: background(c.name) for c in made_scene.cameras})


def lone_walker(n: int = N) -> tuple[Scene, list[Frame]]:
    made_scene = scene()
    path = walk(n)
    return made_scene, frames(made_scene, n, lambda k: [path[k]])


def run(
    made_scene: Scene,
    items: list[Frame],
    workers: int = 1,
    targets: Sequence[Target] = (),
    batch: int = BATCH,
    **options: object,
) -> Detections:
    config = DetectConfig(**options)  # type: ignore[arg-type]
    parts = list(detect(items, made_scene, config, workers, learned(made_scene), targets, batch=batch))
    return Detections(
        Views.concat(p.views for p in parts),
        Bearings.concat(p.bearings for p in parts),
        sum((p.losses for p in parts), ()),
        sum(p.frames for p in parts),
        sum(p.warmup for p in parts),
    )


def assert_same(a: ColumnTable, b: ColumnTable) -> None:
    for c in type(a).columns():
        np.testing.assert_array_equal(getattr(a, c.name), getattr(b, c.name))


@pytest.mark.parametrize("method", ["background", "components"])
@pytest.mark.parametrize("kind", ["mog2", "knn"])
def test_a_lone_walker_is_seen_where_it_is_by_every_camera(method: str, kind: str) -> None:
    made_scene, items = lone_walker()
    got = run(made_scene, items, method=method, background=kind)
    assert len(got.bearings) == 2 * N == got.frames
    assert got.bearings.seen.all()
    assert got.losses == ()
    for k, (x, y, _) in enumerate(walk(N)):
        for cam in made_scene.cameras:
            row = got.bearings.take((got.bearings.t_ns == k * STEP_NS) & (got.bearings.sensor == cam.name))
            error = wrap_angle(row.bearing - np.arctan2(y - cam.position[1], x - cam.position[0]))[0]
            assert abs(error) < row.sigma[0]
            assert abs(error) < 0.02
            np.testing.assert_allclose(row.u_px, cam.u_px(row.bearing))
    assert np.isnan(got.bearings.score).all()
    assert (got.views.target_id == 0).all()


def test_every_frame_without_the_target_says_so() -> None:
    made_scene = scene()
    path = walk(N)
    items = frames(made_scene, N, lambda k: [path[k]] if k < 6 else [])
    got = run(made_scene, items).bearings
    np.testing.assert_array_equal(got.seen, got.t_ns < 6 * STEP_NS)
    assert np.isnan(got.bearing[~got.seen]).all()


def test_the_target_is_distinguished_from_others_by_its_colour_and_all_are_kept_as_views() -> None:
    made_scene = scene()
    items = frames(made_scene, N, lambda k: [walk(N)[k], (7.0, 3.6 - 0.02 * k, BLUE)])
    targets = []
    for name, colour in ((3, BLUE), (1, RED)):
        patch = np.full((8, 8, 3), colour, dtype=np.uint8)
        targets.append(Target(name, histogram(patch)[None]))
    got = run(made_scene, items, targets=tuple(targets), min_similarity=0.5)
    assert len(got.bearings) == 2 * 2 * N
    assert len(got.views) == 2 * 2 * N
    assert got.bearings.score[got.bearings.seen].min() > 0.5
    for name, place_of in ((1, lambda k: walk(N)[k][:2]), (3, lambda k: (7.0, 3.6 - 0.02 * k))):
        mine = got.bearings.take((got.bearings.target_id == name) & got.bearings.seen)
        assert len(mine) == 2 * N
        for row in range(len(mine)):
            x, y = place_of(int(mine.t_ns[row] // STEP_NS))
            cam = made_scene.camera(str(mine.sensor[row]))
            error = wrap_angle(mine.bearing[row : row + 1] - np.arctan2(y - cam.position[1], x - cam.position[0]))[0]
            assert abs(error) < 3 * mine.sigma[row]
    # Views name the target that they were stated to be, and give its likeness.
    reported = got.views.take(got.views.target_id >= 0)
    assert len(reported) == np.count_nonzero(got.bearings.seen)
    assert reported.similarity.min() > 0.5


def test_no_one_like_the_target_is_looked_and_not_seen() -> None:
    made_scene, items = lone_walker()
    green = Target(7, histogram(np.full((4, 4, 3), (20, 220, 20), dtype=np.uint8))[None])
    got = run(made_scene, items, targets=(green,))
    assert not got.bearings.seen.any()
    assert set(got.bearings.target_id.tolist()) == {7}
    assert (got.views.target_id == -1).all()


@pytest.mark.parametrize(("kind", "splits"), [("mog2", [(2, 32), (5, 1)]), ("knn", [(3, 4)])])
def test_the_result_does_not_depend_on_workers_or_batches(kind: str, splits: list[tuple[int, int]]) -> None:
    made_scene = scene(camera("a", 0.0, 0.0, 45.0), camera("b", 8.0, 0.0, 135.0), camera("c", 8.0, 8.0, 225.0))
    items = frames(made_scene, N, lambda k: [walk(N)[k], (5.0, 6.0, BLUE)] if k else [])
    want = run(made_scene, items, 1, background=kind)
    for workers, batch in splits:
        got = run(made_scene, items, workers, background=kind, batch=batch)
        assert_same(got.views, want.views)
        assert_same(got.bearings, want.bearings)


def test_only_a_few_frames_are_read_ahead() -> None:
    made_scene, items = lone_walker(40)
    read = 0

    def counted() -> object:
        nonlocal read
        for item in items:
            read += 1
            yield item

    stream = detect(counted(), made_scene, DetectConfig(), 2, learned(made_scene), batch=8)  # type: ignore[arg-type]
    next(stream)
    assert read <= 4 * 8 + 1
    stream.close()


def test_batches_never_split_a_time() -> None:
    _, items = lone_walker(7)
    got = list(batches(items, 3))
    assert [len(b) for b in got] == [4, 4, 4, 2]
    assert [f for b in got for f in b] == items


def test_frames_that_go_back_in_time_are_refused() -> None:
    _, items = lone_walker(3)
    with pytest.raises(InputError, match=r"frame 0: time 0 s is before 0.2 s"):
        list(batches([items[-1], items[0]], 8))


def test_without_the_empty_scene_the_first_frames_give_no_rows() -> None:
    made_scene, items = lone_walker()
    parts = list(detect(items, made_scene, DetectConfig(warmup=5)))
    got = Bearings.concat(p.bearings for p in parts)
    assert sum(p.warmup for p in parts) == 2 * 5
    assert got.t_ns.min() == 5 * STEP_NS
    assert len(got) == 2 * (N - 5)


def test_a_frame_of_another_size_is_lost_and_the_next_ones_are_used() -> None:
    made_scene, items = lone_walker()
    items = replaced(items, "a", 4, lambda: np.zeros((60, 80, 3), dtype=np.uint8))
    items = replaced(items, "a", 5, lambda: np.zeros((60, 80, 3), dtype=np.uint8))
    got = run(made_scene, items)
    assert [str(loss) for loss in got.losses] == [
        "a: frames 4 to 5: image is 80 x 60 px in colour, the camera's first was 160 x 120 px in colour (2 lost)"
    ]
    mine = got.bearings.take(got.bearings.sensor == "a")
    assert sorted(set(range(N)) - set((mine.t_ns // STEP_NS).tolist())) == [4, 5]
    assert mine.seen.all()


def test_frames_that_cannot_be_decoded_are_lost_one_stretch_a_line() -> None:
    made_scene, items = lone_walker()
    for index in (0, 1, 7):
        items = replaced(items, "a", index, broken)
    got = run(made_scene, items)
    assert [(loss.place, loss.count) for loss in got.losses] == [("frames 0 to 1", 2), ("frame 7", 1)]
    assert all(loss.source == "a" for loss in got.losses)
    assert got.losses[0].what == "the image cannot be decoded (12 bytes)"
    assert got.frames == 2 * N - 3


def test_a_flood_of_light_is_lost_not_called_empty() -> None:
    made_scene, items = lone_walker()
    items = replaced(items, "b", 6, lambda: np.full((SIZE[1], SIZE[0], 3), 255, dtype=np.uint8))
    got = run(made_scene, items)
    assert [(loss.source, loss.place) for loss in got.losses] == [("b", "frame 6")]
    assert "foreground covers more than 60%" in got.losses[0].what
    assert not np.any((got.bearings.sensor == "b") & (got.bearings.t_ns == 6 * STEP_NS))


def test_16_bit_images_need_their_number_of_bits() -> None:
    made_scene = scene(camera("a", 0.0, 0.0, 45.0))
    deep = [
        Frame(f.t_ns, f.sensor, f.index, lambda f=f: f.decode().astype(np.uint16) << 4)
        for f in frames(made_scene, N, lambda k: [walk(N)[k]])
    ]
    refused = run(made_scene, deep)
    assert refused.frames == 0
    assert "bit-depth" in refused.losses[0].what
    got = run(made_scene, deep, bit_depth=12)
    plain = run(made_scene, frames(made_scene, N, lambda k: [walk(N)[k]]))
    assert_same(got.bearings, plain.bearings)


@pytest.mark.parametrize("channels", [1, 4])
def test_grey_and_alpha_images_work(channels: int) -> None:
    made_scene = scene(camera("a", 0.0, 0.0, 45.0))

    def shot(k: int) -> np.ndarray:
        image = picture(made_scene.cameras[0], [walk(N)[k]], k)
        if channels == 4:
            return np.concatenate([image, np.full_like(image[:, :, :1], 255)], axis=2)
        return image[:, :, :1]

    items = [Frame(k * STEP_NS, "a", k, lambda k=k: shot(k)) for k in range(N)]
    empty = background("a") if channels == 4 else background("a")[:, :, 0].copy()
    parts = list(detect(items, made_scene, DetectConfig(shadows=False), 1, Learned(empty={"a": empty})))
    assert Bearings.concat(p.bearings for p in parts).seen.all()


def test_a_camera_without_pose_gives_views_but_no_bearings() -> None:
    cam = camera("a", 0.0, 0.0, 45.0)
    made_scene = scene(cam)
    items = frames(made_scene, N, lambda k: [walk(N)[k]])
    lost = scene(replace(cam, placed=False))
    got = run(lost, items, person_height_px=45.0)
    assert len(got.bearings) == 0
    assert len(got.views) == N
    assert np.isnan(got.views.bearing).all()
    assert (got.views.target_id == 0).all()
    with pytest.raises(InputError, match="person-height-px"):
        run(lost, items)


def test_images_for_another_calibration_are_refused() -> None:
    made_scene = scene(camera("a", 0.0, 0.0, 45.0, image_size=(320, 240)))
    items = frames(made_scene, 2, lambda _: [])
    with pytest.raises(InputError, match="camera a: frames are 160 x 120 px but the scene states 320 x 240"):
        run(made_scene, items)


def test_a_camera_that_the_scene_does_not_have_is_refused() -> None:
    made_scene, items = lone_walker(2)
    with pytest.raises(InputError, match="no camera named 'z'"):
        run(made_scene, [replace(items[0], sensor="z")])


def test_large_images_are_shrunk_without_moving_the_bearings() -> None:
    cam = camera("a", 0.0, 0.0, 45.0)
    made_scene = scene(cam)
    got = run(made_scene, frames(made_scene, N, lambda k: [walk(N)[k]]))

    def doubled(image: np.ndarray) -> np.ndarray:
        return np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)

    big = camera(
        "a",
        0.0,
        0.0,
        45.0,
        image_size=(320, 240),
        focal_px=np.array([220.0, 220.0]),
        principal_px=np.array([159.5, 119.5]),
        sigma_read_px=4.0,
    )
    items = [
        Frame(f.t_ns, f.sensor, f.index, lambda f=f: doubled(f.decode()))
        for f in frames(made_scene, N, lambda k: [walk(N)[k]])
    ]
    parts = list(detect(items, scene(big), DetectConfig(downscale=2), 1, learned(made_scene)))
    large = Bearings.concat(p.bearings for p in parts)
    np.testing.assert_allclose(large.bearing, got.bearings.bearing, atol=1e-9)
    np.testing.assert_allclose(large.sigma, got.bearings.sigma, rtol=1e-4)
    views = Views.concat(p.views for p in parts)
    np.testing.assert_allclose(views.width_px, 2 * got.views.width_px)
    np.testing.assert_allclose(views.area_px, 4 * got.views.area_px)


@pytest.mark.parametrize(
    "wrong",
    [
        {"method": "yolo"},
        {"background": "gmg"},
        {"history": 0},
        {"min_similarity": 1.5},
        {"bit_depth": 4},
        {"warmup": -1},
        {"person_height": float("nan")},
        {"downscale": 0},
    ],
)
def test_impossible_options_are_refused_by_name(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingError, match=next(iter(wrong))):
        DetectConfig(**wrong)  # type: ignore[arg-type]


def test_an_appearance_must_be_a_histogram() -> None:
    for bad in (np.ones((1, 72)), np.ones((1, 3)) / 3, np.ones(72) / 72, np.full((1, 72), np.nan)):
        with pytest.raises(InputError, match="target 4: each appearance must be 72 numbers"):
            Target(4, bad)
    with pytest.raises(UsageError, match="two targets have the same number"):
        check_targets([Target(1, np.ones((1, 72)) / 72), Target(1, np.ones((1, 72)) / 72)])
