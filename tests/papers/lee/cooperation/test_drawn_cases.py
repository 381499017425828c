from __future__ import annotations

import pytest

from occlog.papers.lee.cooperation import drawn_cases as drawn
from occlog.papers.verdicts import PaperRow, Size


def sketch(case, run):
    return drawn.sketch_trial({"case": case, "seed": 0, "run": run})


@pytest.mark.jit
@pytest.mark.parametrize(("case", "bearing", "ellipse"), [("3.10", 1, 1), ("3.11", 0, 1), ("3.13", 1, 0)])
def test_each_condition_fires_where_the_sketch_says(case, bearing, ellipse):
    for run in range(2):
        assert sketch(case, run) == {"bearing": bearing, "ellipse": ellipse}


@pytest.mark.jit
def test_the_count_does_not_fire_where_one_object_replaces_another():
    specs = [{"case": c, "seed": 0, "run": r} for c in drawn.CHANGES for r in range(1)]
    found = [drawn.change_trial(s) for s in specs]
    assert all(f["count"] == 0.0 for f in found)
    # Objects that are heard no more make the estimate's performance fire; two that are heard as one need not.
    assert all(f["either"] == 1.0 for f, s in zip(found, specs, strict=True) if s["case"] != "d")
    assert all(f["either"] == (f["after"] > 0) for f in found)


def test_every_change_leaves_the_number_of_bearings_as_it_is():
    for case in drawn.CHANGES.values():
        assert len(case.before) == len(case.after)
        assert set(sum(case.before, ())) != set(sum(case.after, ())) or case.before != case.after


def test_sketches_are_judged_by_shares_of_runs():
    table = [PaperRow("(3.15)", 11.0, (0.0,) * 40), PaperRow("(3.16)", 11.0, (1.0,) * 20 + (0.0,) * 20)]
    words = {v.id: v.verdict for v in drawn.judge_sketches(table)}
    assert words == {"fig3.11-drawn-bearing": "reproduced", "fig3.11-drawn-ellipse": "not decided"}


@pytest.mark.jit
def test_the_table_has_every_case_and_condition():
    table = drawn.changes(Size(1, 40, True), lambda specs: [dict.fromkeys(drawn.TITLES, 1.0) for _ in specs])
    assert {r.x for r in table} == {2.0, 3.0, 4.0, 5.0, 6.0}
    words = {v.id: v.verdict for v in drawn.judge_changes(table)}
    assert words["fig3.8-b"] == "not reproduced"
    assert len(words) == 15
