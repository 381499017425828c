"""The experiments on staged videos: verdicts of made-up trials."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.papers import verdicts as v
from occlog.papers.qu.experiments import decoys, mechanisms, rooms, unseen
from occlog.papers.qu.rooms import rooms_spec, run_rooms_trial
from occlog.papers.qu.staged import staged_paths
from occlog.papers.verdicts import Size
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras


def words(experiment, results) -> dict[str, str]:
    table = experiment.compute(Size(24, 40), lambda specs: [results(spec) for spec in specs])
    return {x.id: x.verdict for x in experiment.judge(table)}


def spread(spec) -> float:
    return 0.1 * math.sin(spec["seed"])


def test_mechanisms_need_failures_that_the_controls_do_not_have() -> None:
    def results(spec):
        bad = spec["scene"] in ("together", "overtaking", "falling-back", "row-overtaking", "row-falling-back")
        out = {}
        for m in mechanisms.SHOWN:
            off = 0.5 + spread(spec) if bad and (m != "bmct" or "row" in spec["scene"]) else 0.0
            none = 0.3 * off if spec["balls"]["background_clutter"] else 0.0
            out |= {f"{m}.pair_end_own": 1.0 - off, f"{m}.pair_end_other": off - none, f"{m}.pair_end_none": none}
        return out

    found = words(mechanisms.MECHANISMS, results)
    assert found.pop("fig7-row-bmct") == v.NOT
    assert set(found.values()) == {v.REPRODUCED}
    assert len(found) == 2 * 3 + 2
    assert set(words(mechanisms.MECHANISMS, lambda spec: results({**spec, "scene": "opposite"})).values()) <= {
        v.NOT,
        v.UNDECIDED,
    }


def test_cmct_is_judged_against_others_off_the_line_and_against_bmct() -> None:
    def results(spec):
        on = spec["scene"] == "decoys-on-line"
        share = {"CMCT": 0.8, "CMCT, 30 px along the line": 0.5, "BMCT": 0.1}
        return {
            f"{label}.diverted_{end}": (x + spread(spec)) * on
            for label, x in share.items()
            for end in ("end_other", "end_none")
        }

    found = words(decoys.DECOYS, results)
    assert set(found.values()) == {v.REPRODUCED}
    assert len(found) == 6


def test_a_tracker_is_led_astray_to_the_bare_wall_inside_the_image() -> None:
    specs = []

    def results(given):
        specs.extend(given)
        ends = ("diverted_end_other", "diverted_end_none")
        return [{f"{label}.{end}": 0.0 for label in decoys.METHODS for end in ends} for _ in given]

    decoys.DECOYS.compute(Size(5, 100), results)
    assert [spec["scene"] for spec in specs] == [scene for scene in decoys.SCENES for _ in range(5)]
    for spec in specs:
        diverted = spec["methods"]["CMCT"]["diverted"]
        config = BallsConfig(frames=100, balls=4)
        balls = ball_cameras(config)[0].project(staged_paths(config, spec["seed"], spec["scene"]).centres[10])
        away = np.linalg.norm(balls - [diverted["x"], diverted["y"]], axis=1)
        assert diverted["frame"] == 10
        assert 0 < diverted["x"] < 320
        assert 0 < diverted["y"] < 240
        assert away.min() > 2.0 * 22.0
        assert away.argmin() != 0


def test_unseen_targets_are_compared_with_seen_ones_and_with_a_third_camera() -> None:
    def results(spec):
        hidden = "unseen" in spec
        off = {"IDMOT": 0.3, "BMCT": 0.3 if hidden else 0.05, "BMCT, three cameras": 0.05}
        out = {f"{label}.pair_end_own": 1.0 - x - spread(spec) * x for label, x in off.items()}
        return out | {f"{label}.unseen_helped": 0.0 if hidden else 0.4 for label in off}

    assert words(unseen.UNSEEN_COUNTERPARTS, results) == {
        "unseen-idmot": v.REPRODUCED,
        "unseen-fails": v.REPRODUCED,
        "unseen-cameras": v.REPRODUCED,
    }


@pytest.mark.parametrize("helped", [0.0, 1e-3])
def test_no_frame_at_all_may_be_helped_without_a_counterpart(helped) -> None:
    def results(spec):
        return {f"{label}.{k}": helped for label in unseen.RUNNERS for k in ("pair_end_own", "unseen_helped")}

    assert words(unseen.UNSEEN_COUNTERPARTS, results)["unseen-idmot"] == (v.NOT if helped else v.REPRODUCED)


@pytest.mark.parametrize("experiment", rooms.ROOMS)
def test_rooms_are_judged_by_their_rates_and_against_other_settings(experiment) -> None:
    def results(spec):
        assert spec["people"]["frames"] == 40
        assert spec["grey"] == (experiment.item == "hall")
        out = {}
        for label in spec["methods"]:
            rate = (0.02 if label == rooms.BMCT else 0.2) * (1.0 + spread(spec))
            out |= {f"{label}.{k}": rate for k in ("fr_p", "fr_l", "off_0", "off_1")}
            out |= {f"{label}.{k}": 0.0 for k in ("idf1", "lost", "left")}
        return out

    found = words(experiment, results)
    assert set(found.values()) == {v.REPRODUCED}
    assert len(found) == {"hall": 6, "living-room": 4, "campus": 5}[experiment.item]


@pytest.mark.jit
def test_a_room_is_rendered_tracked_and_scored() -> None:
    methods = {"b": {"method": "bmct", "set": {"anchor": "bottom"}}}
    found = run_rooms_trial(rooms_spec(1, methods, {"people": 2, "views": 2, "frames": 4}, fps=15.0, grey=True))
    assert (found["b.fr_p"], found["b.fr_l"], found["b.off_1"], found["b.lost"]) == (0.0, 0.0, 0.0, 0.0)
