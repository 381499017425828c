"""First figures of tracks with identities of their own, and errors of whole tracks far from those of the pairs."""

from __future__ import annotations

import math

import pytest

from occlog.evaluate.mot.figures import first, independent_ids, matchings_differ, notes
from occlog.evaluate.results import summary_lines


def figures(whole: float, recall: float = 0.98) -> dict[str, float]:
    return {"rmse_m": whole, "matched_rmse_m": 0.5, "recall": recall, "id_switches": 3.0}


@pytest.mark.parametrize(("whole", "reported"), [(1.0, False), (1.01, True), (math.nan, False)])
def test_it_is_reported_from_twice_the_error_of_the_pairs_on(whole: float, reported: bool) -> None:
    assert matchings_differ(figures(whole), "m") is reported
    assert bool(notes(figures(whole), "m", "id")) is reported
    assert ("Accuracy" in summary_lines(figures(whole), "m")) is not reported


def test_without_pairs_nothing_is_reported() -> None:
    assert not notes({"rmse_m": 3.0}, "m", "id")


def test_pairs_are_to_be_read_where_most_true_positions_are_met() -> None:
    (line,) = notes(figures(1.5), "m", "id")
    assert "98% of the true positions are met: read the pairs" in line
    assert "identity switches (3)" in line
    (line,) = notes(figures(1.5, recall=0.49), "m", "id")
    assert line.endswith("only 49% of the true positions are met: read the first")


def test_tracks_with_identities_of_their_own_have_the_pairs_first() -> None:
    more = {"hota": 0.7, "idf1": 0.8, "mota": 0.9, "matched_nees_mean": 2.1, "matched_gate_m": 1.0}
    own = first({**figures(1.5), **more, "tracks_independent_ids": 1.0}, "m")
    assert independent_ids(own)
    assert not independent_ids(figures(1.5))
    assert list(own)[:6] == ["hota", "idf1", "mota", "id_switches", "matched_rmse_m", "matched_nees_mean"]
    (line,) = notes(own, "m", "optimal")
    assert all(words in line for words in ("0.5 m", "1 m gate", "1.5 m"))
    lines = summary_lines(own, "m")
    assert [line.split()[0] for line in lines[1:5]] == ["HOTA", "IDF1", "MOTA", "identity"]
    assert "Accuracy, one-to-one matching over the whole run" in lines
