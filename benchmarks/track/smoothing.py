"""What looking back costs: filters with `--smooth` and `--lag` beside themselves without.

`apf` follows a walker among four sharp cameras, `direct3d` and `imm` the recording of `occlog simulate
examples/arrays.yaml --object-height 1.6`.  The program's own loop runs from scans to rows, without files.
"""

from __future__ import annotations

import io
import tempfile
import time
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from benchmarks.track._metric_rooms import record
from benchmarks.track.simulated import ROOT
from occlog.cli.main import run as occlog
from occlog.records.scene import Scene
from occlog.records.tables import Bearings
from occlog.scans.inputs import MeasurementInputs
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask

NAME = "smoothing"
SUMMARY = (
    "processor time of filters that look back, with a lag or at everything, to that of the filters alone: the worst"
)
LIMIT = 2.5
SECONDS = 60
WAYS: Mapping[str, Mapping[str, Any]] = {
    "filter": {},
    "--smooth": {"smooth": True},
    "--lag 2": {"lag_s": 2.0},
}


class Case(NamedTuple):
    """A method and what it is given."""

    method: str
    scene: Scene
    bearings: list[Bearings]


def run(repeats: int = 5) -> dict[str, Any]:
    """The worst ratio of processor times; median over repeats, all ways in turn."""
    parts: dict[str, Any] = {}
    for case in cases():
        for settings in WAYS.values():
            seconds(case, settings)  # compile
        ratios: dict[str, list[float]] = {way: [] for way in WAYS}
        for _ in range(repeats):
            taken = {way: seconds(case, settings) for way, settings in WAYS.items()}
            for way, one in taken.items():
                ratios[way].append(one / taken["filter"])
        parts |= {f"{case.method} {way}": median(r) for way, r in ratios.items() if way != "filter"}
    return {"ratio": max(parts.values()), "limit": LIMIT, "parts": parts}


def cases() -> list[Case]:
    """The methods with their recordings."""
    room = record("walk", focal_px=600.0, sigma_px=3.0, seed=0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "talk.mcap"
        how = ["-o", str(path), "--seconds", str(SECONDS), "--object-height", "1.6", "--seed", "1", "-q"]
        with redirect_stdout(io.StringIO()):
            assert occlog(["simulate", str(ROOT / "examples" / "arrays.yaml"), *how]) == 0
        talk = MeasurementInputs(path, None, None, doa_labels=False, occluders=None)
        heard = list(talk.chunks)
    arrays = [Case(method, talk.scene, heard) for method in ("direct3d", "imm")]
    return [Case("apf", room.scene, [room.bearings]), *arrays]


def seconds(case: Case, settings: Mapping[str, Any]) -> float:
    """Processor time of tracking a recording."""
    config = configure(settings_of(case.method).in_unit("m"), settings)
    begin = time.process_time()
    rows = sum(
        len(part.tracks) for part in track(case.bearings, case.scene, TrackingTask(config, 0, method=case.method))
    )
    taken = time.process_time() - begin
    assert rows
    return taken
