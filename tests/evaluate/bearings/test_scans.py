"""Scans are the same wherever a stream of bearings is cut, and so are the figures made of them, in memory or not."""

from __future__ import annotations

import numpy as np
import pytest
from bearing_scenes import hand_made, simulated

from occlog.evaluate.bearings.noise import NoiseFigures, ScanCuts, labelled
from occlog.evaluate.bearings.residuals import TriangulationFigures
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import paths_of, sensors_of
from occlog.records.tables import LAST


@pytest.mark.parametrize("window", [0.0, 0.02, 0.3, 200.0])
@pytest.mark.parametrize("times", [1, 3, 50])
def test_scans_do_not_depend_on_cuts(times: int, window: float) -> None:
    config = EvaluateConfig(triangulation_window_s=window)
    rows = labelled(hand_made(1).bearings, config)
    whole = {s.target: np.split(s.rows.t_ns, s.starts[1:-1]) for s in ScanCuts(config).update(rows, LAST)}
    assert set(whole) == {0, 1}
    assert len(whole[0]) > (1 if window > 1 else 20)
    cuts, found = ScanCuts(config), dict[int, list[np.ndarray]]()
    ends = [*np.unique(rows.t_ns)[::times][1:].tolist(), LAST]
    begin = 0
    for end in ends:
        own = (rows.t_ns >= begin) & ((rows.t_ns < end) | (end == LAST))
        for scans in cuts.update(rows.take(own), end):
            found.setdefault(scans.target, []).extend(np.split(scans.rows.t_ns, scans.starts[1:-1]))
        begin = end
    for target, scans_of in whole.items():
        assert [s.tolist() for s in found[target]] == [s.tolist() for s in scans_of]


def test_figures_of_numbers_in_files_are_those_of_numbers_in_memory() -> None:
    case, config = simulated(4), EvaluateConfig(triangulation_tolerance=0.1)
    noise, meeting = (
        [NoiseFigures(config, n) for n in (20, 10**6)],
        [TriangulationFigures("m", config, n) for n in (20, 10**6)],
    )
    rows, paths = labelled(case.bearings, config), paths_of(case.tracks)
    sensors = sensors_of(case.place, ["a", "b", "c"])
    for scans in ScanCuts(config).update(rows, LAST):
        for one, other in zip(noise, meeting, strict=True):
            one.update(scans, sensors)
            other.update(scans, sensors, paths[scans.target])
    for one in noise:
        one.see(rows)
    assert noise[1].result()["measurement_noise_scans"] > 40
    assert noise[0].result() == pytest.approx(noise[1].result(), rel=1e-12)
    assert 0.0 < meeting[1].result()["triangulation_share_within"] < 1.0
    assert meeting[0].result() == pytest.approx(meeting[1].result(), rel=1e-12)
