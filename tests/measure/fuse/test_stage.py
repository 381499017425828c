"""Fusion of detections on hand-made times: what is kept, recovered and removed, and where."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from occlog.core.geometry.camera import wrap_angle
from occlog.errors import InputError
from occlog.measure.detections import Detections
from occlog.measure.fuse.config import FuseConfig
from occlog.measure.fuse.rows import in_step
from occlog.measure.fuse.stage import FusedPart, fuse
from occlog.records.scene import Camera, Occluder, Scene, camera_rotation
from occlog.records.tables import Bearings, Views
from occlog.settings import SettingError

STEP = 100_000_000  # ns
SIGMA = 0.01
CORNERS = (("a", 0.0, 0.0, 45.0), ("b", 10.0, 0.0, 135.0), ("c", 10.0, 10.0, 225.0), ("d", 0.0, 10.0, 315.0))
WRONG = 0.5  # rad by which a false bearing is off


def camera(name: str, x: float, y: float, yaw_deg: float, **more: object) -> Camera:
    rotation = camera_rotation(np.radians(yaw_deg), 0.0, 0.0)
    focal, principal = np.array([500.0, 500.0]), np.array([499.5, 299.5])
    values: dict[str, object] = {"image_size": (1000, 600), "fov": np.radians(90.0)}
    return Camera(name, np.array([x, y, 1.2]), rotation, focal, principal, **(values | more))  # type: ignore[arg-type]


def scene(n: int = 4, **more: object) -> Scene:
    room = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    return Scene(cameras=tuple(camera(*c) for c in CORNERS[:n]), room=room, **more)  # type: ignore[arg-type]


Row = tuple[int, str, int, float | None]  # step, camera, target, bearing or None


def table(rows: Sequence[Row], where: Scene) -> Bearings:
    focal = {c.name: c for c in where.cameras}
    beta = np.array([np.nan if r[3] is None else r[3] for r in rows])
    seen = np.isfinite(beta)
    u = np.array([float(focal[r[1]].u_px(np.array([b]))[0]) for r, b in zip(rows, beta, strict=True)])
    return Bearings.of(
        t_ns=np.array([STEP * r[0] for r in rows]),
        sensor=np.array([r[1] for r in rows]),
        target_id=np.array([r[2] for r in rows], dtype=np.int32),
        seen=seen,
        bearing=beta,
        sigma=np.where(seen, SIGMA, np.nan),
        u_px=np.where(seen, u, np.nan),
        sigma_px=np.where(seen, 5.0, np.nan),
        score=np.full(len(rows), np.nan),
    ).sorted()


def to(where: Scene, name: str, xy: Sequence[float], off: float = 0.0) -> float:
    away = np.asarray(xy) - where.camera(name).ground
    return float(wrap_angle(np.arctan2(away[1], away[0]) + off))


def observation(
    step: int, where: Scene, xy: Sequence[float], target: int = 0, missed: str = "", wrong: str = ""
) -> list[Row]:
    """All cameras at a target; those in `missed` see nothing, those in `wrong` something else."""
    names = [c.name for c in where.cameras]
    return [(step, n, target, None if n in missed else to(where, n, xy, WRONG if n in wrong else 0.0)) for n in names]


def run(bearings: Bearings, where: Scene, config: FuseConfig | None = None, cut: int = 10**9) -> list[FusedPart]:
    def parts() -> Iterator[Detections]:
        for first in range(0, len(bearings), cut):
            yield Detections(Views.empty(), bearings.take(slice(first, first + cut)), (), 0, 0)

    return list(fuse(parts(), where, config))


def fused(bearings: Bearings, where: Scene, config: FuseConfig | None = None, cut: int = 10**9) -> Bearings:
    return Bearings.concat([f.bearings for f in run(bearings, where, config, cut)])


def of_step(bearings: Bearings, step: int) -> dict[str, tuple[bool, str]]:
    rows = bearings.take(bearings.t_ns == STEP * step)
    return {n: (bool(s), str(c)) for n, s, c in zip(rows.sensor, rows.seen, rows.cause, strict=True)}


PLACE = (4.0, 5.0)
FAR = (8.0, 5.0)
HIT, BACK, GONE = (True, "kept"), (True, "recovered"), (False, "removed")
NOTHING = (False, "")


def test_detections_that_agree_are_kept_as_they_are():
    where = scene()
    before = table(observation(0, where, PLACE), where)
    after = fused(before, where)
    assert set(of_step(after, 0).values()) == {HIT}
    assert np.array_equal(after.bearing, before.bearing)
    assert np.array_equal(after.sigma_px, before.sigma_px)


def test_a_missed_detection_is_recovered_at_the_place_of_the_others():
    where = scene()
    after = fused(table(observation(0, where, PLACE, missed="b"), where), where)
    assert of_step(after, 0) == {"a": HIT, "b": BACK, "c": HIT, "d": HIT}
    row = int(np.flatnonzero(after.cause == "recovered")[0])
    assert after.bearing[row] == pytest.approx(to(where, "b", PLACE), abs=1e-9)
    u = where.camera("b").u_px(after.bearing[row : row + 1])
    assert after.u_px[row] == pytest.approx(u[0], abs=1e-9)
    # Three lines with sigma: the place is known across b's line to about sigma * 6 / sqrt(2); b is 8.5 away.
    assert 0.4 * SIGMA < after.sigma[row] < 1.2 * SIGMA
    assert np.isnan(after.score[row])


def test_a_false_detection_of_one_camera_is_replaced_and_not_propagated():
    where = scene()
    after = fused(table(observation(0, where, PLACE, wrong="b"), where), where)
    assert of_step(after, 0) == {"a": HIT, "b": BACK, "c": HIT, "d": HIT}
    row = int(np.flatnonzero(after.sensor == "b")[0])
    assert after.bearing[row] == pytest.approx(to(where, "b", PLACE), abs=1e-9)


def test_a_lone_false_detection_is_removed_with_and_without_a_prediction():
    where = scene()
    before = table(
        [
            *observation(0, where, PLACE, missed="acd", wrong="b"),
            *observation(2, where, PLACE),
            *observation(3, where, PLACE, missed="acd", wrong="b"),
        ],
        where,
    )
    after = fused(before, where)
    for step in (0, 3):
        assert of_step(after, step) == {"a": NOTHING, "b": GONE, "c": NOTHING, "d": NOTHING}
    gone = after.take(after.cause == "removed")
    for name in ("bearing", "sigma", "u_px", "sigma_px"):
        assert np.isnan(getattr(gone, name)).all()


def test_one_camera_near_the_prediction_brings_all_others_back():
    # [Lee]: quality and prior of a detection near the prediction outvote three misses.
    where = scene()
    before = table(
        [*observation(0, where, PLACE), *observation(1, where, PLACE), *observation(2, where, PLACE, missed="acd")],
        where,
    )
    assert of_step(fused(before, where), 2) == {"a": BACK, "b": HIT, "c": BACK, "d": BACK}


def test_two_false_detections_that_meet_far_from_the_prediction_are_removed():
    # Case 3 of [Lee] Sec. 4.4.2: without the prior they would be declared.
    where = scene(3)
    rows = [*observation(0, where, PLACE), *observation(1, where, PLACE), *observation(2, where, FAR, missed="c")]
    assert of_step(fused(table(rows, where), where), 2) == {"a": GONE, "b": GONE, "c": NOTHING}
    alone = fused(table(observation(2, where, FAR, missed="c"), where), where)
    assert of_step(alone, 2) == {"a": HIT, "b": HIT, "c": BACK}


@pytest.mark.parametrize(("met", "held"), [(3, 3), (1, 0)])
def test_a_prediction_is_dropped_after_some_times_without_a_declaration_and_a_new_one_at_once(met: int, held: int):
    where = scene(3)
    rows = [row for step in range(met) for row in observation(step, where, PLACE)]
    rows += [row for step in range(met, met + 5) for row in observation(step, where, FAR, missed="c")]
    after = fused(table(rows, where), where, replace(FuseConfig.in_unit("m"), max_coasting_steps=3))
    declared = [of_step(after, step)["c"] == BACK for step in range(met, met + 5)]
    assert declared == [False] * held + [True] * (5 - held)


def test_cameras_that_face_each_other_support_each_other_without_a_place():
    where = scene()
    after = fused(
        table(observation(0, where, (4.0, 6.0), missed="ac"), where),
        where,
        replace(FuseConfig.in_unit("m"), false_alarm_probability=0.05),
    )
    assert of_step(after, 0) == {"a": NOTHING, "b": HIT, "c": NOTHING, "d": HIT}


def test_nothing_seen_stays_nothing():
    where = scene()
    rows = [*observation(0, where, PLACE), *observation(1, where, PLACE, missed="abcd")]
    parts = run(table(rows, where), where)
    after = Bearings.concat([f.bearings for f in parts])
    assert set(of_step(after, 1).values()) == {NOTHING}
    assert sum(f.absent for f in parts) == 0


def test_nothing_is_recovered_where_a_camera_cannot_see():
    wall = Occluder("pillar", np.array([[2.0, 7.0], [3.0, 7.0], [3.0, 8.0], [2.0, 8.0]]))
    where = scene(4, occluders=(wall,))
    after = fused(table(observation(0, where, PLACE, missed="d"), where), where)
    assert of_step(after, 0) == {"a": HIT, "b": HIT, "c": HIT, "d": NOTHING}
    short = replace(scene(), cameras=(*scene().cameras[:3], camera(*CORNERS[3], range=3.0)))
    assert of_step(fused(table(observation(0, short, PLACE, missed="d"), short), short), 0)["d"] == NOTHING


def test_a_false_detection_of_a_camera_that_cannot_see_the_place_is_removed():
    where = replace(scene(), cameras=(*scene().cameras[:3], camera(*CORNERS[3], range=3.0)))
    after = fused(table(observation(0, where, PLACE, wrong="d"), where), where)
    assert of_step(after, 0) == {"a": HIT, "b": HIT, "c": HIT, "d": GONE}


def test_cameras_that_share_no_place_keep_what_they_see():
    away = scene()
    two = Scene(cameras=(camera("a", 0.0, 0.0, 180.0), camera("b", 10.0, 0.0, 0.0)))
    rows: list[Row] = [(0, "a", 0, np.pi - 0.1), (0, "b", 0, None), (1, "a", 0, None), (1, "b", 0, 0.1)]
    after = fused(table(rows, two), two)
    assert of_step(after, 0) == {"a": HIT, "b": NOTHING}
    assert of_step(after, 1) == {"a": NOTHING, "b": HIT}
    # A camera without a frame at that time has no part in it either.
    lone = fused(table(observation(0, away, PLACE)[:1], away), away)
    assert of_step(lone, 0) == {"a": HIT}


def test_identities_are_fused_apart():
    where = scene()
    other = (7.0, 2.0)
    rows = [*observation(0, where, PLACE, 3, missed="a"), *observation(0, where, other, 5, missed="c")]
    after = fused(table(rows, where), where)
    for target, xy, back in ((3, PLACE, "a"), (5, other, "c")):
        own = after.take(after.target_id == target)
        assert [n for n, c in zip(own.sensor, own.cause, strict=True) if c == "recovered"] == list(back)
        expected = [to(where, n, xy) for n in own.sensor.tolist()]
        assert own.bearing == pytest.approx(expected, abs=1e-9)


def test_a_frame_that_says_nothing_of_a_target_is_a_look_at_it():
    where = scene()
    rows = [*observation(0, where, PLACE, 3)[1:], (0, "a", 5, None)]
    after = fused(table(rows, where), where)
    own = after.take((after.sensor == "a") & (after.target_id == 3))
    assert (len(own), own.cause[0]) == (1, "recovered")


def candidates(step: int, where: Scene, positions: Sequence[Sequence[float]], extra: Sequence[Row] = ()) -> list[Row]:
    rows = [(step, c.name, -1, to(where, c.name, xy)) for xy in positions for c in where.cameras]
    return [*rows, *extra]


def test_candidates_are_grouped_and_the_others_removed():
    where = scene()
    places = (PLACE, (7.0, 2.0))
    rows = [r for r in candidates(0, where, places) if r[1] != "a"]  # a reports one of the two, and something false
    rows += [(0, "a", -1, to(where, "a", PLACE)), (0, "a", -1, to(where, "a", PLACE, -WRONG))]
    after = fused(table(rows, where), where)
    assert np.all(after.target_id == -1)
    own = after.take(after.sensor == "a")
    assert sorted(own.cause) == ["kept", "recovered"]
    assert own.seen.all()
    assert sorted(own.bearing) == pytest.approx(sorted(to(where, "a", xy) for xy in places), abs=1e-9)
    assert np.count_nonzero(after.cause == "kept") == 7


def test_a_camera_whose_candidates_all_fall_says_that_it_saw_nothing():
    where = scene()
    rows: list[Row] = [(0, n, -1, None) for n in "acd"]
    rows += [(0, "b", -1, to(where, "b", PLACE)), (0, "b", -1, to(where, "b", (7.0, 2.0)))]
    after = fused(table(rows, where), where)
    assert of_step(after, 0) == {"a": NOTHING, "b": GONE, "c": NOTHING, "d": NOTHING}
    assert len(after) == 4


def test_candidates_are_followed_from_time_to_time():
    where = scene()
    rows: list[Row] = []
    for step in range(6):
        xy = (4.0 + 0.1 * step, 6.0)
        rows += (
            candidates(step, where, (xy,))
            if step < 3
            else [(step, n, -1, to(where, n, xy) if n == "b" else None) for n in "abcd"]
        )
    after = fused(table(rows, where), where)
    for step in range(3, 6):
        assert of_step(after, step) == {"a": BACK, "b": HIT, "c": BACK, "d": BACK}


def walk(n: int, where: Scene, seed: int = 5) -> Bearings:
    """A target on a circle, and a candidate on another; misses and false bearings at random."""
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for step in range(n):
        for target, radius in ((0, 2.0), (-1, 3.0)):
            xy = (5.0 + radius * np.cos(0.06 * step), 5.0 + radius * np.sin(0.06 * step))
            for c in where.cameras:
                off = SIGMA * rng.standard_normal() if rng.random() > 0.1 else rng.uniform(-1.0, 1.0)
                seen = rng.random() > 0.2
                rows.append((step, c.name, target, to(where, c.name, xy, off) if seen else None))
    return table(rows, where)


def test_where_the_input_is_cut_does_not_matter():
    where = scene()
    before = walk(20, where)
    whole = fused(before, where)
    for cut in (1, 7, 64):
        again = fused(before, where, cut=cut)
        for column in Bearings.columns():
            assert np.array_equal(
                getattr(again, column.name), getattr(whole, column.name), equal_nan=column.kind == "f8"
            ), column.name
    assert {"kept", "recovered"} <= set(whole.cause.tolist())


def test_memory_does_not_grow_with_the_recording():
    where = scene(3)
    piece = walk(8, where)
    wide = replace(piece, sensor=piece.sensor.astype("U200"))  # rows that would show if they were held
    size = sum(getattr(wide, c.name).nbytes for c in Bearings.columns())

    def parts(n: int) -> Iterator[Detections]:
        for k in range(n):
            moved = replace(wide, t_ns=wide.t_ns + k * 8 * STEP)
            yield Detections(Views.empty(), moved, (), 0, 0)

    def peak(n: int) -> int:
        gc.collect()
        tracemalloc.start()
        for _ in fuse(parts(n), where):
            pass
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    peak(2)
    # Twelve pieces more: their rows would take twelve times the size; a fifth of it is kept of each.
    assert peak(15) - peak(3) < 4 * size


def test_frames_close_in_time_are_one_moment_and_keep_their_own_times():
    where = scene()
    rows = table(observation(0, where, PLACE, missed="b"), where)
    shifted = replace(rows, t_ns=rows.t_ns + np.arange(4) * 5_000_000)
    assert "recovered" not in fused(shifted, where).cause
    after = fused(shifted, where, replace(FuseConfig.in_unit("m"), window_s=0.02))
    assert after.cause.tolist() == ["kept", "recovered", "kept", "kept"]
    assert np.array_equal(after.t_ns, shifted.t_ns)


def test_chances_of_a_camera_come_from_the_scene():
    # Two of four: undecided with equal chances; a camera that never reports falsely is believed.
    where = scene()
    rows = table(observation(0, where, PLACE, missed="ac"), where)
    assert set(of_step(fused(rows, where), 0).values()) == {GONE, NOTHING}
    sure = replace(where, cameras=tuple(replace(c, false_alarm=0.01) for c in where.cameras))
    assert set(of_step(fused(rows, sure), 0).values()) == {HIT, BACK}
    assert set(
        of_step(fused(rows, where, replace(FuseConfig.in_unit("m"), false_alarm_probability=0.05)), 0).values()
    ) == {HIT, BACK}
    keen = replace(where, cameras=tuple(replace(c, detection=0.999) for c in where.cameras))
    assert set(of_step(fused(rows, keen), 0).values()) == {GONE, NOTHING}


def test_input_that_cannot_be_fused_is_reported_in_one_line():
    rows = table(observation(0, scene(1), PLACE), scene(1))
    with pytest.raises(InputError, match="1 camera with a pose; fusion needs at least two"):
        fused(rows, scene(1))
    blind = replace(scene(), cameras=tuple(replace(c, placed=False) for c in scene().cameras))
    with pytest.raises(InputError, match="0 cameras with a pose; 4 more have no pose"):
        fused(rows, blind)
    with pytest.raises(InputError, match=r"no sensor 'x'.*it has a, b, c, d"):
        fused(replace(rows, sensor=np.array(["x"])), scene())
    with pytest.raises(InputError, match="two rows for target 0"):
        fused(Bearings.concat([rows, rows]), scene())
    with pytest.raises(InputError, match="sort the rows by t_ns"):
        late = replace(rows, t_ns=rows.t_ns + STEP)
        list(fuse((Detections(Views.empty(), b, (), 0, 0) for b in (late, rows)), scene()))


@pytest.mark.parametrize(
    "values",
    [
        {"sigma_prediction": 0.0},
        {"miss_probability": 1.0},
        {"false_alarm_probability": 0.0},
        {"gate": np.nan},
        {"max_coasting_steps": 0},
        {"window_s": -1.0},
    ],
)
def test_options_out_of_range_are_refused(values: dict[str, float]):
    with pytest.raises(SettingError, match=next(iter(values))):
        FuseConfig(**values)  # type: ignore[arg-type]


def test_tables_of_their_own_are_brought_together_by_time():
    where = scene()
    rows = walk(5, where)
    parts = list(in_step([], (rows.take(slice(k, k + 8)) for k in range(0, len(rows), 8))))
    assert sum(len(p.bearings) for p in parts) == len(rows)
    assert sum(len(p.views) for p in parts) == 0
