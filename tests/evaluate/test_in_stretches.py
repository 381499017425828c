"""Several targets and tracks in stretches of time: figures and tables are those of whole tables, however cut."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tracked_crowds import crowd

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate.errors.on_ground import compare
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import ManyConfig
from occlog.evaluate.mot.on_ground import evaluate_ground
from occlog.evaluate.stage import evaluate
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.declared.views import Counts, Failures
from occlog.records.scene import Scene
from occlog.records.tables import Errors

WAYS: tuple[tuple[EvaluateConfig, ManyConfig, list[str]], ...] = (
    (EvaluateConfig(), ManyConfig(match_distance=1.0, moda_distance=0.5, own="label"), []),
    (
        EvaluateConfig(match="optimal", skip_s=3.0),
        ManyConfig(match_distance=1.0, moda_distance=0.5, own="best", clear_rule="challenge", ospa_window=7),
        ["--match", "optimal", "--skip-seconds", "3", "--clear-rule", "challenge", "--ospa-window", "7"],
    ),
    (
        EvaluateConfig(match="optimal", max_gap_s=1.5),
        ManyConfig(match_distance=0.4, moda_distance=0.5, own="start", gospa_switch=0.2, gospa_p=1.0),
        [
            "--match",
            "optimal",
            "--max-gap",
            "1.5",
            "--match-distance",
            "0.4",
            "--own",
            "start",
            "--gospa-switch",
            "0.2",
            "--gospa-p",
            "1",
        ],
    ),
)


@pytest.mark.parametrize(("seed", "rows"), [(1, 10**6), (2, 23), (3, 1)])
@pytest.mark.parametrize("way", range(len(WAYS)))
def test_the_command_gives_what_whole_tables_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, rows: int, way: int
) -> None:
    config, many, options = WAYS[way]
    tracks, truth = crowd(10 * way + seed)
    whole = evaluate(tracks, truth, None, Scene(length_unit="m"), config)
    ground = evaluate_ground(tracks, truth, many, config.limit_ns)
    wanted = {**ground.metrics, **whole.metrics}
    for name, table in (("tracks", tracks), ("truth", truth)):
        write_table(tmp_path / f"{name}.parquet", table, Provenance("track"))
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", str(tmp_path / "truth.parquet"), *options]
    for name in ("errors", "failures", "counts"):
        args += [f"--{name}", str(tmp_path / f"{name}.parquet")]
    assert run([*args, "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    assert len(wanted) > 80
    assert wanted["id_switches"] > 1 < wanted["fragmentations"]
    assert 0 < wanted["recall"] < 1
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-12, nan_ok=True)
    exact = [n for n in wanted if "median" in n or "p95" in n or "max" in n or n in ("tp", "idtp", "id_switches", "fn")]
    assert len(exact) > 7
    assert {name: found[name] for name in exact} == {name: wanted[name] for name in exact}
    for kind, rows_of in ((Errors, whole.errors), (Failures, ground.failures), (Counts, ground.counts)):
        again = read_table(tmp_path / f"{kind.NAME}.parquet", kind)
        assert len(rows_of)
        for c in kind.columns():
            np.testing.assert_array_equal(getattr(again, c.name), getattr(rows_of, c.name), err_msg=c.name)


def test_pairs_by_distance_are_those_of_whole_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tracks, truth = crowd(5)
    pairs = compare(tracks, truth, EvaluateConfig(match="optimal")).pairs
    assert len(pairs) == 5
    for name, table in (("tracks", tracks), ("truth", truth)):
        write_table(tmp_path / f"{name}.parquet", table, Provenance("track"))
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=11))
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", str(tmp_path / "truth.parquet")]
    assert run([*args, "--match", "optimal", "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    rows = {target: np.count_nonzero(tracks.target_id == track) for track, target in pairs.items()}
    assert all(0 < found[f"estimates_target_{target}"] <= n for target, n in rows.items())
    assert found["tracks_unmatched"] == len(np.unique(tracks.target_id)) - 5
