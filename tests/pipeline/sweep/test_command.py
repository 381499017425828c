"""The sweep command."""

from __future__ import annotations

import csv
import json

import pytest
from click.testing import CliRunner
from sweep_scene import SCENE

from occlog.errors import InputError, OutputError, OutputExistsError, UsageError
from occlog.io.files.atomic import alone_with
from occlog.pipeline.sweep.command import command
from occlog.pipeline.sweep.engine import TrialError

TEXT = """\
occlog_sweep: 1
scene: scene.yaml
runs: 2
simulate: {steps: 8, occluders: 3}
track: {particles: 50}
order: [a, b, c]
vary: {cameras: [2, 3]}
"""


def sweep(tmp_path, *options, text=TEXT):
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "sweep.yaml").write_text(text)
    args = [str(tmp_path / "sweep.yaml"), "-o", str(tmp_path / "out"), "--workers", "1", *options]
    return CliRunner().invoke(command, args, standalone_mode=False)


def test_a_sweep_writes_its_tables_and_can_be_repeated(tmp_path):
    done = sweep(tmp_path)
    assert done.exception is None
    assert done.stdout.splitlines()[0].split()[:3] == ["cameras", "runs", "rmse"]
    with (tmp_path / "out" / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(r["cameras"], r["run"]) for r in rows] == [("2", "0"), ("2", "1"), ("3", "0"), ("3", "1")]
    before = (tmp_path / "out" / "trials.csv").read_bytes()
    again = json.loads(sweep(tmp_path, "--json").stdout)
    assert (tmp_path / "out" / "trials.csv").read_bytes() == before
    assert again["trials"] == 4
    mean = next(r["mean"] for r in again["settings"] if r["figure"] == "rmse" and r["cameras"] == 2)
    assert mean == sum(float(r["rmse"]) for r in rows[:2]) / 2


def test_files_of_results_have_the_same_bytes_whoever_makes_them(tmp_path):
    found = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        assert sweep(tmp_path / name).exception is None
        out = tmp_path / name / "out"
        found.append([(out / n).read_bytes() for n in ("trials.csv", "summary.csv", "sweep.json")])
        with (out / "timings.csv").open() as file:
            times = list(csv.DictReader(file))
        assert [(t["cameras"], t["run"]) for t in times] == [("2", "0"), ("2", "1"), ("3", "0"), ("3", "1")]
        assert all(float(t["track_seconds"]) > 0 for t in times)
    assert found[0] == found[1]
    assert b"track_seconds" not in b"".join(found[0])


def test_another_sweep_is_not_overwritten_unless_asked(tmp_path):
    sweep(tmp_path)
    other = TEXT.replace("steps: 8", "steps: 9")
    assert isinstance(sweep(tmp_path, text=other).exception, OutputExistsError)
    assert sweep(tmp_path, "--overwrite", text=other).exception is None


def test_a_folder_in_place_of_a_result_is_named(tmp_path):
    (tmp_path / "out" / "trials.csv").mkdir(parents=True)
    refused = sweep(tmp_path, "--overwrite").exception
    assert isinstance(refused, OutputError)
    assert "trials.csv: cannot be written: Is a directory" in str(refused)


def test_two_commands_do_not_work_in_one_folder(tmp_path):
    """With --overwrite the second took the trials of the first away, and results of either came after the other's."""
    sweep(tmp_path)
    store = (tmp_path / "out" / "trials.jsonl").read_bytes()
    with alone_with(tmp_path / "out", "sweep"):
        refused = sweep(tmp_path, "--overwrite", text=TEXT.replace("steps: 8", "steps: 9"))
    assert isinstance(refused.exception, UsageError)
    assert "is in use by another `occlog sweep`" in str(refused.exception)
    assert (tmp_path / "out" / "trials.jsonl").read_bytes() == store


def test_unknown_figures_and_contradictions_are_reported(tmp_path):
    wrong = sweep(tmp_path, "--figures", "rsme")
    assert isinstance(wrong.exception, UsageError)
    assert "no figure 'rsme'" in str(wrong.exception)
    assert "exclude each other" in str(sweep(tmp_path, "--scheduler", "tcp://x:1").exception)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("particles: 50", "particles: 0", "line 5: track.particles: 0: must be at least 1"),
        ("particles: 50", "partic: 5", "line 5: track.partic: apf has no setting 'partic'; did you mean 'particles'?"),
        ("particles: 50", "method: jipda", "line 5: track.method: jipda takes no bearings, which trials make"),
        (
            "cameras: [2, 3]",
            "track.velocity_memory: [0.5, 2]",
            "line 7: vary.track.velocity_memory: 2: must be at least 0 and at most 1",
        ),
        (
            "{cameras: [2, 3]}",
            "{priors.kind: [on]}",
            "line 7: vary.priors.kind: True: must be one of none, known, kalman",
        ),
        (
            "{cameras: [2, 3]}",
            "{priors.measurement_noise: [0]}",
            "line 7: vary.priors.measurement_noise: 0: must be a number above 0",
        ),
        (
            "vary: {cameras: [2, 3]}",
            "cases: [{}, {priors.process_noise_velocity: x}]",
            "line 7: cases[1].priors.process_noise_velocity: 'x': must be a number",
        ),
        ("vary: {cameras: [2, 3]}", "cases: [{priors.p: 1}]", "line 7: cases[0].priors.p: unknown key"),
    ],
)
def test_values_that_a_trial_would_refuse_are_named_before_any_trial(tmp_path, old, new, message):
    assert old in TEXT
    refused = sweep(tmp_path, text=TEXT.replace(old, new))
    assert isinstance(refused.exception, InputError)
    assert message in str(refused.exception)
    assert not (tmp_path / "out").exists()


def test_a_trial_that_fails_is_reported_with_its_files(tmp_path):
    failed = sweep(tmp_path, text=TEXT + "skip: 10\n").exception
    assert isinstance(failed, TrialError)
    assert str(failed).startswith(f"{tmp_path / 'sweep.yaml'}: scene scene.yaml: 4 of 4 trials failed; the first is")
