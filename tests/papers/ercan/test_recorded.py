"""Virtual occluders over recorded detections: who is hidden, what filters are stated, the experiments on real data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_scenes import SCENE, rows, truth, walked

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.papers.ercan.recorded import (
    CLEAR,
    DIAMETER,
    ITEMS,
    MOST,
    OCCLUDERS,
    ROOM,
    Recorded,
    crowd_of,
    crowd_size,
    files_of,
    hidden,
    occluders_of,
    recorded_spec,
    recorded_target,
    settings_of,
    trial,
)
from occlog.papers.verdicts import Size
from occlog.pipeline.sweep.engine import key_of
from occlog.records.tables import Bearings
from occlog.scans.occluder_priors import OccluderFeed

FOOT = 0.3048


def test_who_stands_in_the_sight_line_hides_the_target() -> None:
    """Target at (40, 0) seen from (0, 0): hidden within half a diameter of the line, and between the two."""
    people = truth(
        [[[20, 0.9], [70, 70]], [[20, 1.1], [70, 70]], [[41, 0], [70, 70]], [[-1, 0], [3, -0.5]]], "occluder", 1
    )
    target = [(40, 0)] * 4
    recorded = Recorded(SCENE, rows(target), truth([[p] for p in target]))
    np.testing.assert_array_equal(hidden(recorded, people, 2.0), [True, False, False, True])


def test_each_camera_loses_its_own_sight_line() -> None:
    """Target at (50, 50), somebody at (50, 25): he hides it from cam2 at (50, 0), not from cam1 and cam4."""
    target = [(50, 50)]
    table = Bearings.merge([rows(target, c.name) for c in SCENE.cameras])
    recorded = Recorded(SCENE, table, truth([target]))
    gone = hidden(recorded, truth([[(50, 25), (5, 90)]], "occluder", 1), 2.0)
    assert table.sensor[gone].tolist() == ["cam2"]


def test_as_many_people_a_square_metre_as_in_the_lab() -> None:
    lab = np.array([(0, 0), (22 * FOOT, 0), (22 * FOOT, 19 * FOOT), (0, 19 * FOOT)])
    assert crowd_size(replace(SCENE, room=lab)) == OCCLUDERS == 20
    assert crowd_size(replace(SCENE, room=np.array(ROOM))) == 13  # 26.2 of 38.8 square metres
    assert crowd_size(replace(SCENE, room=None)) == OCCLUDERS
    assert crowd_size(SCENE) == MOST  # 100 m by 100 m would have 5150


def small() -> Recorded:
    """A target that walks for 40 s among four cameras, in a scene whose room is not known."""
    scene, table = walked(40)
    return recorded_target(replace(scene, room=None), table)


@pytest.mark.jit
def test_filters_are_reported_of_the_people_who_hide() -> None:
    """Known positions at a frame are those by which its detections are dropped; priors are near them."""
    recorded = small()
    crowd = crowd_of(recorded, 3)
    times = recorded.positions.t_ns
    np.testing.assert_array_equal(np.unique(crowd.people.t_ns), times)
    known, vague = (OccluderFeed([crowd.priors[k]], DIAMETER, 10**9) for k in ("known", "kalman"))
    for t in times.tolist():
        true = crowd.people.take(crowd.people.t_ns == t)
        reported = known.at(t)
        np.testing.assert_array_equal(reported.mean, np.column_stack([true.x, true.y]))
        assert not reported.sigma.any()
        guess = vague.at(t)
        assert guess.sigma.min() > 0
        assert np.hypot(*(guess.mean - reported.mean).T).max() < 6 * 12.8 * 0.0254  # six deviations of the measurements
    assert crowd.priors["none"] is None
    np.testing.assert_array_equal(crowd.left.seen, recorded.bearings.seen & ~crowd.gone)
    kept = crowd.left.seen
    np.testing.assert_array_equal(crowd.left.bearing[kept], recorded.bearings.bearing[kept])


@pytest.mark.jit
def test_a_trial_depends_on_its_seeds_alone() -> None:
    recorded, size = small(), Size(2, 40)
    assert recorded.cameras == ("cam1", "cam2", "cam3", "cam4")
    people = occluders_of(recorded, 0)
    assert len(np.unique(people.target_id)) == OCCLUDERS
    assert set(people.role.tolist()) == {"occluder"}
    crowd = crowd_of(recorded, 0)
    found = trial(recorded, crowd, "known", recorded.cameras, size, 0)
    assert found == trial(recorded, crowd_of(recorded, 0), "known", recorded.cameras, size, 0)
    assert found["rmse_occ"] == 0.0
    assert 0.0 <= found["hidden"] == np.mean(crowd.gone[recorded.bearings.seen])
    # Without priors "not seen" must say nothing, as in the paper; a filter reported misses would take it for one.
    assert [settings_of(recorded, size, k).detection_probability for k in ("none", "kalman", "known", CLEAR)] == [
        None
    ] + [0.9] * 3
    clear = trial(recorded, crowd, CLEAR, recorded.cameras, size, 0)
    assert clear["hidden"] == 0.0
    assert clear["rmse"] < 3.0  # four cameras of 2 px and f = 70 px, in a room of 100 by 100


def test_a_changed_recording_is_another_trial(tmp_path: Path) -> None:
    scene, table = walked(12)
    paths = tmp_path / "b.parquet", tmp_path / "s.yaml"
    write_table(paths[0], table, Provenance("detect"))
    keys = set()
    for name in ("m", "ft"):
        paths[1].write_text(scene_to_yaml(replace(scene, length_unit=name)))
        keys.add(key_of(recorded_spec(files_of(*paths), Size(1, 25), 0, "known", ["cam1"])))
    assert len(keys) == 2


def test_an_experiment_needs_its_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ask = ["reproduce", "ercan", ITEMS[0]]
    bearings, scene_file = str(tmp_path / "b.parquet"), str(tmp_path / "s.yaml")
    for name in (bearings, scene_file):
        Path(name).touch()  # a file that is missing would be stated first

    def report_of(*args: str) -> tuple[int, str]:
        code = run([*ask, *args])
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        return code, error

    for args, text in {
        (): "give --data DIR, or --bearings and --scene",
        ("--scene", scene_file): "goes with --bearings",
        ("--data", str(tmp_path), "--bearings", bearings): "leave --bearings and --scene out",
    }.items():
        code, error = report_of(*args)
        assert code == ExitCode.USAGE
        assert text in error
    code, error = report_of("--data", str(tmp_path))
    assert code == ExitCode.BAD_INPUT
    assert str(tmp_path / "CMC1_detections.csv") in error
    scene, table = walked(8, "unit")
    Path(scene_file).write_text(scene_to_yaml(scene))
    Path(bearings).unlink()
    write_table(Path(bearings), table, Provenance("detect"))
    code, error = report_of("--bearings", bearings, "--scene", scene_file)
    assert code == ExitCode.BAD_INPUT
    assert "b.parquet" in error
    assert "metres" in error


def test_all_says_what_it_leaves_out(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from occlog.papers import catalogue as experiments
    from occlog.papers.ercan.formulas import accuracy

    monkeypatch.setitem(experiments.PAPERS, "ercan", (accuracy.FIG17,))  # one that is quick
    assert run(["reproduce", "ercan", "--all", "--quick", "--steps", "60"]) == ExitCode.DONE
    lines = [line for line in capsys.readouterr().err.splitlines() if "recorded" in line]
    assert len(lines) == 1
    assert all(item in lines[0] for item in ITEMS)
    assert "--data" in lines[0]


@pytest.mark.jit
@pytest.mark.statistics
def test_recorded_detections_with_virtual_occluders(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shipped folder through the command line: tables with the share of hidden detections, plots and verdicts.

    Of its 261 frames the first 48.
    """
    given, made = shared_data / "cmc_detections", tmp_path / "first"
    (made / "calibration").mkdir(parents=True)
    for path in given.joinpath("calibration").iterdir():
        (made / "calibration" / path.name).write_bytes(path.read_bytes())
    head, *found = (given / "CMC1_detections.csv").read_text().splitlines(keepends=True)
    early = [row for row in found if int(row.split(",")[0]) < 48]
    (made / "CMC1_detections.csv").write_text("".join([head, *early]))
    args = ["--data", str(made), "--quick", "--steps", "13", "--json", "-q"]
    assert run(["reproduce", "ercan", *ITEMS, *args, "-o", str(tmp_path / "out")]) == ExitCode.DONE
    items = json.loads(capsys.readouterr().out)["items"]
    assert [i["item"] for i in items] == list(ITEMS)
    assert all(i["full"] == {"runs": 20, "steps": 48} for i in items)
    page = (tmp_path / "out" / "reproduce.html").read_text()
    assert all(v["id"] in page for i in items for v in i["verdicts"])
    lines = (tmp_path / "out" / f"{ITEMS[0]}.csv").read_text().splitlines()
    head = lines[0].split(",")
    shares = {cells[0]: float(cells[head.index("hidden")]) for cells in (line.split(",") for line in lines[1:])}
    assert shares.pop("no occlusion") == 0.0
    assert all(0.1 < share < 0.9 for share in shares.values())
    assert len(lines) == 1 + 3 * 4
    assert len((tmp_path / "out" / f"{ITEMS[1]}.csv").read_text().splitlines()) == 1 + 2 * 5 + 1
