"""The division of tables into chunks changes no figure, no table and no finding."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pytest
from bearing_scenes import CASES, Case, hand_made, simulated
from tracked_crowds import crowd, views
from views_and_boxes import seen

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.stage import ComparedBoxes
from occlog.evaluate.results import Evaluation
from occlog.evaluate.sources import EvaluationSources, MeasuredSource
from occlog.evaluate.stage import Evaluator
from occlog.evaluate.verdict import TrackProvenance, in_rows_of
from occlog.records.columns import ColumnTable
from occlog.records.declared.sensors import Measurements
from occlog.records.declared.views import Failures
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Cooperation, Truth, TruthBoxes, windows
from occlog.scans.config import DistanceMeasurementConfig

T = TypeVar("T", bound=ColumnTable)
WHOLE = 10**6
MANY = (
    MultiTargetConfig(match_distance=1.0, moda_distance=0.5, assigned_target="id"),
    MultiTargetConfig(
        match_distance=1.0, moda_distance=0.5, assigned_target="optimal", clear_rule="challenge", ospa_window=7
    ),
    MultiTargetConfig(
        match_distance=0.4, moda_distance=0.5, assigned_target="start", gospa_switch_penalty=0.2, gospa_p=1.0
    ),
)
WAYS = (
    EvaluateConfig(),
    EvaluateConfig(
        match="optimal",
        settling_s=2.0,
        triangulation_window_s=0.05,
        triangulation_tolerance=0.5,
        motion="cv",
        occluder_diameter=0.6,
    ),
    EvaluateConfig(match="optimal", max_gap_s=1.5, gate_px=5.0, bound_dimension="ground"),
)


def chunks(table: T, rows: int) -> Callable[[], Iterator[T]]:
    """A table in chunks of so many rows."""
    return lambda: (table.take(slice(start, start + rows)) for start in range(0, len(table), rows))


def evaluated(
    rows: int,
    made_scene: Scene,
    config: EvaluateConfig,
    many: MultiTargetConfig | None = None,
    made: TrackProvenance | None = None,
    **of: Any,
) -> tuple[Evaluation, dict[str, ColumnTable]]:
    """The evaluation of tables in chunks of about so many rows, and its tables."""
    given: dict[str, Any] = {name: chunks(table, rows + k) for k, (name, table) in enumerate(of.items())}
    if "measured" in of:
        given["measured"] = MeasuredSource(
            given["measured"], DistanceMeasurementConfig(tag_height=0.5, rssi_power=-40.0), None
        )
    parts: dict[type[ColumnTable], list[Any]] = {}
    sources = EvaluationSources(**given, made=made or TrackProvenance())
    result = Evaluator(sources, made_scene, config).run(
        lambda part: parts.setdefault(type(part), []).append(part), many
    )
    return result, {kind.NAME: kind.concat(found) for kind, found in parts.items()}


def same(a: tuple[Evaluation, dict[str, ColumnTable]], b: tuple[Evaluation, dict[str, ColumnTable]]) -> None:
    """Counts, quantiles and tables to the last digit, sums up to rounding, in the same order."""
    (one, tables), (two, others) = a, b
    assert list(one.metrics) == list(two.metrics)
    assert one.metrics == pytest.approx(two.metrics, rel=1e-10, abs=1e-13, nan_ok=True)
    exact = [n for n, v in two.metrics.items() if float(v).is_integer() or "median" in n or "p95" in n or "_max" in n]
    assert {n: one.metrics[n] for n in exact} == pytest.approx({n: two.metrics[n] for n in exact}, rel=0, nan_ok=True)
    assert one.notes == two.notes
    assert [(c.name, c.status, c.id) for c in one.checks or ()] == [(c.name, c.status, c.id) for c in two.checks or ()]
    for name, table in tables.items():
        for c in table.columns():
            ours, theirs = getattr(table, c.name), getattr(others[name], c.name)
            if name == "bound" and c.kind == "f8":
                np.testing.assert_allclose(ours, theirs, rtol=1e-12, err_msg=c.name)
            else:
                np.testing.assert_array_equal(ours, theirs, err_msg=c.name)


@pytest.mark.parametrize(
    ("what", "way", "rows"), [*((what, n % 3, 29) for n, what in enumerate(CASES)), ("hand-made", 1, 13)]
)
def test_of_tracks_truth_bearings_and_diagnostics(what: str, way: int, rows: int) -> None:
    case, made = CASES[what](way), TrackProvenance(window_ns=40_000_000, sensors=frozenset({"a", "b", "c", "ear"}))
    of = {"tracks": case.tracks, "truth": case.truth, "bearings": case.bearings, "diagnostics": case.diagnostics}
    whole = evaluated(WHOLE, case.place, WAYS[way], made=made, **of)
    assert len(whole[1]["bound"]) > 20 < len(whole[1]["errors"])
    assert 0 < whole[0].metrics["detected"] < whole[0].metrics["detection_opportunities"]
    same(evaluated(rows, case.place, WAYS[way], made=made, **of), whole)


@pytest.mark.parametrize("given", [("tracks", "bearings"), ("truth", "bearings")])
def test_of_tracks_or_a_truth_alone(given: tuple[str, ...]) -> None:
    case, config = simulated(5), EvaluateConfig(triangulation_window_s=0.05)
    of = {name: getattr(case, name) for name in given}
    whole = evaluated(WHOLE, case.place, config, **of)
    assert len(whole[0].metrics) > 10
    same(evaluated(29, case.place, config, **of), whole)


@pytest.mark.parametrize(("way", "rows"), [(0, 1), (1, 23), (2, 23)])
def test_of_many_targets(way: int, rows: int) -> None:
    tracks, truth = crowd(10 * way + rows, moments=60)
    of = {"tracks": tracks, "truth": truth}
    whole = evaluated(WHOLE, Scene(), WAYS[way], MANY[way], **of)
    assert whole[0].metrics["id_switches"] > 1 < whole[0].metrics["fragmentations"]
    assert len(whole[1]["failures"]) > 5 < len(whole[1]["counts"])
    same(evaluated(rows, Scene(), WAYS[way], MANY[way], **of), whole)


def test_of_a_truth_in_which_no_target_is_there() -> None:
    of = {"tracks": crowd(2, 3, 70)[0], "truth": Truth.empty()}
    whole = evaluated(WHOLE, Scene(), EvaluateConfig(), MANY[0], **of)
    assert whole[0].metrics["fp"] >= len(of["tracks"])
    same(evaluated(5, Scene(), EvaluateConfig(), MANY[0], **of), whole)


def test_of_sensors_that_are_held_out() -> None:
    case, config = simulated(4), EvaluateConfig(held_out=("a",))
    of = {"tracks": case.tracks, "bearings": case.bearings}
    whole = evaluated(WHOLE, case.place, config, **of)
    assert whole[0].metrics["held_out_frames"] > 10
    same(evaluated(11, case.place, config, **of), whole)


def test_of_measurements_of_distances() -> None:
    case, config = simulated(3), EvaluateConfig(match="optimal", settling_s=2.0)
    of = {"tracks": case.tracks, "truth": case.truth, "bearings": case.bearings, "measured": ranges(case)}
    whole = evaluated(WHOLE, case.place, config, **of)
    assert len(whole[1]["bound"]) > 20
    same(evaluated(13, case.place, config, **of), whole)


def ranges(case: Case) -> Measurements:
    """Ranges of every true position from each camera."""
    true, random = case.truth.take(case.truth.role == "target"), np.random.default_rng(1)
    parts = []
    for camera in case.place.cameras:
        far = np.hypot(true.x - camera.ground[0], true.y - camera.ground[1]) + random.normal(0, 0.1, len(true))
        nan, sure = np.full(len(true), np.nan), np.full(len(true), 0.1)
        others = dict.fromkeys(("rssi", "range_difference", "sigma_rssi", "sigma_range_difference"), nan)
        key = {"t_ns": true.t_ns, "target_id": true.target_id, "sensor": np.full(len(true), camera.name)}
        parts.append(Measurements.of(**key, reference=np.full(len(true), ""), range=far, sigma_range=sure, **others))
    return Measurements.merge(parts)


@pytest.mark.parametrize("rows", [1, 13])
def test_of_views(rows: int) -> None:
    found, boxes = seen(rows)
    config, of = EvaluateConfig(iou_threshold=0.4), {"views": found, "truth_boxes": boxes}
    whole = evaluated(WHOLE, Scene(), config, **of)
    assert 0.3 < whole[0].metrics["views_recall"] < 0.95
    assert whole[0].metrics["views_true_boxes_hidden"] > 5 < whole[0].metrics["views_frames_sensor_left"]
    same(evaluated(rows, Scene(), config, **of), whole)


def test_of_requests_of_cameras() -> None:
    case, random = simulated(1), np.random.default_rng(1)
    times = np.sort(random.choice(np.unique(case.tracks.t_ns), 30))
    answered = random.random(30) < 0.7
    values = {c.name: np.zeros(30, c.dtype) for c in Cooperation.columns() if not c.optional and c.kind != "U"}
    values |= {c.name: np.full(30, "a") for c in Cooperation.columns() if not c.optional and c.kind == "U"}
    values |= {"t_ns": times, "cause": random.choice(["spread", "spread,count", "shared", "other"], 30)}
    values |= {"frames": random.integers(0, 4, 30).astype(values["frames"].dtype), "answered": answered}
    values |= {name: np.where(answered, 1.0, np.nan) for name in ("x", "y")}
    of = {"tracks": case.tracks, "truth": case.truth, "cooperation": Cooperation.of(**values)}
    whole = evaluated(WHOLE, case.place, EvaluateConfig(), **of)
    assert whole[0].metrics["cooperation_requests_spread"] > 2 < whole[0].metrics["cooperation_shared"]
    same(evaluated(7, case.place, EvaluateConfig(), **of), whole)


@pytest.mark.jit
@pytest.mark.parametrize(
    ("config", "rows"),
    [
        (MultiTargetConfig(assigned_target="start"), 3),
        (MultiTargetConfig(assigned_target="optimal", clear_rule="challenge", gospa_px=30.0), 9),
        (MultiTargetConfig(assigned_target="start", frames=(2, 40), cameras=("b",)), 9),
    ],
)
def test_of_tracks_in_images(config: MultiTargetConfig, rows: int) -> None:
    tracks, truth = views(rows % 7)

    def of(rows: int) -> tuple[Evaluation, dict[str, ColumnTable]]:
        def sides() -> Iterator[tuple[Boxes, TruthBoxes]]:
            for part in windows(chunks(tracks, rows)(), chunks(truth, rows + 1)(), (Boxes, TruthBoxes), 0):
                yield part.a, part.b

        failures: list[Failures] = []
        result = ComparedBoxes(sides, config).evaluate(failures.append)
        return result, {"failures": Failures.concat(failures)}

    whole = of(WHOLE)
    assert whole[0].metrics["id_switches"] > 1 < whole[0].metrics["fragmentations"]
    assert len(whole[1]["failures"]) > 50
    same(of(rows), whole)


def test_frames_are_times_of_the_truth() -> None:
    case = hand_made(3)
    times = np.unique(case.truth.t_ns[case.truth.role == "target"])
    of = {"tracks": case.tracks, "truth": case.truth, "bearings": case.bearings}
    part = {n: t.take((t.t_ns >= times[10]) & (t.t_ns < times[45])) for n, t in of.items()}
    given: dict[str, Any] = {name: chunks(table, 11) for name, table in of.items()}
    sources = EvaluationSources(**given).in_frames((10, 45))
    found = Evaluator(sources, case.place, EvaluateConfig()).run(lambda _: None)
    whole, _ = evaluated(WHOLE, case.place, EvaluateConfig(), **part)
    assert found.metrics == pytest.approx(whole.metrics, rel=1e-10, abs=1e-13, nan_ok=True)
    with pytest.raises(InputError, match=f"frames {len(times)}:99: there are {len(times)} of them"):
        EvaluationSources(**given).in_frames((len(times), 99))


def test_fewer_diagnostics_than_tracks_are_refused() -> None:
    case = CASES["simulated"](1)
    with pytest.raises(InputError, match="fewer rows"):
        list(in_rows_of([case.tracks], [case.diagnostics.take(slice(1, None))]))


def test_an_error_in_time_is_reported_of_the_whole() -> None:
    case = simulated(1)
    late = replace(case.truth, t_ns=case.truth.t_ns + 10**9 * NS)
    with pytest.raises(InputError, match="the truth covers the time of no estimate") as raised:
        evaluated(WHOLE, case.place, EvaluateConfig(match="optimal"), tracks=case.tracks, truth=late)
    with pytest.raises(InputError) as again:
        evaluated(7, case.place, EvaluateConfig(match="optimal"), tracks=case.tracks, truth=late)
    assert str(again.value) == str(raised.value)
