"""The experiments on [Qu]: tables of made-up and of tiny trials, and the rules of their verdicts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.papers import verdicts as v
from occlog.papers.qu import variants
from occlog.papers.qu.common import METHODS, PARTS, everywhere, ordered, seed_of, spec_of
from occlog.papers.qu.experiments import fig7, loop, motion, table1, table3
from occlog.papers.qu.experiments import loop as sweeps
from occlog.papers.qu.experiments.fig7 import fig7_shots
from occlog.papers.qu.experiments.table3 import RATES
from occlog.papers.verdicts import PaperRow, Size

RATE = {"mipf": 0.30, "cmct": 0.20, "idmot": 0.10, "bmct": 0.008}
MS = {"mipf": 3.0, "cmct": 6.0, "idmot": 3.5, "bmct": 4.0}


def figures(label: str, method: str, spread: float, factor: float = 1.0) -> dict[str, float]:
    """What a trial gives for a method, as if it had been run."""
    rate = factor * RATE[method] * (1.0 + spread)
    own = {
        "fr_p": rate,
        "fr_l": 1.2 * rate,
        "idf1": 0.9,
        "hota": 0.8,
        "mota": 0.7,
        "frame_ms": MS[method],
        "particles": 60.0,
        "left": 0.0,
        "lost": 0.0,
        "off_end": 0.0 if method == "bmct" else 0.5,
        "checked": 1.0,
        "bad": 0.0,
        "false_alarm": 0.001,
        "missed": math.nan,
        **{f"off_{k}": rate for k in range(PARTS)},
    }
    return {f"{label}.{name}": value for name, value in own.items()}


def made_up(specs):
    """Results of all methods; the spread depends on the seed."""
    out = []
    for spec in specs:
        spread = 0.1 * math.sin(spec["seed"])
        parts = [figures(label, own["method"], spread) for label, own in spec["methods"].items()]
        out.append({key: value for part in parts for key, value in part.items()})
    return out


def found(verdicts) -> dict[str, str]:
    return {x.id: x.verdict for x in verdicts}


def test_videos_have_seeds_from_one_on() -> None:
    size = Size(3, 40)
    assert [seed_of(size, run) for run in range(3)] == [1, 2, 3]
    assert spec_of(size, 1, balls=4)["balls"] == {"frames": 40, "balls": 4}
    assert list(spec_of(size, 0)["methods"]) == list(METHODS)


def test_order_counts_by_two_standard_errors_run_by_run() -> None:
    low, high = PaperRow("low", 1.0, (1.0, 2.0, 3.0)), PaperRow("high", 1.0, (3.0, 4.1, 5.1))
    found = ordered("k", "", low, high)
    assert (found.verdict, found.measured) == (v.REPRODUCED, pytest.approx((2.0 + 2.1 + 2.1) / 3))
    assert ordered("k", "", high, low).verdict == v.NOT
    one_of_many = PaperRow("high", 1.0, (2.9, 1.0, 3.0))
    assert ordered("k", "", PaperRow("low", 1.0, (1.0, 1.5, 3.0)), one_of_many).verdict == v.UNDECIDED


def test_nothing_is_reported_of_the_order_of_rates_below_one_per_cent() -> None:
    small = PaperRow("low", 1.0, (0.0, 0.0, 0.0))
    assert ordered("k", "", small, PaperRow("high", 1.0, (0.98, 0.99, 0.99))).verdict == v.UNDECIDED
    assert ordered("k", "", small, PaperRow("high", 1.0, (1.0, 1.0, 1.01))).verdict == v.REPRODUCED


def test_points_with_nothing_to_gain_are_left_out() -> None:
    nothing = (PaperRow("", 1.0, (0.0, 0.0)), PaperRow("", 1.0, (0.1, 0.2)))
    good = (PaperRow("", 2.0, (1.0, 2.0)), PaperRow("", 2.0, (3.45, 4.55)))
    assert everywhere("k", "", [nothing]) is None
    verdict = everywhere("k", "", [nothing, good])
    assert verdict is not None
    assert (verdict.verdict, verdict.measured) == (v.REPRODUCED, 2.5)
    assert "1 points skipped" in verdict.rule
    assert "holds at 1 of 1 points" in verdict.rule


def test_table3_has_both_rates_of_all_methods_and_says_whose_the_printed_ones_are() -> None:
    table = table3.TABLE3.compute(Size(12, 40), made_up)
    assert [(r.series, r.x) for r in table] == [(name, x) for name in RATES.values() for x in (1, 2, 3, 4)]
    row = table[0]
    assert row.values[0] == pytest.approx(30.0 * (1.0 + 0.1 * math.sin(1)))
    assert (row.extra["printed_other_video"], row.extra["particles"]) == (36.8, 60.0)
    words = found(table3.TABLE3.judge(table))
    assert set(words.values()) == {v.REPRODUCED}
    assert len(words) == 2 * 6 + 3


def test_table3_tells_the_deviation_of_the_trackers_from_that_of_the_videos() -> None:
    rng = np.random.default_rng(1)
    rates = 10.0 + 3.0 * rng.standard_normal((4000, 1)) + 2.0 * rng.standard_normal((4000, 2))
    found = table3.deviations(rates)
    assert found["sd_trackers"] == pytest.approx(2.0, rel=0.05)
    assert found["sd_videos"] == pytest.approx(3.0, rel=0.05)
    assert table3.deviations(np.array([[1.0, 3.0], [3.0, 1.0]]))["sd_videos"] == 0.0


def test_table3_runs_each_method_on_each_video_with_several_seeds() -> None:
    specs = []
    table3.TABLE3.compute(Size(2, 40, seed=5), lambda given: specs.extend(given) or made_up(given))
    assert [spec["seed"] for spec in specs] == [6, 7]
    seeds = {own["track_seed"] for label, own in specs[0]["methods"].items() if own["method"] == "bmct"}
    assert seeds == {6, 10_006}


def test_table3_finds_what_does_not_hold() -> None:
    def reversed_order(specs):
        swap = {"mipf": "bmct", "bmct": "mipf", "cmct": "idmot", "idmot": "cmct"}
        return [{f"{swap[k.split(' ')[0]]} {k.split(' ')[1]}": x for k, x in r.items()} for r in made_up(specs)]

    words = found(table3.TABLE3.judge(table3.TABLE3.compute(Size(12, 40), reversed_order)))
    for rate in RATES:
        for key in ("bmct-idmot", "idmot-cmct", "cmct-mipf", "much-lower", "mean", "median"):
            assert words[f"table3-{rate}-{key}"] == v.NOT


def test_fig7_judges_by_the_last_frame() -> None:
    table = fig7.FIG7.compute(Size(12, 40), made_up)
    assert [r.x for r in v.series(table, "BMCT")] == [2.0 * k + 1.0 for k in range(PARTS)]
    words = found(fig7.FIG7.judge(table))
    assert words["fig7-hijacked"] == words["fig7-bmct"] == words["fig7-all"] == v.REPRODUCED
    assert words["fig7-idmot"] == v.NOT  # both have half of the trackers off
    assert words["fig7-idmot-fails"] == v.REPRODUCED


@pytest.mark.parametrize("experiment", variants.VARIANTS)
def test_variants_have_both_rates_at_every_value(experiment) -> None:
    table = experiment.compute(Size(6, 40, quick=True), made_up)
    assert len(table) == 2 * 4 * 2
    assert {r.plotted for r in table if "labels" in r.series} == {False}
    words = found(experiment.judge(table))
    assert words[f"{experiment.item}-fr_p"] == words[f"{experiment.item}-fr_l"] == v.REPRODUCED
    if experiment.item == "views":
        assert "views-fr_p-more" not in words  # nothing to gain with any number


def test_motions_are_judged_one_by_one_and_the_remedy_against_bmct() -> None:
    def trials(specs):
        out = made_up(specs)
        for spec, result in zip(specs, out, strict=True):
            hard = spec["balls"]["ball_motion"] == "manoeuvre"
            for rate in RATES:
                result[f"bmct.{rate}"] = 0.2 + 0.01 * (spec["seed"] % 3) if hard else 0.01
                result[f"{motion.REMEDY}.{rate}"] = 0.05 if hard else 0.011
                result[f"idmot.{rate}"] = 0.15 + 0.01 * (spec["seed"] % 2)
        return out

    table = motion.MOTION.compute(Size(12, 40), trials)
    assert len(table) == 2 * 5 * 3
    words = found(motion.MOTION.judge(table))
    assert words["motion-fr_p"] == words["motion-fr_l"] == v.IN_PART  # not where they manoeuvre
    assert words["motion-straight-fr_l-followed"] == words["motion-walk-fr_l-followed"] == v.REPRODUCED
    assert words["motion-manoeuvre-fr_l-followed"] == v.NOT
    assert words["motion-manoeuvre-fr_l-remedy"] == words["motion-manoeuvre-fr_p-remedy"] == v.REPRODUCED
    assert words["motion-walk-fr_l-cost"] == words["motion-straight-fr_p-cost"] == v.REPRODUCED


def test_the_quick_form_of_the_views_measures_their_cost() -> None:
    table = variants.VARIANTS[2].compute(Size(2, 40, quick=True), made_up)
    cost = next(x for x in variants.VARIANTS[2].judge(table) if x.id == "views-cost")
    assert cost.measured == pytest.approx(0.0)  # the made-up times do not grow


def test_loop_counts_wrong_trackers_and_compares_with_idmot() -> None:
    def trials(specs):
        out = made_up(specs)
        for spec, result in zip(specs, out, strict=True):
            for label in (x for x in spec["methods"] if x.startswith("wrong")):
                late = spec["seed"] == 2 and label == "wrong 0"
                result |= {f"{label}.noticed": math.inf if late else 20.0, f"{label}.returned": math.inf}
            for label in (x for x in spec["methods"] if x in ("shift 45", "shift 60", "shift 90")):
                result[f"{label}.bad"] = 0.8
        return out

    table = loop.LOOP.compute(Size(8, 40), trials)
    verdicts = {x.id: x for x in loop.LOOP.judge(table)}
    assert verdicts["loop-noticed"].measured == pytest.approx(23 / 24)
    assert verdicts["loop-noticed"].verdict == v.IN_PART
    assert verdicts["loop-false-alarms"].verdict == v.REPRODUCED
    assert verdicts["loop-wrong-lines"].measured == pytest.approx(0.8)
    assert verdicts["loop-fr_p-right"].verdict == v.REPRODUCED
    assert "9 of 9 points" in verdicts["loop-fr_p-not-inferior"].rule


def test_loop_sees_that_wrong_lines_do_harm() -> None:
    rows = [PaperRow("BMCT, false positions", d, (20.0, 21.4)) for d in (10.0, 20.0)]
    idmot = PaperRow("IDMOT, false positions", math.nan, (10.0, 11.5))
    verdict = loop._not_inferior("fr_p", "false positions", idmot, rows)
    assert (verdict.verdict, verdict.measured) == (v.NOT, pytest.approx(9.95))


def test_table1_compares_with_the_local_likelihood() -> None:
    def trials(specs):
        times = {"local_ms": 2.0, "interaction_ms": 0.3, "collaboration_ms": 0.1, "step_ms": 3.0}
        return [{f"bmct.{k}": x * (1 + 0.01 * s["seed"]) for k, x in times.items()} for s in specs]

    table = table1.TABLE1.compute(Size(3, 40), trials)
    assert table[0].extra["share_of_step"] == pytest.approx(2 / 3)
    verdicts = {x.id: x for x in table1.TABLE1.judge(table)}
    assert verdicts["table1-collaboration"].measured == pytest.approx(0.05)
    assert {x.verdict for x in verdicts.values()} == {v.REPRODUCED}


@pytest.mark.jit
def test_frames_of_fig7_are_one_of_each_quarter_for_each_method_and_view() -> None:
    shots = fig7_shots(Size(1, 8))
    assert shots.rows == tuple(f"{m}, view {k}" for m in ("MIPF", "IDMOT", "BMCT") for k in (1, 2))
    assert [len(row) for row in shots.shots] == [4] * 6
    assert [s.title for s in shots.shots[0]] == [s.title for s in shots.shots[5]]
    assert all(len(s.marks) == 6 for row in shots.shots for s in row)
    assert not any(s.lines for row in shots.shots[:4] for s in row)


@pytest.mark.parametrize("experiment", [variants.BALLS, variants.VIEWS])
def test_the_cost_grows_with_targets_and_views_as_a_power(experiment) -> None:
    def rows(power):
        rng = np.random.default_rng(2)
        values = {x: tuple((x**power * rng.uniform(0.95, 1.05, 6)).tolist()) for x in (1.0, 2.0, 3.0, 4.0)}
        return [PaperRow("BMCT, false positions", x, (1.0,) * 6, each={"frame_ms": ms}) for x, ms in values.items()]

    for power, word in ((1.0, v.REPRODUCED), (2.0, v.NOT)):
        found = variants._cost(experiment, rows(power))
        assert (found.id, found.verdict) == (f"{experiment.item}-cost", word)
        assert found.measured == pytest.approx(power, abs=0.1)


def test_two_sweeps_are_compared_with_one_and_with_four() -> None:
    def words(once: float, often: float) -> dict[str, str]:
        def trials(specs):
            share = {1: once, 2: 0.05, 4: often}
            assert [s["methods"]["bmct 4"]["set"] for s in specs] == [{"sweeps": 4}] * len(specs)
            out = []
            for s in specs:
                more = 0.001 * math.sin(s["seed"])
                rates = {f"bmct {n}.{r}": x + n * more for n, x in share.items() for r in ("fr_p", "fr_l")}
                kept = {f"bmct {n}.{f}": 1.0 for n in share for f in ("idf1", "hota", "mota", "frame_ms", "particles")}
                out.append(rates | kept | {f"bmct {n}.{f}": 0.0 for n in share for f in ("left", "lost")})
            return out

        return found(sweeps.SWEEPING.judge(sweeps.SWEEPING.compute(Size(12, 40), trials)))

    assert set(words(0.2, 0.049).values()) == {v.REPRODUCED}
    assert set(words(0.05, 0.01).values()) == {v.NOT}
