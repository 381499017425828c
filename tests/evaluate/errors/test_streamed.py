"""Errors in stretches of time are those of whole tables, however small the stretches are."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from evaluate_scenes import scene

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.evaluate.errors.streamed import CompareStreams, stretches
from occlog.evaluate.errors.survey import survey
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.evaluate.stretches import sources
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.writer import RecordingWriter
from occlog.records.columns import Table
from occlog.records.tables import Errors, Tracks, Truth

T = TypeVar("T", bound=Table)


def both(seed: int) -> tuple[Tracks, Truth]:
    """A track and a truth with other times, gaps of all lengths, unknown heights and singular covariances."""
    random = np.random.default_rng(seed)
    times = [np.cumsum(random.choice([0.02, 0.1, 0.1, 0.1, 0.1, 0.35], n)) for n in (400, 300)]
    t_ns, true_ns = (np.unique((t * NS).astype(np.int64)) for t in times)
    true_ns = np.unique(np.concatenate([true_ns, t_ns[::9]]))
    n, m = len(t_ns), len(true_ns)
    values = {name: random.normal(size=n) for name in ("x", "y", "vx", "vy")}
    values |= {"cov_xx": np.where(random.random(n) < 0.1, 0.0, 1.0), "cov_xy": np.zeros(n), "cov_yy": np.ones(n)}
    values |= {"cov_xz": np.zeros(n), "cov_yz": np.zeros(n), "cov_zz": np.ones(n)}
    z, true_z = random.normal(size=n), np.where(random.random(m) < 0.2, np.nan, 1.0)
    tracks = Tracks.of(t_ns=t_ns, target_id=np.zeros(n, np.int32), z=z, **values)
    person = Truth.of(
        t_ns=true_ns,
        target_id=np.zeros(m, np.int32),
        role=np.full(m, "target"),
        x=np.sin(true_ns / NS),
        y=z[:m],
        z=true_z,
    )
    pillar = Truth.of(t_ns=true_ns, target_id=np.full(m, 9), role=np.full(m, "occluder"), x=z[:m], y=z[:m], z=true_z)
    return tracks, Truth.merge([person, pillar])


def chunks(table: T, rows: int) -> Iterator[T]:
    for start in range(0, len(table), rows):
        yield table.take(slice(start, start + rows))


def compare_streams(
    sides: tuple[Tracks, Truth], rows: int, config: EvaluateConfig, take: Callable[[Errors], None]
) -> tuple[dict[str, float], str | None]:
    """Figures of one track and one target in chunks of so many rows, and what is said of gaps."""

    def streams() -> tuple[Iterator[Tracks], Iterator[Truth]]:
        return chunks(sides[0], rows), chunks(sides[1], rows + 1)

    known = survey(*streams(), in_memory=50)
    assert known.single == (0, 0)
    found = CompareStreams(known, {0: 0}, config, "m", in_memory=50)
    for part in stretches(*streams(), known, config):
        take(found.add(part))
    return {**found.metrics(), **found.settled()}, found.note


@pytest.mark.parametrize("config", [EvaluateConfig(), EvaluateConfig(max_gap_s=3.0), EvaluateConfig(skip_s=7.0)])
@pytest.mark.parametrize("rows", [10**6, 50, 3])
def test_stretches_give_what_whole_tables_give(config: EvaluateConfig, rows: int) -> None:
    tracks, truth = both(3)
    whole = evaluate(tracks, truth, None, scene(), config)
    parts: list[Errors] = []
    metrics, note = compare_streams((tracks, truth), rows, config, parts.append)
    assert 50 < metrics["estimates"] < len(tracks)
    assert metrics["estimates_without_truth"] > 0 < metrics["nees_singular"]
    assert 0 < metrics["estimates_space"] < metrics["estimates"]
    assert ("settled_rmse_m" in metrics) == (config.skip_s > 0)
    assert metrics == pytest.approx(whole.metrics, rel=1e-12, nan_ok=True)
    for exact in ("error_median_m", "error_p95_m", "error_max_m", "time_coverage", "error_space_p95_m"):
        assert metrics[exact] == whole.metrics[exact]
    assert (note,) == (whole.notes or (None,))
    errors = Errors.concat(parts)
    for c in Errors.columns():
        np.testing.assert_array_equal(getattr(errors, c.name), getattr(whole.errors, c.name), err_msg=c.name)


def test_of_truth_elsewhere_in_time_the_message_is_that_of_whole_tables() -> None:
    tracks, truth = both(3)
    late = Truth(**{c.name: getattr(truth, c.name) for c in Truth.columns()} | {"t_ns": truth.t_ns + 10**15})
    with pytest.raises(InputError) as whole:
        evaluate(tracks, late, None, scene())
    with pytest.raises(InputError) as streamed:
        compare_streams((tracks, late), 10**6, EvaluateConfig(), lambda _: None)
    assert str(streamed.value) == str(whole.value)


def test_the_command_gives_the_same_with_small_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, table in zip(("tracks", "truth"), both(4), strict=True):
        write_table(tmp_path / f"{name}.parquet", table, Provenance("track"))
    made = []
    for rows in (10**6, 7):
        monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
        args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", str(tmp_path / "truth.parquet"), "--overwrite"]
        args += ["-o", str(tmp_path / "m.json"), "--errors", str(tmp_path / "errors.parquet")]
        assert run(args) == ExitCode.DONE
        values = json.loads((tmp_path / "m.json").read_text())
        made.append((values, (tmp_path / "errors.parquet").read_bytes()))
    (one, errors), (many, again) = made
    assert errors == again
    assert {k: v for k, v in one.items() if not isinstance(v, float)} == {
        k: v for k, v in many.items() if not isinstance(v, float)
    }
    floats = {k: v for k, v in one.items() if isinstance(v, float)}
    assert len(floats) > 20
    assert {k: many[k] for k in floats} == pytest.approx(floats, rel=1e-12)


@pytest.mark.parametrize("long", [10, 10**6])
def test_truth_in_a_recording_gives_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, long: int) -> None:
    monkeypatch.setattr(sources, "LONG", long)
    tracks, truth = both(4)
    write_table(tmp_path / "tracks.parquet", tracks, Provenance("track"))
    with RecordingWriter(tmp_path / "truth.mcap", scene(), Provenance("ingest")) as out:
        out.table(truth)
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", str(tmp_path / "truth.mcap")]
    assert run([*args, "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    whole = evaluate(tracks, truth, None, scene()).metrics
    assert {name: found[name] for name in whole} == pytest.approx(whole, rel=1e-12)


def test_an_error_leaves_no_table_of_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=7))
    tracks, truth = both(4)
    late = Truth(**{c.name: getattr(truth, c.name) for c in Truth.columns()} | {"t_ns": truth.t_ns + 10**15})
    write_table(tmp_path / "tracks.parquet", tracks, Provenance("track"))
    write_table(tmp_path / "truth.parquet", late, Provenance("track"))
    before = sorted(tmp_path.iterdir())
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", str(tmp_path / "truth.parquet")]
    assert run([*args, "--errors", str(tmp_path / "errors.parquet")]) == ExitCode.BAD_INPUT
    assert sorted(tmp_path.iterdir()) == before
