"""Places and words of the statements: found by the beginning of an id, and known for every experiment."""

from __future__ import annotations

from occlog.papers import verdicts as v
from occlog.papers.catalogue import PAPERS, SOURCES
from occlog.papers.verdicts import OWN, PaperSource, attributed, exact, source_of

PLACES = {"fig3": PaperSource("Fig. 3", "words", 7), "fig3-own": OWN}


def test_the_longest_beginning_of_an_id_counts_and_ends_at_a_hyphen() -> None:
    assert source_of("fig3-a-b", PLACES) == PLACES["fig3"]
    assert source_of("fig3-own-b", PLACES) == OWN
    assert source_of("fig31-a", PLACES) is None


def test_verdicts_get_the_place_that_they_do_not_have() -> None:
    first = v.judge("fig3-a", "", exact(1.0), v.above(0.0), rule="")
    (found,) = attributed([first], PLACES)
    assert (found.place, found.words, found.page) == ("Fig. 3", "words", 7)
    assert attributed([found], {"fig3": OWN}) == [found]
    assert attributed([first], {}) == [first]


def test_every_experiment_of_the_papers_on_cameras_has_places() -> None:
    for paper in ("ercan", "rahimi", "qu"):
        begins = {key.split("-")[0] for key in SOURCES[paper]}
        for e in PAPERS[paper]:
            # Ids of printed equations have the equation's number, and no name of an experiment
            assert e.item == "equations" or e.item.split("-")[0] in begins, (paper, e.item)
