"""Everybody over time on the page: counts, rows of identities, what each camera sees."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from people_in_groups import walk

from occlog.records.tables import Events, PeopleTracks, Tracks
from occlog.report.content.model import ReportInput
from occlog.report.content.people import MAX_PEOPLE, PeopleStatistics, camera_has_box, people_statistics
from occlog.report.page import build_page

TIMES = np.arange(30) / 10


def hall() -> PeopleTracks:
    """Two people, the second from 1 s on and hidden at the end."""
    first, second = walk(3, TIMES, (0, 0), (1, 0), camera="cam1,cam2"), walk(8, TIMES[10:], (0, 4), (1, 0))
    hidden = replace(second, seen_by=np.where(second.t_ns > 2_500_000_000, "", "cam2"))
    return PeopleTracks.merge([first, hidden])


def people(tracks: PeopleTracks) -> PeopleStatistics:
    found = ReportInput(tracks=tracks).people
    assert found is not None
    return found


def headings(page: str) -> list[str]:
    return re.findall(r"<h2[^>]*>(.*?)</h2>", page)


def test_people_are_counted_at_each_time() -> None:
    found = people_statistics(hall())
    assert found.people.tolist() == [1.0] * 10 + [2.0] * 20
    assert found.seen.tolist() == [1.0] * 10 + [2.0] * 16 + [1.0] * 4
    assert found.expected == pytest.approx(0.9 * found.people)


def test_a_camera_whose_name_begins_anothers_sees_only_its_own() -> None:
    tracks = walk(0, TIMES, (0, 0), (1, 0), camera="cam12,cam3")
    assert people(tracks).cameras == ("cam12", "cam3")
    assert not camera_has_box(tracks, "cam1").any()
    assert camera_has_box(tracks, "cam12").all()


def test_the_people_who_are_there_longest_have_rows_in_the_order_of_their_births() -> None:
    short = [walk(i, TIMES[:5], (i, 0), (1, 0)) for i in range(MAX_PEOPLE)]
    long = walk(900, TIMES[3:], (0, 9), (1, 0))
    drawn = people(PeopleTracks.merge([*short, long])).drawn.tolist()
    assert len(drawn) == MAX_PEOPLE
    assert drawn[-1] == 900
    assert MAX_PEOPLE - 1 not in drawn


@pytest.mark.drawn
def test_the_page_of_everybody_says_who_was_there_and_who_saw_them() -> None:
    events = Events.of(
        t_ns=[0, 2 * 10**9, 2 * 10**9],
        target_id=[3, 3, 8],
        kind=["initiated", "possible_switch", "possible_switch"],
        other_id=[-1, 8, 3],
        probability=[0.9, 0.4, 0.4],
    )
    page = build_page(ReportInput(tracks=hall(), events=events))
    wanted = ["Replay", "Floor plan", "Who was there", "Which camera saw them"]
    assert [each for each in headings(page) if each in wanted] == wanted
    assert "1 track initiation, 0 track terminations, 1 possible identity switch." in page
    assert "1.67 people at a time, 2 at most" in page
    assert "seen by no camera, of 50 estimates" in page
    assert "may have been exchanged" in page


def test_other_tracks_and_people_whom_no_one_sees_are_shown_without() -> None:
    plain = {c.name: getattr(hall(), c.name) for c in Tracks.columns()}
    assert "Who was there" not in headings(build_page(ReportInput(tracks=Tracks(**plain))))
    unseen = replace(hall(), seen_by=np.full(50, ""))
    assert "Which camera saw them" not in headings(build_page(ReportInput(tracks=unseen)))
