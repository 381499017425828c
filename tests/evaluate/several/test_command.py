"""`occlog evaluate --also`: several recordings in one table, and all of them together."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tracked_crowds import crowd

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import Tracks, Truth

NS = 1_000_000_000
SCENE = scene_from_yaml("occlog_scene: 1\ncameras: []\n", "scene")
SUMS = ("objects", "tp", "fp", "fn", "id_switches", "idtp", "idfp", "idfn", "frames", "mostly_tracked")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two recordings in images and two on the ground; people have the same numbers in all of them."""
    monkeypatch.chdir(tmp_path)
    for number, (name, frames, people) in enumerate((("a", 12, 2), ("b", 30, 3))):
        lines, ours = [], []
        for frame in range(1, frames + 1):
            for k in range(people):
                lines.append(f"{frame},{k},{100 * k},0,40,80,1,-1,-1,-1")
                shown = k if frame < 6 or k > 1 else 1 - k
                if (frame + k) % 5 > number:
                    ours.append(f"{frame},{shown},{100 * k + 5},0,40,80,1,-1,-1,-1")
        Path(f"gt_{name}.txt").write_text("\n".join(lines))
        Path(f"{name}.txt").write_text("\n".join(ours))
        t = np.repeat(np.arange(frames), people)
        k = np.tile(np.arange(people, dtype=np.int32), frames)
        nan, one = np.full(len(t), np.nan), np.ones(len(t))
        place = {"t_ns": t * NS, "x": 4.0 * k}
        truth = Truth.of(**place, target_id=k, y=0 * one, z=nan, role=np.full(len(t), "target"))
        label = np.where((t >= 6) & (k < 2), 1 - k, k).astype(np.int32)
        moving = {"vx": nan, "vy": nan, "cov_xx": 0.01 * one, "cov_xy": 0 * one, "cov_yy": 0.01 * one}
        tracks = Tracks.of(**place, **moving, target_id=label, y=0.1 * one)
        tracks = tracks.take(np.lexsort((label, t)))
        with RecordingWriter(Path(f"{name}.mcap"), SCENE, Provenance("test")) as writer:
            writer.table(truth)
        write_table(Path(f"{name}.parquet"), tracks.take(np.arange(0, len(t) - number)), Provenance("test"))


def figures(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, float]:
    assert run(["evaluate", *arguments, "--json", "-q"]) == ExitCode.DONE
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


@pytest.mark.parametrize("suffixes", [("txt", "txt"), ("parquet", "mcap")])
def test_counts_add_up_and_rates_are_made_of_the_sums(
    suffixes: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    ours, theirs = suffixes
    prefix = "gt_" if theirs == "txt" else ""
    sides = [(f"{name}.{ours}", f"{prefix}{name}.{theirs}") for name in ("a", "b")]
    one, two = (figures(capsys, tracks, "--truth", truth) for tracks, truth in sides)
    got = figures(capsys, sides[0][0], "--truth", sides[0][1], "--also", *sides[1])
    for name in SUMS:
        assert got[name] == one[name] + two[name]
        assert (got[f"{name}_recording_a"], got[f"{name}_recording_b"]) == (one[name], two[name])
    assert got["id_switches"] > 0
    assert got["mota"] == pytest.approx(1 - (got["fp"] + got["fn"] + got["id_switches"]) / got["objects"])
    assert got["idf1"] == pytest.approx(2 * got["idtp"] / (2 * got["idtp"] + got["idfp"] + got["idfn"]))
    assert min(one["hota"], two["hota"]) < got["hota"] < max(one["hota"], two["hota"])


def test_covariances_and_trajectories_of_all_together(capsys: pytest.CaptureFixture[str]) -> None:
    got = figures(capsys, "a.parquet", "--truth", "a.mcap", "--also", "b.parquet", "b.mcap", "--ospa-window", "4")
    assert got["matched_nees_mean"] == pytest.approx(1.0)
    assert got["matched_nees_compared"] == 12 * 2 + 30 * 3 - 1
    parts = [got[f"tgospa_switch_m2_recording_{name}"] * frames for name, frames in (("a", 12), ("b", 30))]
    assert got["tgospa_switch_m2"] == pytest.approx(sum(parts) / 42)
    assert "ospa2_window_m_recording_a" in got
    assert "ospa2_window_m" not in got  # a window is of one recording


def test_a_row_for_each_recording_and_one_of_all(capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["evaluate", "a.txt", "--truth", "gt_a.txt", "--also", "b.txt", "gt_b.txt"]
    assert run([*asked, "-o", "m.json", "-q"]) == ExitCode.DONE
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["recording", "a", "b", "all"]
    assert "mota_recording_b" in json.loads(Path("m.json").read_text())
    assert run([*asked, "--fail-if", "mota_recording_b<2"]) == ExitCode.THRESHOLD
    capsys.readouterr()
    assert figures(capsys, *asked[1:], "--frames", "0:6")["frames"] == 12


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a.txt", "--truth", "gt_a.txt", "--also", "b.parquet", "b.mcap"], "separately"),
        (
            ["a.txt", "--truth", "gt_a.txt", "--also", "b.txt", "gt_b.txt", "--mot", "d"],
            "--mot applies to one recording",
        ),
        (["a.txt", "--also", "b.txt", "gt_b.txt"], "--truth"),
    ],
)
def test_what_does_not_go_together_is_refused(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["evaluate", *arguments]) == ExitCode.USAGE
    assert words in capsys.readouterr().err


def test_what_was_lost_in_making_any_input_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    args = []
    for n in range(2):
        for side, table in zip(("tracks", "truth"), crowd(n), strict=True):
            lost = Provenance(side, losses=(Loss(f"{side}{n}.log", "line 7", "was lost"),))
            write_table(tmp_path / f"{side}{n}.parquet", table, lost)
        args += ["--also"] * n + [str(tmp_path / f"tracks{n}.parquet")]
        args += ["--truth"] * (1 - n) + [str(tmp_path / f"truth{n}.parquet")]
    assert run(["evaluate", *args, "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    stderr, kept = capsys.readouterr().err, json.loads((tmp_path / "m.json").read_text())["_provenance"]["losses"]
    for name in ("tracks0", "truth0", "tracks1", "truth1"):
        assert f"lost earlier: {name}.log: line 7: was lost" in stderr
    assert [each["source"] for each in kept] == ["tracks0.log", "truth0.log", "tracks1.log", "truth1.log"]
