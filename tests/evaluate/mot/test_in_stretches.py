"""Tracks in images in stretches of time: figures and failures are those of whole tables, wherever they are cut."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tracked_crowds import views

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate.mot.config import ManyConfig
from occlog.evaluate.mot.stage import evaluate_views
from occlog.evaluate.mot.truth_and_tracks import boxes_in_true_frames
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.declared.views import Failures
from occlog.records.tables import Boxes


@pytest.mark.jit
@pytest.mark.parametrize("rows", [10**6, 9, 1])
@pytest.mark.parametrize(
    ("config", "options"),
    [
        (ManyConfig(own="start"), []),
        (
            ManyConfig(own="best", clear_rule="challenge", gospa_px=30.0),
            ["--own", "best", "--clear-rule", "challenge", "--gospa-px", "30"],
        ),
        (ManyConfig(own="start", frames=(5, 38)), ["--frames", "5:38"]),
        (ManyConfig(own="start", frames=(2, 40), cameras=("b",)), ["--frames", "2:40", "--camera", "b"]),
    ],
)
def test_the_command_gives_what_whole_tables_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int, config: ManyConfig, options: list[str]
) -> None:
    tracks, truth = views(rows % 7)
    whole = evaluate_views(boxes_in_true_frames(tracks, truth, config), config)
    for name, table in (("tracks", tracks), ("truth", truth)):
        write_table(tmp_path / f"{name}.parquet", table, Provenance("track"))
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", str(tmp_path / "truth.parquet"), *options]
    args += ["--failures", str(tmp_path / "failures.parquet"), "-o", str(tmp_path / "m.json")]
    assert run(args) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    assert whole.metrics["id_switches"] > 1 < whole.metrics["fragmentations"]
    assert whole.metrics["views_without_tracks"] == (not config.cameras)
    assert whole.metrics["estimates_other_frames"] == (config.frames is None)
    assert {name: found[name] for name in whole.metrics} == pytest.approx(whole.metrics, rel=1e-12, nan_ok=True)
    failures = read_table(tmp_path / "failures.parquet", Failures)
    assert len(whole.failures) > 50
    for c in Failures.columns():
        np.testing.assert_array_equal(getattr(failures, c.name), getattr(whole.failures, c.name), err_msg=c.name)


def test_an_identity_twice_in_a_frame_is_refused_as_in_whole_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tracks, truth = views(1)
    twice = Boxes.merge([tracks, tracks.take(slice(70, 71))])
    twice = Boxes(
        **{c.name: getattr(twice, c.name) for c in Boxes.columns()} | {"box": np.arange(len(twice), dtype=np.int32)}
    )
    said = []
    for rows in (10**6, 4):
        for name, table in (("tracks", twice), ("truth", truth)):
            write_table(tmp_path / f"{name}.parquet", table, Provenance("track"), overwrite=True)
        monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
        args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", str(tmp_path / "truth.parquet")]
        assert run([*args, "--failures", str(tmp_path / "failures.parquet")]) == ExitCode.BAD_INPUT
        said.append(capsys.readouterr().err)
        assert not (tmp_path / "failures.parquet").exists()
    assert said[0] == said[1]
    assert "twice" in said[0]
