"""Scans are the same wherever a stream of bearings is cut, and so are the figures made of them, in memory or not."""

from __future__ import annotations

import numpy as np
import pytest
from bearing_scenes import hand_made, simulated

from occlog.evaluate.bearings.meeting import MeetingFigures, meeting_metrics
from occlog.evaluate.bearings.noise import NoiseFigures, noise_metrics
from occlog.evaluate.bearings.scans import ScanCuts, labelled
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import paths_of, sensors_of
from occlog.records.pieces import LAST


@pytest.mark.parametrize("window", [0.0, 0.02, 0.3, 200.0])
@pytest.mark.parametrize("times", [1, 3, 50])
def test_scans_do_not_depend_on_cuts(times: int, window: float) -> None:
    config = EvaluateConfig(lines_window_s=window)
    rows = labelled(hand_made(1).bearings, config)
    whole = {s.target: np.split(s.rows.t_ns, s.starts[1:-1]) for s in ScanCuts(config).add(rows, LAST)}
    assert set(whole) == {0, 1}
    assert len(whole[0]) > (1 if window > 1 else 20)
    cuts, found = ScanCuts(config), dict[int, list[np.ndarray]]()
    ends = [*np.unique(rows.t_ns)[::times][1:].tolist(), LAST]
    begin = 0
    for end in ends:
        own = (rows.t_ns >= begin) & ((rows.t_ns < end) | (end == LAST))
        for scans in cuts.add(rows.take(own), end):
            found.setdefault(scans.target, []).extend(np.split(scans.rows.t_ns, scans.starts[1:-1]))
        begin = end
    for target, scans_of in whole.items():
        assert [s.tolist() for s in found[target]] == [s.tolist() for s in scans_of]


def test_figures_of_numbers_in_files_are_those_of_numbers_in_memory() -> None:
    case, config = simulated(4), EvaluateConfig(lines_limit=0.1)
    noise, meeting = NoiseFigures(config, 20), MeetingFigures("m", config, 20)
    rows, paths = labelled(case.bearings, config), paths_of(case.tracks)
    sensors = sensors_of(case.place, ["a", "b", "c"])
    noise.see(rows)
    cuts = ScanCuts(config)
    for t_ns in np.unique(rows.t_ns).tolist():
        for scans in cuts.add(rows.take(rows.t_ns == t_ns), t_ns + 1):
            noise.add(scans, sensors)
            meeting.add(scans, sensors, paths[scans.target])
    in_memory = noise_metrics(case.bearings, case.place, config)
    assert in_memory["noise_scans"] > 40
    assert noise.metrics() == pytest.approx(in_memory, rel=1e-12)
    assert noise.metrics()["noise_scans"] == in_memory["noise_scans"]
    whole = meeting_metrics(case.tracks, case.bearings, case.place, config)
    assert 0.0 < whole["sight_lines_share_within"] < 1.0
    assert meeting.metrics() == pytest.approx(whole, rel=1e-12)
    for exact in ("max", "p95", "median"):
        assert meeting.metrics()[f"sight_lines_distance_{exact}_m"] == whole[f"sight_lines_distance_{exact}_m"]
