"""Tracks in images in stretches of time: figures and failures are those of whole tables, wherever they are cut."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate.mot.config import ManyConfig
from occlog.evaluate.mot.stage import evaluate_views
from occlog.evaluate.mot.truth_and_tracks import boxes_in_true_frames
from occlog.io import open as opening
from occlog.io.files.parquet import iter_table, read_table, write_table
from occlog.io.files.provenance import Provenance
from occlog.records.tables import Boxes, TruthBoxes
from occlog.records.views import Failures


def rows_of(kind: type[Boxes], rows: list[tuple[int, str, int, int, float, float]]) -> Boxes:
    """Boxes of 40 x 60 px; identity -1: a frame without one."""
    rows = sorted(rows)
    t_ns, sensor, frame, label, left, top = (np.array(column) for column in zip(*rows, strict=True))
    none = label < 0
    size = {name: np.where(none, np.nan, length) for name, length in (("width_px", 40.0), ("height_px", 60.0))}
    place = {"left_px": np.where(none, np.nan, left), "top_px": np.where(none, np.nan, top)}
    more = {"box": np.where(none, -1, label), "confidence": np.full(len(rows), np.nan)}
    more |= {"visible": np.where(none, np.nan, 0.5)} if kind is TruthBoxes else {}
    return kind.of(t_ns=t_ns, sensor=sensor, frame=frame, target_id=label.astype(np.int32), **place, **size, **more)


def views(seed: int) -> tuple[Boxes, TruthBoxes]:
    """Four people in two cameras, and in a third one that no track is in; frames without anybody, other frames."""
    random, true, ours = np.random.default_rng(seed), [], []
    for c, name in enumerate(("a", "b", "c")):
        place, names = random.uniform(0, 250, (4, 2)), np.arange(4)
        for t in range(40):
            place = place + random.normal(0, 6, (4, 2))
            if random.random() < 0.15:
                i, j = random.integers(0, 4, 2)
                names[[i, j]] = names[[j, i]]
            at = 10**8 * t + 1000 * c
            there = [k for k in range(4) if not 10 <= t < 13 and random.random() < 0.9]
            true += [(at, name, t + 3, k, *place[k]) for k in there] or [(at, name, t + 3, -1, 0.0, 0.0)]
            if name != "c":
                near = [k for k in range(4) if random.random() < 0.8]
                ours += [(at, name, t + 3, int(names[k]) + 2, *(place[k] + random.normal(0, 5, 2))) for k in near]
    ours.append((10**10, "a", 200, 3, 1.0, 1.0))
    truth = rows_of(TruthBoxes, true)
    assert isinstance(truth, TruthBoxes)
    return rows_of(Boxes, ours), truth


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
    assert whole.metrics["views_without_tracks"] == whole.metrics["estimates_other_frames"] == 1
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
