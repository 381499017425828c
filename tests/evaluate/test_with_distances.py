"""Measurements of distances, and noise at known places, in stretches of time: figures are those of whole tables."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bearing_scenes import Case, hand_made, simulated

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate import run as running
from occlog.evaluate.bearings.known_places import KnownPlaces, figures_of, noise_at_known_places, scene_with
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import paths_of
from occlog.evaluate.stage import Evaluation, evaluate
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.scenes.scene import read_scene, scene_to_yaml
from occlog.records.declared.measurements import Measurements
from occlog.records.tables import Bound
from occlog.scans.config import MeasuredConfig

HOW = MeasuredConfig(tag_height=0.5, rssi_power=-40.0)
MADE = Provenance("track", {"measurements": {"tag_height": 0.5, "rssi_power": -40.0}})
WHOLE = 10**6


def distances(case: Case, seed: int, false: float = 0.0) -> Measurements:
    """Ranges, strengths without standard deviations and differences, of targets and of nobody; some at other times."""
    random, rows = np.random.default_rng(seed), []
    places = {c.name: c.ground for c in case.place.cameras}
    names = list(places)
    for target, path in paths_of(case.truth, "target").items():
        for k, name in enumerate(names):
            t_ns = path.t_ns[random.random(len(path.t_ns)) < 0.8]
            far = np.hypot(*(path.roughly_at(t_ns) - places[name]).T)
            t_ns = t_ns + random.choice([0, 40_000_000], len(t_ns))
            n, nan = len(t_ns), np.full(len(t_ns), np.nan)
            kind = random.integers(0, 3, n)
            other = np.hypot(*(path.roughly_at(t_ns) - places[names[k - 1]]).T)
            off = np.where(random.random(n) < false, 500.0, 0.0)
            columns = {
                "range": np.where(kind == 0, far + random.normal(0, 0.1, n), nan),
                "rssi": np.where(kind == 1, -40.0 - 20.0 * np.log10(far) + random.normal(0, 3, n), nan),
                "range_difference": np.where(kind == 2, far - other + random.normal(0, 0.1, n) + off, nan),
            }
            sure = np.full(n, 0.1)
            sigmas = {"sigma_range": sure, "sigma_rssi": nan, "sigma_range_difference": sure}
            who = np.where(random.random(n) < 0.1, 90, target).astype(np.int32)
            told = {"t_ns": t_ns, "sensor": np.full(n, name), "target_id": who, "reference": np.full(n, names[k - 1])}
            rows.append(Measurements.of(**told, **columns, **sigmas))
    return Measurements.merge(rows)


def args_of(folder: Path, patch: pytest.MonkeyPatch, tables: Mapping[str, object], case: Case, rows: int) -> list[str]:
    """Arguments of the command, which reads so many rows at a time and no whole table."""
    (folder / "scene.yaml").write_text(scene_to_yaml(case.place))
    for name, table in tables.items():
        write_table(folder / f"{name}.parquet", table, MADE, overwrite=True, length_unit="m")  # type: ignore[arg-type]
    patch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    patch.setattr(running, "read_tables", None)
    args = ["evaluate", *([str(folder / "tracks.parquet")] if "tracks" in tables else [])]
    for name in tables.keys() - {"tracks"}:
        args += [f"--{name}", str(folder / f"{name}.parquet")]
    return [*args, "--scene", str(folder / "scene.yaml"), "--overwrite", "-o", str(folder / "m.json")]


def check(found: Path, whole: Mapping[str, float]) -> None:
    """Counts and quantiles to the last digit, sums up to rounding."""
    told = {name: np.nan if value is None else value for name, value in json.loads(found.read_text()).items()}
    assert {name: told[name] for name in whole} == pytest.approx(whole, rel=1e-12, abs=1e-13, nan_ok=True)
    exact = [n for n, value in whole.items() if float(value).is_integer() or "median" in n or "p95" in n]
    assert {n: told[n] for n in exact} == {n: whole[n] for n in exact}


def of_whole(case: Case, table: Measurements, *, bearings: bool, config: EvaluateConfig) -> Evaluation:
    seen = case.bearings if bearings else None
    return evaluate(case.tracks, case.truth, seen, case.place, config, measured=(table, HOW, None))


@pytest.mark.parametrize("rows", [1, 13, WHOLE])
@pytest.mark.parametrize("bearings", [True, False])
@pytest.mark.parametrize("make", [hand_made, simulated])
def test_distances_count_in_the_bound_as_of_whole_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: object, bearings: bool, rows: int
) -> None:
    case: Case = make(3)  # type: ignore[operator]
    table, config = distances(case, rows), EvaluateConfig(match="optimal", skip_s=2.0)
    whole = of_whole(case, table, bearings=bearings, config=config)
    without = evaluate(case.tracks, case.truth, case.bearings, case.place, config)
    assert len(whole.bound) > 20
    assert not bearings or whole.metrics["bound_rmse_m"] < 0.99 * without.metrics["bound_rmse_m"]
    tables = {"tracks": case.tracks, "truth": case.truth, "measurements": table}
    tables |= {"bearings": case.bearings} if bearings else {}
    args = [*args_of(tmp_path, monkeypatch, tables, case, rows), "--bound", str(tmp_path / "bound.parquet")]
    assert run([*args, "--match", "optimal", "--skip-seconds", "2"]) == ExitCode.DONE
    check(tmp_path / "m.json", whole.metrics)
    again = read_table(tmp_path / "bound.parquet", Bound)
    for c in Bound.columns():
        np.testing.assert_allclose(getattr(again, c.name), getattr(whole.bound, c.name), rtol=1e-12, err_msg=c.name)


def test_measurements_of_other_frames_count_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = simulated(2)
    table, times = distances(case, 1), np.unique(case.truth.t_ns)
    low, high = times[10], times[45]
    part = Case(case.place, *(t.take((t.t_ns >= low) & (t.t_ns < high)) for t in case[1:]))
    some = table.take((table.t_ns >= low) & (table.t_ns < high))
    whole = of_whole(part, some, bearings=True, config=EvaluateConfig()).metrics
    tables = {"tracks": case.tracks, "truth": case.truth, "measurements": table, "bearings": case.bearings}
    args = args_of(tmp_path, monkeypatch, tables, case, 17)
    streams = running.run_in_stretches
    for how in (streams, None):  # whole tables likewise
        if how is None:
            monkeypatch.undo()
            monkeypatch.setattr(running, "run_in_stretches", lambda *_: None)
        assert run([*args, "--frames", "10:45"]) == ExitCode.DONE
        found = json.loads((tmp_path / "m.json").read_text())
        bound = [name for name in whole if "bound" in name]
        assert len(bound) > 10
        assert {n: found[n] for n in bound} == pytest.approx({n: whole[n] for n in bound}, rel=1e-12)


@pytest.mark.parametrize(("false", "code"), [(0.3, ExitCode.DONE), (0.9, ExitCode.BAD_INPUT)])
def test_differences_are_refused_for_the_share_of_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], false: float, code: int
) -> None:
    """Of a part of the rows most may be too long by chance."""
    case = simulated(1)
    tables = {"tracks": case.tracks, "truth": case.truth, "measurements": distances(case, 4, false)}
    said = []
    for rows in (10, WHOLE):
        assert run([*args_of(tmp_path, monkeypatch, tables, case, rows), "-q"]) == code
        said.append(capsys.readouterr().err)
        assert (tmp_path / "m.json").exists() == (code == ExitCode.DONE)
    assert said[0] == said[1]
    assert ("differences are longer than their stations are apart" in said[0]) == (code != ExitCode.DONE)


@pytest.mark.parametrize("rows", [1, 13, WHOLE])
@pytest.mark.parametrize("make", [hand_made, simulated])
def test_noise_at_known_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: object, rows: int) -> None:
    """Labelled bearings and candidates are mixed in one of them."""
    case: Case = make(6)  # type: ignore[operator]
    whole = evaluate(None, case.truth, case.bearings, case.place)
    noise = noise_at_known_places(whole.looks, case.place)
    assert len(noise) > 1
    args = args_of(tmp_path, monkeypatch, {"truth": case.truth, "bearings": case.bearings}, case, rows)
    assert run([*args, "--write-scene", str(tmp_path / "new.yaml")]) == ExitCode.DONE
    check(tmp_path / "m.json", whole.metrics | figures_of(noise))
    new, wanted = read_scene(tmp_path / "new.yaml"), scene_with(case.place, noise)
    for ours, theirs in zip(new.cameras, wanted.cameras, strict=True):
        assert ours.sigma_read_px == pytest.approx(theirs.sigma_read_px, rel=1e-12)


def test_readings_in_files_have_the_noise_of_those_in_memory() -> None:
    case = simulated(8)
    looks = evaluate(None, case.truth, case.bearings, case.place).looks
    whole, found = noise_at_known_places(looks, case.place), KnownPlaces(case.place, in_memory=9)
    found.add(looks)
    for name, one in found.noise().items():
        assert one == pytest.approx(whole[name], rel=1e-12)
        assert one.readings == whole[name].readings > 60
    assert len(whole) == 3
