"""Galleries and decisions from sightings: what counts, what is suspended, who is whom."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.image import bins_of
from occlog.errors import InputError
from occlog.measure.appearance.config import LearnConfig, MatchConfig
from occlog.measure.appearance.sightings import (
    FrameBoxes,
    Sighting,
    boxes_of_frames,
    covered,
    overlaps,
    tracks_of_boxes,
)
from occlog.measure.appearance.stage import (
    EvidenceTally,
    IdentityEvidence,
    identities,
    learn,
    match,
    most_similar,
    renamed,
    sides_of,
)
from occlog.records.tables import Boxes, Gallery, Tracks
from occlog.settings import SettingError

LEVELS = 2
M = bins_of(LEVELS)


def sighting(track, angle, colours, *, t=0, pixels=1000, hidden=0.0):
    """Boxes of tracks at viewing angles in degrees, each of one colour, or of a mixture (m,)."""
    n = len(track)
    densities = np.array([np.eye(M)[c] if np.isscalar(c) else c for c in colours], dtype=np.float64)
    boxes = FrameBoxes(
        t_ns=t,
        sensor="hall",
        frame=t,
        box=np.arange(n, dtype=np.int32),
        identity=np.full(n, -1, dtype=np.int32),
        edges=np.zeros((n, 4)),
        density=densities,
        pixels=np.full(n, pixels),
    )
    return Sighting(
        boxes,
        np.array(track, dtype=np.int32),
        np.radians(np.array(angle, dtype=np.float64)),
        np.full(n, hidden),
        densities,
        np.full(n, pixels),
    )


def config(**values):
    return LearnConfig(colour_levels=LEVELS, min_samples=1, **values)


def gallery(**values):
    """Target 0 from the front (colour 0) and the back (1), target 3 from the front only (2)."""
    rows = [sighting([0, 3], [0, 0], [0, 2]), sighting([0], [180], [1])]
    return learn(rows, config(**values))


def test_pixels_of_a_side_add_up():
    table = learn([sighting([5], [0], [0]), sighting([5], [10], [1], t=9, pixels=3000)], config())
    assert (table.target_id.tolist(), table.angle.tolist(), table.angles.tolist()) == ([5], [1], [7])
    assert (table.samples.tolist(), table.pixels.tolist(), table.t_ns.tolist()) == ([2], [4000], [9])
    assert table.density[0, :3].tolist() == [0.25, 0.75, 0.0]


@pytest.mark.parametrize(
    "left_out",
    [
        sighting([-1], [0], [0]),
        sighting([5], [np.nan], [0]),
        sighting([5], [0], [0], pixels=99),
        sighting([5], [0], [0], hidden=0.21),
    ],
)
def test_boxes_that_say_nothing_are_left_out(left_out):
    assert not len(learn([left_out], config()))
    assert len(learn([sighting([5], [0], [0], pixels=100, hidden=0.2)], config())) == 1


def test_a_side_needs_enough_samples():
    rows = [sighting([1], [0], [0])] * 4
    assert not len(learn(rows, LearnConfig(colour_levels=LEVELS, min_samples=5)))
    assert len(learn([*rows, rows[0]], LearnConfig(colour_levels=LEVELS, min_samples=5))) == 1


def test_the_step_divides_half_a_turn():
    assert [LearnConfig(angle_step=s).angles for s in (30.0, 60.0, 90.0, 180.0, 360.0)] == [7, 4, 3, 2, 1]
    for step in (50.0, 200.0, 0.0):
        with pytest.raises(SettingError, match="angle_step"):
            LearnConfig(angle_step=step)


def test_the_same_side_is_compared():
    (table,) = match([sighting([8, 9], [0, 180], [0, 0])], sides_of(gallery()), MatchConfig())
    assert table.track_id.tolist() == [8, 8, 9, 9]
    assert table.target_id.tolist() == [0, 3, 0, 3]
    assert table.decision.tolist() == ["same", "other", "other", "suspended"]
    assert table.reason.tolist() == ["", "", "", "angle"]
    assert table.rho[:3].tolist() == [1.0, 0.0, 0.0]
    assert table.angle.tolist() == [1, 1, 7, 7]


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        (sighting([8], [np.nan], [0]), "heading"),
        (sighting([8], [0], [0], hidden=0.21), "covered"),
        (sighting([8], [0], [0], pixels=99), "pixels"),
        (sighting([8], [90], [0]), "angle"),
    ],
)
def test_what_cannot_be_compared_is_suspended(seen, reason):
    (table,) = match([seen], sides_of(gallery()), MatchConfig())
    assert table.decision.tolist() == ["suspended"] * 2
    assert table.reason.tolist() == [reason] * 2
    assert np.isnan(table.rho).all()


def test_one_angle_needs_no_heading():
    sides = sides_of(gallery(angle_step=360.0))
    (table,) = match([sighting([-1], [np.nan], [2])], sides, MatchConfig())
    assert table.decision.tolist() == ["other", "same"]


def test_of_two_boxes_the_one_that_is_more_alike_is_the_target():
    like = np.array([[0.9, 0.85], [0.95, 0.1], [np.nan, 0.79]])
    assert most_similar(like, 0.8).tolist() == [[False, False], [True, False], [False, False]]
    assert most_similar(like, 0.79).tolist() == [[False, False], [True, False], [False, True]]
    assert most_similar(np.zeros((0, 2)), 0.5).shape == (0, 2)


def test_a_gallery_of_no_levels_or_without_rows_is_refused():
    table = gallery()
    with pytest.raises(InputError, match="densities of 7 bins"):
        sides_of(Gallery.of(**{c.name: getattr(table, c.name) for c in table.columns()} | {"bins": table.bins + 1}))
    with pytest.raises(InputError, match="has no rows"):
        sides_of(Gallery.empty())


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("bins", [6, 6, 12], "bins is 12, but 6 in the first row"),
        ("angle", [1, 8, 1], "angle 8 from 1 to 7"),
        ("samples", [1, 0, 1], "0 samples"),
        ("angle", [1, 1, 1], "two rows have the same target_id and angle"),
        ("density", np.eye(256)[[0, 1, 200]], "invalid density"),
    ],
)
def test_a_gallery_that_contradicts_itself_is_refused(column, value, message):
    table = gallery()
    values = {c.name: getattr(table, c.name) for c in table.columns()}
    with pytest.raises(InputError, match=message):
        Gallery.of(**values | {column: np.array(value)})


def test_boxes_are_of_the_tracks_where_they_lie():
    boxes = np.array([[0.0, 0, 10, 20], [100, 0, 110, 20]])
    expected = np.array([[101.0, 1, 111, 21], [np.nan] * 4, [0, 0, 10, 10]])
    assert overlaps(boxes, expected)[0].tolist() == [0.0, 0.0, 100.0]
    assert tracks_of_boxes(boxes, expected, 0.3).tolist() == [2, 0]
    assert tracks_of_boxes(boxes, expected, 0.5).tolist() == [2, 0]
    assert tracks_of_boxes(boxes, expected, 0.51).tolist() == [-1, 0]


def test_nearer_people_cover_farther_ones():
    boxes = np.array([[0.0, 0, 10, 20], [5, 0, 15, 30], [50, 0, 60, 20]])
    assert covered(boxes).tolist() == [0.5, 0.0, 0.0]


def test_tracks_are_named_best_first_and_never_two_of_one_time():
    evidence = IdentityEvidence(
        np.array([1, 2, 3], dtype=np.int32),
        np.array([0, 7], dtype=np.int32),
        np.array([[9.0, 5.0], [9.5, 8.5], [9.9, 0.0]]),
        np.full((3, 2), 10),
    )
    together = np.array([[True, True, False], [True, True, False], [False, False, True]])
    assert identities(evidence, together, 0.8, 10) == {3: 0, 2: 0}
    assert identities(evidence, np.eye(3, dtype=bool), 0.8, 10) == {3: 0, 2: 0, 1: 0}
    assert identities(evidence, np.ones((3, 3), dtype=bool), 0.8, 10) == {3: 0, 2: 7}
    assert identities(evidence, together, 0.8, 11) == {}


def test_evidence_is_of_what_was_compared():
    tally = EvidenceTally()
    for part in match(
        [sighting([8, 9], [0, 180], [0, 0]), sighting([8], [0], [0])], sides_of(gallery()), MatchConfig()
    ):
        tally.add(part)
    found = tally.evidence()
    assert found.track.tolist() == [8, 9]
    assert found.boxes.tolist() == [[2, 2], [1, 0]]
    assert not EvidenceTally().evidence().similarities.size


def test_other_tracks_get_numbers_above_the_gallery():
    n = 3
    flat = np.zeros(n)
    tracks = Tracks.of(
        t_ns=np.zeros(n, dtype=np.int64), target_id=[0, 4, 5], x=flat, y=flat, vx=flat, vy=flat,
        cov_xx=flat + 1, cov_xy=flat, cov_yy=flat + 1,
    )  # fmt: skip
    table, names = renamed(tracks, {4: 0}, [0, 3])
    assert names == {0: 4, 4: 0, 5: 5}
    assert table.target_id.tolist() == [0, 4, 5]


def test_chunks_of_boxes_in_disorder_are_refused():
    def boxes(*t_ns):
        flat = np.full(len(t_ns), 10.0)
        return Boxes.of(
            t_ns=list(t_ns), sensor=["a"] * len(t_ns), frame=range(len(t_ns)), box=[0] * len(t_ns),
            target_id=[-1] * len(t_ns), left_px=flat, top_px=flat, width_px=flat, height_px=flat, confidence=flat / 10,
        )  # fmt: skip

    assert [each.t_ns for each in boxes_of_frames([boxes(0, 1), boxes(1, 2)])] == [0, 1, 2]
    with pytest.raises(InputError, match="time 1 s is earlier than the preceding 2 s") as error:
        list(boxes_of_frames([boxes(0, 2_000_000_000), boxes(1_000_000_000)]))
    assert error.value.id == "unsorted-times"
