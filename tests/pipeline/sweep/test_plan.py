"""Sweep files, statistics and tables."""

from __future__ import annotations

import math

import pytest
from sweep_scene import SCENE

from occlog.errors import InputError
from occlog.pipeline.csv_text import to_csv
from occlog.pipeline.sweep.plan import read_sweep, settings_of
from occlog.pipeline.sweep.run import summarise, summary_rows, to_text, trial_rows

HEAD = "occlog_sweep: 1\nscene: scene.yaml\nruns: 2\nseed: 5\n"


def settings(tmp_path, text):
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "sweep.yaml").write_text(HEAD + text)
    return settings_of(tmp_path / "sweep.yaml", read_sweep(tmp_path / "sweep.yaml"))


def test_everything_that_varies_is_combined(tmp_path):
    found = settings(
        tmp_path,
        "order: [b, a, c]\ntrack: {particles: 10}\nvary:\n  cameras: [1, 2]\n  track.particles: [20, 30]\n"
        "cases:\n- {name: known, priors.kind: known}\n- {name: none}\n",
    )
    assert len(found) == 8
    assert found[0].label == {"name": "known", "priors.kind": "known", "cameras": 1, "track.particles": 20}
    assert [t["run"] for t in found[0].trials] == [0, 1]
    assert found[3].trials[0]["cameras"] == ["b", "a"]
    assert found[3].trials[0]["track"] == {"particles": 30}
    assert found[3].trials[0]["priors"] == {"kind": "known"}
    assert found[4].trials[0]["priors"] == {}
    assert "name" not in found[0].trials[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("vary: {particles: [3]}\n", "expected cameras or skip, or a part"),
        ("vary: {filter.particles: [3]}\n", "parts: simulate, observe"),
        ("vary: {track.particles: []}\n", "has no values"),
        ("cameras: 2\n", "how many of some names in `order`, which is not there"),
        ("cameras: 3\norder: [a, b]\n", "how many of the 2 names in `order`"),
        ("vary: {cameras: [[{x: 1}]]}\n", "expected a list of names"),
        ("vary: {skip: [-1]}\n", "skip: -1: expected a whole number of at least 0"),
        ("cases: [{skip: x}]\n", "skip: 'x': expected a whole number of at least 0"),
        ("vary: {track.particles: [1, 2]}\nrun: 3\n", "run"),
        ("vary: {simulate.steps: [1, 2]}\nruns: 3\n", "twice|repeated|duplicate"),
    ],
)
def test_a_file_that_does_not_fit_is_reported(tmp_path, text, words):
    with pytest.raises(InputError, match=rf"sweep\.yaml: .*({words})"):
        settings(tmp_path, text)


def test_too_many_trials_are_refused(tmp_path):
    axes = "".join(f"  track.{name}: [{', '.join(map(str, range(101)))}]\n" for name in ("a", "b", "c"))
    with pytest.raises(InputError, match="limit 1000000"):
        settings(tmp_path, "vary:\n" + axes)


def test_a_missing_scene_is_reported(tmp_path):
    (tmp_path / "sweep.yaml").write_text(HEAD)
    with pytest.raises(InputError, match=r"scene\.yaml"):
        settings_of(tmp_path / "sweep.yaml", read_sweep(tmp_path / "sweep.yaml"))


def test_a_scene_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "sweep.yaml").write_text(HEAD)
    (tmp_path / "scene.yaml").write_bytes(SCENE.encode() + b"# \xff\n")
    with pytest.raises(InputError, match=r"scene\.yaml") as refused:
        settings_of(tmp_path / "sweep.yaml", read_sweep(tmp_path / "sweep.yaml"))
    assert refused.value.id == "wrong-encoding"


def test_statistics_by_hand():
    found = summarise([1.0, 2.0, 3.0, 4.0, math.nan])
    assert found.n == 4
    assert found.mean == 2.5
    assert found.sd == pytest.approx(math.sqrt(5 / 3))
    # Student's t with 3 degrees of freedom: 3.182446
    assert found.high - found.mean == pytest.approx(3.182446 * math.sqrt(5 / 3) / 2, rel=1e-6)
    assert found.mean - found.low == pytest.approx(found.high - found.mean)
    one = summarise([7.0])
    assert (one.n, one.mean) == (1, 7.0)
    assert math.isnan(one.sd)
    assert summarise([]).n == 0


def test_tables(tmp_path):
    found = settings(tmp_path, "order: [a, b, c]\nvary:\n  cameras: [1, 2]\n")
    results = [{"rmse": v} for v in (1.0, 3.0, 5.0, 5.0)]
    rows = trial_rows(found, results)
    assert rows[1] == {"cameras": 1, "run": 1, "rmse": 3.0}
    assert to_csv(rows).decode().splitlines() == ["cameras,run,rmse", "1,0,1.0", "1,1,3.0", "2,0,5.0", "2,1,5.0"]

    summary = summary_rows(found, results)
    assert summary[0].summary.mean == 2.0
    assert summary[1].summary.sd == 0.0
    lines = to_text(summary, ["rmse"]).splitlines()
    assert lines[0].split() == ["cameras", "runs", "rmse"]
    assert lines[2].split() == ["2", "2", "5", "±", "0"]


def test_as_many_cameras_as_are_ordered_can_be_used(tmp_path):
    assert settings(tmp_path, "order: [a, b]\ncameras: 2\n")[0].trials[0]["cameras"] == ["a", "b"]
    for number in (0, 3):
        with pytest.raises(InputError, match="how many of the 2 names"):
            settings(tmp_path, f"order: [a, b]\ncameras: {number}\n")


def test_names_that_a_spreadsheet_would_run_are_marked() -> None:
    rows = [{"order": "=cmd|calc!A1", "run": -1, "rmse": -0.5}]
    assert to_csv(rows).decode().splitlines()[1] == "'=cmd|calc!A1,-1,-0.5"
