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
from occlog.evaluate import sources
from occlog.evaluate.bearings.detections import observations_of
from occlog.evaluate.bearings.noise import NoiseFromTruth, figures_of, scene_with
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import paths_of
from occlog.evaluate.stage import evaluate
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.records.declared.sensors import Measurements
from occlog.scans.config import DistanceMeasurementConfig

HOW = DistanceMeasurementConfig(tag_height=0.5, rssi_power=-40.0)
MADE = Provenance("track", {"measurements": {"tag_height": 0.5, "rssi_power": -40.0}})


def distances(case: Case, seed: int, false: float = 0.0) -> Measurements:
    """Ranges, strengths without standard deviations and differences, of targets and of no one; some at other times."""
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
            reported = {
                "t_ns": t_ns,
                "sensor": np.full(n, name),
                "target_id": who,
                "reference": np.full(n, names[k - 1]),
            }
            rows.append(Measurements.of(**reported, **columns, **sigmas))
    return Measurements.merge(rows)


def args_of(folder: Path, tables: Mapping[str, object], case: Case) -> list[str]:
    """Arguments of the command."""
    (folder / "scene.yaml").write_text(scene_to_yaml(case.place))
    for name, table in tables.items():
        write_table(folder / f"{name}.parquet", table, MADE, overwrite=True, length_unit="m")  # type: ignore[arg-type]
    args = ["evaluate", *([str(folder / "tracks.parquet")] if "tracks" in tables else [])]
    for name in tables.keys() - {"tracks"}:
        args += [f"--{name}", str(folder / f"{name}.parquet")]
    return [*args, "--scene", str(folder / "scene.yaml"), "--overwrite", "-o", str(folder / "m.json")]


def test_distances_lower_the_bound() -> None:
    case, config = hand_made(3), EvaluateConfig(match="optimal")
    given = (case.tracks, case.truth, case.bearings, case.place, config)
    without, found = evaluate(*given), evaluate(*given, measured=(distances(case, 1), HOW, None))
    assert found.metrics["bound_rmse_m"] < 0.99 * without.metrics["bound_rmse_m"]


@pytest.mark.parametrize(("false", "code"), [(0.3, ExitCode.DONE), (0.9, ExitCode.BAD_INPUT)])
def test_differences_are_refused_for_the_share_of_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], false: float, code: int
) -> None:
    """Of a part of the rows most may be too long by chance."""
    case = simulated(1)
    tables = {"tracks": case.tracks, "truth": case.truth, "measurements": distances(case, 4, false)}
    monkeypatch.setattr(sources, "AT_ONCE", 40)
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=40))
    assert run([*args_of(tmp_path, tables, case), "-q"]) == code
    assert (tmp_path / "m.json").exists() == (code == ExitCode.DONE)
    stderr = capsys.readouterr().err
    assert ("range differences exceed the distance of their stations" in stderr) == (code != ExitCode.DONE)


@pytest.mark.parametrize("make", [hand_made, simulated])
def test_noise_at_known_places(tmp_path: Path, make: object) -> None:
    """Labelled bearings and candidates are mixed in one of them."""
    case: Case = make(6)  # type: ignore[operator]
    noise = known_places(case).noise()
    assert len(noise) > 1
    args = args_of(tmp_path, {"truth": case.truth, "bearings": case.bearings}, case)
    assert run([*args, "--write-scene", str(tmp_path / "new.yaml")]) == ExitCode.DONE
    content = json.loads((tmp_path / "m.json").read_text())
    wanted = figures_of(noise)
    assert {name: content[name] for name in wanted} == pytest.approx(wanted, rel=1e-12)
    new, scene = read_scene(tmp_path / "new.yaml"), scene_with(case.place, noise)
    for ours, theirs in zip(new.cameras, scene.cameras, strict=True):
        assert ours.sigma_read_px == pytest.approx(theirs.sigma_read_px, rel=1e-12)


def known_places(case: Case, in_memory: int = 10**6) -> NoiseFromTruth:
    """Readings of all bearings at true places."""
    found = NoiseFromTruth(case.place, in_memory)
    labels = {k: k for k in paths_of(case.truth, "target")}
    found.update(observations_of(case.bearings, case.truth, case.place, labels, EvaluateConfig()))
    return found


def test_readings_in_files_have_the_noise_of_those_in_memory() -> None:
    case = simulated(8)
    whole = known_places(case).noise()
    for name, one in known_places(case, in_memory=9).noise().items():
        assert one == pytest.approx(whole[name], rel=1e-12)
        assert one.readings == whole[name].readings > 60
    assert len(whole) == 3
