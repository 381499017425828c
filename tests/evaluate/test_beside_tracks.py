"""Views against true boxes, and requests of cameras, by the command: pieces give what whole tables give."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bearing_scenes import simulated

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate import run as running
from occlog.evaluate.bearings.boxes import ViewFigures, view_metrics
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import cooperation_figures
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.scenes.scene import scene_to_yaml
from occlog.records.tables import APPEARANCE_BINS, Cooperation, TruthBoxes, Views

MADE = Provenance("detect")


def seen(seed: int, moments: int = 40) -> tuple[Views, TruthBoxes]:
    """Boxes of people in two cameras who hide one another, views of most of them and of nothing, and empty frames."""
    random = np.random.default_rng(seed)
    true, views = [TruthBoxes.empty()], [Views.empty()]
    for t in range(moments):
        for sensor in ("left", "right"):
            n = int(random.integers(0, 5))
            box = np.column_stack([random.uniform(0, 100, (n, 2)), random.uniform(20, 40, (n, 2))])
            place = dict(zip(("left_px", "top_px", "width_px", "height_px"), box.T, strict=True))
            nobody = {name: np.full(max(n, 1), np.nan) for name in place}
            at = {"t_ns": np.full(max(n, 1), t * 10**8), "sensor": np.full(max(n, 1), sensor)}
            at |= {"frame": np.full(max(n, 1), t)}
            true.append(
                TruthBoxes.of(
                    **at,
                    box=np.arange(n, dtype=np.int32) if n else np.array([-1], np.int32),
                    target_id=np.arange(max(n, 1), dtype=np.int32),
                    confidence=np.full(max(n, 1), np.nan),
                    **(place if n else nobody),
                )
            )
            found = box[random.random(n) < 0.8] + random.normal(0, 2, (1, 4))
            found = np.vstack([found, random.uniform(20, 60, (int(random.integers(0, 2)), 4))])
            m = len(found)
            nan = {c.name: np.full(m, np.nan) for c in Views.columns() if c.kind == "f8" and not c.optional}
            views.append(
                Views.of(
                    **nan
                    | {name: found[:, k] for k, name in enumerate(place)}
                    | {"x_px": found[:, 0] + found[:, 2] / 2, "y_px": found[:, 1], "area_px": found[:, 2] * found[:, 3]}
                    | {"cov_xx_px": np.ones(m), "cov_xy_px": np.zeros(m), "cov_yy_px": np.ones(m)},
                    t_ns=np.full(m, t * 10**8),
                    sensor=np.full(m, sensor),
                    frame=np.full(m, t),
                    cluster=np.arange(m, dtype=np.int32),
                    target_id=np.full(m, -1, dtype=np.int32),
                    appearance=np.full((m, APPEARANCE_BINS), np.nan, dtype=np.float32),
                )
            )
    return Views.concat(views), TruthBoxes.concat(true)


@pytest.mark.parametrize("rows", [1, 13, 17, 10**6])
def test_views_in_pieces_have_the_figures_of_whole_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    views, boxes = seen(rows)
    whole = view_metrics(views, boxes, EvaluateConfig(box_overlap=0.4))
    assert 0.3 < whole["views_recall"] < 0.95
    assert whole["views_true_boxes_hidden"] > 5 < whole["views_frames_sensor_left"]
    for name, table in (("views", views), ("boxes", boxes)):
        write_table(tmp_path / f"{name}.parquet", table, MADE)
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    args = ["evaluate", "--views", str(tmp_path / "views.parquet"), "--truth", str(tmp_path / "boxes.parquet")]
    assert run([*args, "--box-overlap", "0.4", "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    assert set(found) - {"_provenance"} == set(whole)
    assert {name: found[name] for name in whole} == pytest.approx(whole, rel=1e-12)
    exact = [n for n in whole if "median" in n or "recall" in n or float(whole[n]).is_integer()]
    assert {n: found[n] for n in exact} == {n: whole[n] for n in exact}


@pytest.mark.parametrize("rows", [1, 13, 10**6])
def test_frames_of_views_have_their_numbers_in_pieces_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], rows: int
) -> None:
    views, boxes = seen(4)
    some = (table.take((table.frame >= 7) & (table.frame < 31)) for table in (views, boxes))
    whole = view_metrics(*some, EvaluateConfig())  # type: ignore[arg-type]
    for name, table in (("views", views), ("boxes", boxes)):
        write_table(tmp_path / f"{name}.parquet", table, MADE)
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    monkeypatch.setattr(running, "read_tables", None)  # whole tables are not read
    args = ["evaluate", "--views", str(tmp_path / "views.parquet"), "--truth", str(tmp_path / "boxes.parquet")]
    assert run([*args, "--frames", "7:31", "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    assert whole["views_frames"] == 48
    assert {name: found[name] for name in whole} == pytest.approx(whole, rel=1e-12)
    assert run([*args, "--frames", "40:50"]) == ExitCode.BAD_INPUT
    assert "frames 40:50: no true box is in them" in capsys.readouterr().err


def test_errors_of_views_in_files_have_the_figures_of_those_in_memory() -> None:
    (views, boxes), config = seen(9), EvaluateConfig()
    figures = ViewFigures(config, in_memory=10)
    figures.add(views, boxes)
    whole = view_metrics(views, boxes, config)
    assert list(figures.metrics()) == list(whole)
    assert figures.metrics() == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("rows", [1, 7, 10**6])
def test_requests_in_pieces_are_counted_as_whole_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    case, random = simulated(1), np.random.default_rng(1)
    times = np.sort(random.choice(np.unique(case.tracks.t_ns), 30))
    values = {c.name: np.zeros(30, c.dtype) for c in Cooperation.columns() if not c.optional and c.kind != "U"}
    values |= {c.name: np.full(30, "a") for c in Cooperation.columns() if not c.optional and c.kind == "U"}
    values |= {"t_ns": times, "cause": random.choice(["spread", "spread,count", "shared", "other"], 30)}
    answered = random.random(30) < 0.7
    values |= {"frames": random.integers(0, 4, 30).astype(values["frames"].dtype), "answered": answered}
    values |= {name: np.where(answered, 1.0, np.nan) for name in ("x", "y")}
    asked = Cooperation.of(**values)
    whole = cooperation_figures(asked, case.tracks)
    assert whole["cooperation_requests_spread"] > 2 < whole["cooperation_shared"]
    tables = {"tracks": case.tracks, "truth": case.truth, "cooperation": asked}
    for name, table in tables.items():
        write_table(tmp_path / f"{name}.parquet", table, MADE)
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(case.place))
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--scene", str(tmp_path / "scene.yaml")]
    args += [f"--{name}={tmp_path / name}.parquet" for name in ("truth", "cooperation")]
    assert run([*args, "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    assert {name: found[name] for name in whole} == pytest.approx(whole, rel=1e-12)
