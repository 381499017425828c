"""Times of everybody as rows of tables, with a stand-in for the method: two people at known places."""

from __future__ import annotations

import numpy as np
import pytest
from people_boxes import HEIGHT, STEP_NS, WIDTH, box, boxes, hall, place

from occlog.core.numerics.assignment import assign
from occlog.records.scene import CommonNoise
from occlog.records.tables import PeopleTracks
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.interface import NO_ID, BoxAssociations, Event, FrameDetections, TrackSnapshot
from occlog.track.people.frame_detections import (
    BoxStatistics,
    FrameDetectionsWithIds,
    frame_detections,
    group_time_steps,
    rows_of_boxes,
)
from occlog.track.people.rows import SnapshotWithDetections
from occlog.track.people.stage import PeopleTracker, Tabulator, track_people

SCENE = hall("abc")
CAMERAS = SCENE.cameras
PEOPLE = 2
HIDDEN = 0.25
"""Visibility of the second person, of whom the stand-in says that no box is theirs."""


def step(state: int, observations: list[FrameDetections]) -> tuple[int, TrackSnapshot]:
    """The people where they are; of the first one the nearest box of each camera, of the second one none."""
    t_ns = max(observation.t_ns for observation in observations)
    mean = np.zeros((PEOPLE, 6))
    mean[:, :2] = [place(k, t_ns * 1e-9) for k in range(PEOPLE)]
    mean[:, 4:] = HEIGHT, WIDTH
    visibility = np.full((PEOPLE, len(CAMERAS)), np.nan)
    person, camera, row = [], [], []
    for observation in observations:
        visibility[:, observation.camera] = 1.0, HIDDEN
        expected = box(CAMERAS[observation.camera], *mean[0, :2])
        cost = np.abs(observation.boxes - expected).max(axis=1)[None]
        _, best = assign(cost, 20.0) if cost.size else ([], [])
        person += [0] * len(best)
        camera += [observation.camera] * len(best)
        row += observation.row[best].tolist()
    events = {
        0: (Event("initiated", 10, NO_ID, 0.9), Event("initiated", 11, NO_ID, 0.8)),
        3: (Event("possible_switch", 10, 11, 0.4),),
    }
    moment = TrackSnapshot(
        t_ns=t_ns,
        ids=np.array([10, 11]),
        mean=mean,
        covariance=np.tile(0.01 * np.eye(6), (PEOPLE, 1, 1)),
        existence=np.array([1.0, 0.75]),
        visibility=visibility,
        support=BoxAssociations(
            np.array(person, int),
            np.array(camera, int),
            np.array(row, int),
            np.full(len(row), 0.875),
            np.zeros(len(row)),
        ),
        events=events.get(state, ()),
    )
    return state + 1, moment


STAND_IN = PeopleTracker(begin=lambda scene, cameras, config: 0, step=step)


@pytest.fixture(scope="module")
def seen() -> list[SnapshotWithDetections]:
    found = boxes(SCENE, 1.0, people=PEOPLE, miss=0.2)
    stream = frame_detections(rows_of_boxes([found]), CAMERAS, "abc", BoxStatistics.of(3))
    return [
        each
        for part in track_people(group_time_steps(stream, 0), SCENE, CAMERAS, JipdaConfig(), STAND_IN)
        for each in part
    ]


def test_everybody_has_a_row_at_every_moment(seen: list[SnapshotWithDetections]) -> None:
    rows = Tabulator(CAMERAS, in_images=False).tables(seen).tracks
    assert isinstance(rows, PeopleTracks)
    assert rows.target_id.tolist() == [10, 11] * 10
    assert np.unique(rows.t_ns).tolist() == [k * STEP_NS for k in range(10)]
    np.testing.assert_allclose((rows.x[0], rows.y[0]), place(0, 0.0))
    assert set(rows.existence_probability.tolist()) == {1.0, 0.75}
    np.testing.assert_allclose(rows.sd_height, 0.1)
    np.testing.assert_allclose(rows.cov_vx_vx, 0.01)
    assert (rows.cov_x_vy == 0).all()


def test_noise_common_to_all_cameras_widens_covariances(seen: list[SnapshotWithDetections]) -> None:
    """By that of random similarity transforms of the ground about its centre, of all rows alike."""
    common = CommonNoise((2.0, 3.0), position=0.02, yaw=0.01, scale=0.015)
    bare = Tabulator(CAMERAS, in_images=False).tables(seen).tracks
    rows = Tabulator(CAMERAS, in_images=False, common_noise=common).tables(seen).tracks
    rng = np.random.default_rng(5)
    by = (1.0 + rng.normal(0.0, 0.015, 20_000)) * np.exp(1j * rng.normal(0.0, 0.01, 20_000))
    shift = rng.normal(0.0, 0.02, (20_000, 2)) @ [1.0, 1j]
    for k in (0, 1):
        at = by * (bare.x[k] - 2.0 + 1j * (bare.y[k] - 3.0)) + shift
        spread = np.cov(at.real, at.imag)
        added = [
            [getattr(rows, f"cov_{a}")[k] - getattr(bare, f"cov_{a}")[k] for a in row]
            for row in (("xx", "xy"), ("xy", "yy"))
        ]
        np.testing.assert_allclose(added, spread, atol=0.05 * spread.trace())
        assert rows.sd_height[k] ** 2 - bare.sd_height[k] ** 2 == pytest.approx((0.015 * HEIGHT) ** 2)


def test_rows_say_who_saw_the_person_and_why_to_doubt(seen: list[SnapshotWithDetections]) -> None:
    rows = Tabulator(CAMERAS, in_images=False).tables(seen).tracks
    hidden = rows.take(rows.target_id == 11)
    assert set(hidden.quality_flags.tolist()) == {"coasting"}
    assert set(hidden.seen_by.tolist()) == {""}
    stated = rows.take(rows.target_id == 10)
    for by, doubt, t_ns in zip(
        stated.seen_by.tolist(), stated.quality_flags.tolist(), stated.t_ns.tolist(), strict=True
    ):
        words = {"": ["coasting"], "a": ["single_view"], "b": ["single_view"], "c": ["single_view"]}.get(by, [])
        assert doubt == ",".join([*words, *(["possible_switch"] if t_ns == 3 * STEP_NS else [])])
    assert "a,b,c" in stated.seen_by.tolist()


def test_support_names_the_boxes_by_frame_and_number(seen: list[SnapshotWithDetections]) -> None:
    found = boxes(SCENE, 1.0, people=PEOPLE, miss=0.2)
    rows = Tabulator(CAMERAS, in_images=False).tables(seen).support
    keys = zip(found.t_ns.tolist(), found.sensor.tolist(), found.box.tolist(), strict=True)
    person = dict(zip(keys, found.target_id.tolist(), strict=True))
    assert len(rows) == np.count_nonzero(found.target_id == 0)
    assert set(rows.probability.tolist()) == {0.875}
    assert set(rows.target_id.tolist()) == {10}
    keys = zip(rows.t_ns.tolist(), rows.sensor.tolist(), rows.box.tolist(), strict=True)
    assert {person[key] for key in keys} == {0}
    np.testing.assert_array_equal(rows.frame, rows.t_ns // STEP_NS)


def test_events_have_the_time_of_their_moment(seen: list[SnapshotWithDetections]) -> None:
    rows = Tabulator(CAMERAS, in_images=False).tables(seen).events
    assert rows.kind.tolist() == ["initiated", "initiated", "possible_switch"]
    assert rows.t_ns.tolist() == [0, 0, 3 * STEP_NS]
    assert rows.other_id.tolist() == [-1, -1, 11]


def test_everybody_is_in_every_image_with_a_box_or_without(seen: list[SnapshotWithDetections]) -> None:
    rows = Tabulator(CAMERAS, in_images=True).tables(seen).views
    assert rows is not None
    found = boxes(SCENE, 1.0, people=PEOPLE, miss=0.2)
    assert len(rows) == PEOPLE * len(CAMERAS) * 10
    assert (rows.visibility[rows.target_id == 11] == HIDDEN).all()
    assert set(rows.likelihood_mode[rows.target_id == 11].tolist()) == {"ground"}
    own = rows.take((rows.target_id == 10) & (rows.likelihood_mode == "box"))
    assert len(own) == np.count_nonzero(found.target_id == 0)
    first = found.take(found.target_id == 0)
    np.testing.assert_allclose(own.x_px - own.a_px, first.left_px)
    np.testing.assert_allclose(2 * own.b_px, first.height_px)


def test_people_without_a_box_stand_where_the_floor_lets_expect_them(seen: list[SnapshotWithDetections]) -> None:
    rows = Tabulator(CAMERAS, in_images=True).tables(seen).views
    assert rows is not None
    hidden = rows.take(rows.target_id == 11)
    for k in range(0, len(hidden), 7):
        of = SCENE.camera(str(hidden.sensor[k]))
        left, top, right, bottom = box(of, *place(1, hidden.t_ns[k] * 1e-9))
        np.testing.assert_allclose(hidden.x_px[k], 0.5 * (left + right), atol=0.5)
        np.testing.assert_allclose(hidden.b_px[k], 0.5 * (bottom - top), rtol=0.02)
    # 0.1 m at about 8 m distance and 420 px
    assert 3.0 < np.sqrt(np.median(hidden.cov_xx_px)) < 8.0


def test_a_later_look_shows_people_where_they_walk_on(seen: list[SnapshotWithDetections]) -> None:
    each = seen[0]
    moment = each.snapshot._replace(mean=each.snapshot.mean.copy())
    moment.mean[1, 2:4] = 1.0, 0.0
    late = [
        FrameDetectionsWithIds(e.detections._replace(t_ns=e.detections.t_ns + STEP_NS), e.frame, e.box)
        for e in each.frames
    ]
    rows = Tabulator(CAMERAS, in_images=True).tables([SnapshotWithDetections(moment, late)]).views
    assert rows is not None
    x, y = place(1, 0.0)
    row = rows.take((rows.target_id == 11) & (rows.sensor == "a"))
    left, _, right, _ = box(CAMERAS[0], x + 0.1, y)
    np.testing.assert_allclose(row.x_px, 0.5 * (left + right), atol=0.5)


def test_no_one_gives_empty_tables() -> None:
    found = Tabulator(CAMERAS, in_images=True).tables([])
    assert [len(table) for table in found if table is not None] == [0, 0, 0, 0]
