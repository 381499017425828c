"""The experiments on [Lee] Ch. 2 at a small size: tables, verdicts, and what they are made of."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.papers import catalogue
from occlog.papers import verdicts as v
from occlog.papers.lee.space import scenarios, tables, variances, worlds
from occlog.papers.lee.space.worlds import AXIS_NAMES, TABLE, bounds, space_spec, space_trial, world
from occlog.papers.verdicts import PaperRow, Size

SMALL = Size(2, 10, quick=True)


def execute(specs):
    return [space_trial(s) for s in specs]


def test_all_items_of_chapter_2_are_there_in_order() -> None:
    items = [e.item for e in catalogue.PAPERS["lee"]]
    own = [
        "variances",
        "table2.1",
        "table2.2",
        "scenario1",
        "scenario2",
        "scenario3",
        "scenario4",
        "sensors",
        "particles",
    ]
    assert [i for i in items if i in own] == own


def test_values_of_a_root_mean_square_have_it_as_their_mean_and_its_standard_error() -> None:
    rng = np.random.default_rng(0)
    squares = rng.chisquare(3, 400)
    row = PaperRow("", 0.0, scenarios.root_mean(squares))
    assert row.mean == pytest.approx(math.sqrt(squares.mean()))
    # Of the root of a mean of chi-square: sd / (2 root sqrt(n)), by the delta method
    assert row.error == pytest.approx(squares.std(ddof=1) / (2 * math.sqrt(squares.mean()) * math.sqrt(400)))


def test_equal_runs_have_equal_noise_for_every_method_and_their_own_for_every_run() -> None:
    spec = space_spec(SMALL, 0, 1, "direct3d", 200)
    assert space_trial(spec) == space_trial(spec)
    assert space_trial(spec) != space_trial({**spec, "run": 1})


@pytest.mark.jit
@pytest.mark.parametrize("number", [1, 3, 4])
def test_scenarios_give_rows_of_each_axis_and_verdicts(number: int) -> None:
    experiment = scenarios.SCENARIOS[number - 1]
    table = experiment.compute(SMALL, execute)
    direct, flat = bounds(number, SMALL.steps)
    for name, bound in (("bound", direct), ("bound of the planes", flat)):
        for j, a in enumerate(AXIS_NAMES):
            assert v.find(table, f"{name} {a}", 0.5).mean == pytest.approx(bound[5, j])
    found = {x.id: x for x in experiment.judge(table)}
    if number < 4:
        assert found[f"scenario{number}-phi"].verdict == v.REPRODUCED
    if number == 3:
        assert found["scenario3-switch"].measured == 13
    assert found[f"scenario{number}-bounds"].verdict == v.NOT  # a plane never has the lower bound
    assert {x.verdict for x in found.values()} <= set(v.WORDS)


@pytest.mark.statistics
def test_particles_and_sensors_are_relative_to_what_they_say() -> None:
    table = scenarios.COUNTED.compute(SMALL, execute)
    assert [r.x for r in v.series(table, "pps")] == [100.0, 300.0]
    assert all(0.0 < r.mean < 10.0 for r in table)
    assert len(scenarios.COUNTED.judge(table)) == 5
    rows = scenarios.SENSORS.compute(SMALL, execute)
    assert [r.x for r in v.series(rows, "direct3d")] == [1.0, 2.0]
    assert len(scenarios.SENSORS.judge(rows)) == 3


@pytest.mark.statistics
def test_a_wrong_model_in_one_plane_spoils_the_equal_combining_only_while_it_lasts() -> None:
    size = Size(2, 70, quick=True)
    right, wrong = (e.compute(size, execute) for e in tables.TABLES)
    assert {r.extra["xy_yz"] for r in right if r.series == tables.EQUAL} == {1.0}
    x_right, x_wrong = (v.find(t, tables.EQUAL, 1.0) for t in (right, wrong))
    assert x_right.values == x_wrong.values  # the plane xy knows its acceleration in both
    assert v.find(wrong, tables.EQUAL, 3.0).mean != v.find(right, tables.EQUAL, 3.0).mean
    for e, table in zip(tables.TABLES, (right, wrong), strict=True):
        assert all(x.id.startswith(e.item) for x in e.judge(table))


def test_speed_of_the_tables_target_stays_and_it_turns_from_z_to_y() -> None:
    states = world(TABLE, 166).states
    speed = np.hypot(states[:, 4], states[:, 5])
    np.testing.assert_allclose(speed, speed[0])
    np.testing.assert_allclose(states[:, 3], 1.0)
    assert states[0, 4] < 0 < states[-1, 4]
    np.testing.assert_allclose(states[1:, 0] - states[:-1, 0], worlds.TABLE_STEP_S)


@pytest.mark.jit
def test_variances_agree_and_the_printed_formulas_are_wrong_on_half_and_three_quarters() -> None:
    experiment = variances.VARIANCES
    found = {x.id: x for x in experiment.judge(experiment.compute(Size(3, 10, quick=True), execute))}
    assert found["variances-first-order"].verdict != v.NOT
    for key, share in (("yz", 0.5), ("zx", 0.75), ("rule", 0.5)):
        # 60000 directions: a standard error of 0.002; five of them
        assert found[f"variances-{key}"].measured == pytest.approx(share, abs=0.01)
    assert found["variances-band"].measured == pytest.approx(1.0, abs=1e-3)
