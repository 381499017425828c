"""Everybody in numbers: those of pieces are those of the whole table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_in_groups import walk

from occlog.records.tables import PeopleTracks, whole_times
from occlog.report.content.people import MAX_PEOPLE, PeopleStreams, people_statistics, usual_step


def hall(seed: int) -> PeopleTracks:
    """Many people who come and go, seen by several cameras, one or none."""
    random, people = np.random.default_rng(seed), []
    for k in range(MAX_PEOPLE + 20):
        begin, length = int(random.integers(0, 150)), int(random.integers(5, 60))
        one = walk(k * 3, np.arange(begin, begin + length) / 10, (k, 0), (0.5, 0))
        seen = random.choice(["", "b", "a,b", "a,c", "ab"], len(one))
        existence = np.where(random.random(len(one)) < 0.1, np.nan, random.random(len(one)))
        people.append(replace(one, seen_by=seen, existence_probability=existence))
    return PeopleTracks.merge(people)


@pytest.mark.parametrize("rows", [13, 10**6])
def test_figures_are_the_same_in_chunks_of_any_length(rows: int) -> None:
    tracks = hall(3)
    chunks = [tracks.take(slice(s, s + rows)) for s in range(0, len(tracks), rows)]
    streams = PeopleStreams()
    for piece in whole_times(chunks):
        streams.add(piece)
    assert streams.any
    streams.begin_cells((int(tracks.t_ns[0]), int(tracks.t_ns[-1])), float(usual_step(tracks.t_ns)))
    for chunk in chunks:
        streams.see(chunk, 3)
    found = streams.finish(people_statistics(tracks))
    per_time = np.unique(tracks.t_ns, return_counts=True)[1]
    assert (found.mean, found.most) == (pytest.approx(per_time.mean()), per_time.max())
    assert found.existence == pytest.approx(np.nanmean(tracks.existence_probability), rel=1e-12)
    assert found.several == pytest.approx(np.mean(np.isin(tracks.seen_by, ["a,b", "a,c"])), rel=1e-12)
    assert found.unseen == pytest.approx(np.mean(tracks.seen_by == ""), rel=1e-12)
    assert (found.rows, found.identities) == (len(tracks), MAX_PEOPLE + 20)
    assert found.cameras == ("a", "ab", "b", "c")
    ids, first, rows = np.unique(tracks.target_id, return_index=True, return_counts=True)
    longest = sorted(range(len(ids)), key=lambda k: -rows[k])[:MAX_PEOPLE]
    np.testing.assert_array_equal(found.drawn, ids[sorted(longest, key=lambda k: first[k])])
    for camera in ("a", "ab", "b"):
        got = found.sightings(camera)
        assert got.observed.sum() == len(tracks)
        assert got.share == pytest.approx(np.mean([camera in text.split(",") for text in tracks.seen_by.tolist()]))


def test_of_no_person_is_known_whether_they_are_there() -> None:
    streams = PeopleStreams()
    streams.add(replace(hall(1), existence_probability=np.full(len(hall(1)), np.nan)))
    assert not streams.any
