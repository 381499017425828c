"""Several recordings in pieces: figures are those of whole tables in which they follow one another, however cut."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from tracked_crowds import crowd, views

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate.mot.config import ManyConfig
from occlog.evaluate.mot.on_ground import evaluate_ground
from occlog.evaluate.mot.stage import evaluate_views
from occlog.evaluate.mot.truth_and_tracks import boxes_in_true_frames
from occlog.evaluate.several.run import NOT_COMBINED
from occlog.evaluate.stretches import sources
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.writer import RecordingWriter
from occlog.records.columns import Table
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Tracks, Truth, TruthBoxes

T = TypeVar("T", bound=Table)
MADE = Provenance("track")
APART = 3600 * NS
"""Time between recordings that follow one another; no gap is bridged over it."""


def later(table: T, number: int) -> T:
    """A recording after so many others, with identities and cameras of its own."""
    changed = {
        "t_ns": table.t_ns + number * APART,  # type: ignore[attr-defined]
        "target_id": np.where(table.target_id < 0, -1, table.target_id + 1000 * number).astype(np.int32),  # type: ignore[attr-defined]
    }
    if isinstance(table, Boxes):
        changed["sensor"] = np.array([f"{number} {name}" for name in table.sensor])
    return type(table)(**{c.name: getattr(table, c.name) for c in table.columns()} | changed)


def figures(args: list[str], output: Path) -> dict[str, float]:
    """By the command."""
    assert run(["evaluate", *args, "-o", str(output), "-q", "--overwrite"]) == ExitCode.DONE
    found = json.loads(output.read_text())
    return {name: np.nan if value is None else value for name, value in found.items() if name != "_provenance"}


def written(folder: Path, sides: Sequence[tuple[Table, Table]]) -> list[tuple[Path, Path]]:
    """Tracks and truth of each recording, written to a folder."""
    paths = []
    for n, side in enumerate(sides):
        paths.append((folder / f"r{n}.parquet", folder / f"truth{n}.parquet"))
        for path, table in zip(paths[n], side, strict=True):
            write_table(path, table, MADE)
    return paths


def beside(paths: list[tuple[Path, Path]]) -> list[str]:
    """Arguments that name recordings."""
    (tracks, truth), *more = paths
    return [str(tracks), "--truth", str(truth), *(str(a) for pair in more for a in ("--also", *pair))]


def check(found: dict[str, float], whole: dict[str, float], each: list[dict[str, float]]) -> None:
    """Counts and quantiles to the last digit, sums up to rounding; nothing else is given."""
    wanted = {n: v for n, v in whole.items() if not n.startswith(NOT_COMBINED) and "_sensor_" not in n}
    wanted |= {f"{name}_recording_r{k}": value for k, one in enumerate(each) for name, value in one.items()}
    assert set(found) == set(wanted)
    assert found == pytest.approx(wanted, rel=1e-12, nan_ok=True)
    exact = [n for n, v in wanted.items() if float(v).is_integer() or "median" in n or "p95" in n]
    assert len(exact) > 50
    assert {n: found[n] for n in exact} == {n: wanted[n] for n in exact}


@pytest.mark.jit
@pytest.mark.parametrize("rows", [10**6, 23, 1])
@pytest.mark.parametrize("recorded", [False, True])
def test_on_the_ground(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int, recorded: bool) -> None:
    sides = [crowd(seed, people, 60) for seed, people in ((rows % 5, 4), (7, 3), (8, 5))]
    config = ManyConfig(match_distance=1.0, moda_distance=0.5, own="best", ospa_window=7)
    joined = (table.concat([later(one[k], n) for n, one in enumerate(sides)]) for k, table in ((0, Tracks), (1, Truth)))
    whole = evaluate_ground(*joined, config, None).metrics
    each = [evaluate_ground(*one, config, None).metrics for one in sides]
    assert whole["id_switches"] > 5 < whole["fragmentations"]
    paths = []
    for n, (tracks, truth) in enumerate(sides):
        paths.append((tmp_path / f"r{n}.parquet", tmp_path / f"truth{n}.{'mcap' if recorded else 'parquet'}"))
        write_table(paths[n][0], tracks, MADE)
        if not recorded:
            write_table(paths[n][1], truth, MADE)
            continue
        with RecordingWriter(paths[n][1], Scene(), MADE) as writer:
            writer.table(truth)
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    monkeypatch.setattr(sources, "LONG", 10**6 if rows == 1 else 10)
    args = [*beside(paths), "--match", "optimal", "--ospa-window", "7", "--match-distance", "1"]
    check(figures(args, tmp_path / "m.json"), whole, each)


@pytest.mark.parametrize("rows", [10**6, 5])
def test_some_frames_and_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    """Of an empty truth frames are times of the tracks."""
    sides = [crowd(1, 3, 70), (crowd(2, 3, 70)[0], Truth.empty())]
    config = ManyConfig(match_distance=1.0, moda_distance=0.5)
    some = []
    for tracks, truth in sides:
        times = np.unique(truth.t_ns if len(truth) else tracks.t_ns)
        keep = ((t.t_ns >= times[4]) & (t.t_ns < times[25]) for t in (tracks, truth))
        some.append(tuple(table.take(k) for table, k in zip((tracks, truth), keep, strict=True)))
    each = [evaluate_ground(*one, config, None).metrics for one in some]
    paths = written(tmp_path, sides)
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    found = figures([*beside(paths), "--frames", "4:25"], tmp_path / "m.json")
    own = {f"{name}_recording_r{k}": value for k, one in enumerate(each) for name, value in one.items()}
    assert {name: found[name] for name in own} == pytest.approx(own, rel=1e-12, nan_ok=True)
    assert found["frames"] == 42
    assert each[1]["fp"] > 20 < each[0]["tp"]
    for name in ("fp", "fn", "tp", "objects"):
        assert found[name] == each[0][name] + each[1][name]


@pytest.mark.jit
@pytest.mark.parametrize("rows", [10**6, 9, 1])
def test_in_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    sides = [views(seed) for seed in (rows % 7, 3)]
    config = ManyConfig(own="best", gospa_px=30.0)
    joined = [
        table.concat([later(one[k], n) for n, one in enumerate(sides)]) for k, table in ((0, Boxes), (1, TruthBoxes))
    ]
    whole = evaluate_views(boxes_in_true_frames(joined[0], joined[1], config), config).metrics
    each = [evaluate_views(boxes_in_true_frames(*one, config), config).metrics for one in sides]
    assert whole["id_switches"] > 2 < whole["fragmentations"]
    paths = written(tmp_path, sides)
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    check(figures([*beside(paths), "--own", "best", "--gospa-px", "30"], tmp_path / "m.json"), whole, each)
