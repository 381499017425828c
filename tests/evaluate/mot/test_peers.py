"""What `occlog evaluate --mot` writes, read by TrackEval and py-motmetrics: the figures are those of `evaluate`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mot_environment import ask

from occlog.cli.main import run
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import TruthBoxes

pytestmark = pytest.mark.statistics
FRAMES, TARGETS, CAMERAS = 60, 5, ("east", "north")
THEIRS = {
    "MOTA": "mota",
    "MOTP": "motp_iou",
    "IDF1": "idf1",
    "IDP": "idp",
    "IDR": "idr",
    "HOTA": "hota",
    "DetA": "deta",
    "AssA": "assa",
    "LocA": "loca",
    "CLR_FP": "fp",
    "CLR_FN": "fn",
    "CLR_TP": "tp",
    "IDSW": "id_switches",
}
MOTMETRICS = {
    "num_false_positives": "fp",
    "num_misses": "fn",
    "num_switches": "id_switches",
    "mota": "mota",
    "motp": "motp",
    "idf1": "idf1",
}


def tables(seed: int) -> tuple[TruthBoxes, ViewTracks]:
    """Targets that walk through each other, some frames without; noisy tracks that are lost and swap."""
    rng = np.random.default_rng(seed)
    frame, camera, target = (a.ravel() for a in np.meshgrid(range(FRAMES), range(2), range(TARGETS), indexing="ij"))
    x = 60.0 + 40.0 * target + (1 + target) * 2.0 * frame * (1 - 2 * (target % 2))
    y = 100.0 + 10.0 * np.sin(0.1 * frame + target)
    there = rng.random(len(frame)) < 0.95
    base = {"t_ns": frame * 40_000_000, "sensor": np.array(CAMERAS)[camera], "frame": frame}
    size = {"width_px": np.full(len(frame), 30.0), "height_px": np.full(len(frame), 50.0)}
    truth = TruthBoxes.of(
        **base,
        **size,
        box=target.astype(np.int32),
        target_id=target.astype(np.int32),
        left_px=x - 15.0,
        top_px=y - 25.0,
        confidence=np.full(len(frame), np.nan),
    ).take(there)
    label = np.where((frame > 30) & (camera == 0) & (target < 2), 1 - target, target)
    zero, none = np.zeros(len(frame)), np.full(len(frame), "")
    tracks = ViewTracks.of(
        **base,
        target_id=label.astype(np.int32),
        x_px=x + rng.normal(0, 5, len(x)),
        y_px=y + rng.normal(0, 6, len(x)),
        a_px=np.full(len(x), 15.0),
        b_px=np.full(len(x), 25.0),
        rho=zero,
        cov_xx_px=zero + 1,
        cov_xy_px=zero,
        cov_yy_px=zero + 1,
        similarity=zero,
        ess=zero,
        likelihood_mode=none,
        counterpart=none,
        neighbours=none,
        assisting_views=none,
        lifecycle=none,
    ).take(rng.random(len(frame)) < 0.85)
    return truth, tracks


def test_the_written_folder_gives_the_same_figures(
    peers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    own: dict[str, dict[str, dict[str, float]]] = {}
    truth = tables(0)[0]
    write_table(tmp_path / "truth.parquet", truth, Provenance("test"))
    for seed in (0, 1):
        write_table(tmp_path / f"run{seed}.parquet", tables(seed)[1], Provenance("test"))
        for rule in ("classic", "challenge"):
            evaluate = ["evaluate", f"run{seed}.parquet", "--truth", "truth.parquet", "--clear-rule", rule]
            assert run([*evaluate, "--mot", "mot", "--json", "-q"]) == 0
            own.setdefault(f"run{seed}", {})[rule] = json.loads(capsys.readouterr().out)
    answer = ask(peers, "layout", tmp_path / "mot")
    assert sorted(answer) == sorted(own)
    for name, sequences in answer.items():
        assert sorted(sequences) == ["COMBINED_SEQ", *CAMERAS]
        for sequence, theirs in sequences.items():
            end = "" if sequence == "COMBINED_SEQ" else f"_sensor_{sequence}"
            ours = own[name]["challenge"]
            got = {k: np.mean(theirs[k]) for k in THEIRS}
            assert got == pytest.approx({k: ours[f"{v}{end}"] for k, v in THEIRS.items()}, rel=1e-9)
            if end:
                ours = own[name]["classic"]
                wanted = {k: ours[f"{v}{end}"] for k, v in MOTMETRICS.items()}
                assert theirs["motmetrics"] == pytest.approx(wanted, rel=1e-9)


def text_with_classes(seed: int) -> tuple[list[str], list[str]]:
    """True boxes of all classes, many marked 0, close to one another; tracks of most of them, and some of no one."""
    rng = np.random.default_rng(seed)
    truth, tracks = [], []
    kinds = rng.permutation([1] * 8 + [*range(2, 14)])
    positions = rng.uniform([0.0, 0.0], [400.0, 100.0], (len(kinds), 2))
    for frame in range(1, 41):
        positions += rng.normal(0.0, 3.0, positions.shape)
        for label, (kind, (x, y)) in enumerate(zip(kinds.tolist(), positions.tolist(), strict=True), start=1):
            if rng.random() < 0.1:
                continue
            mark = int(kind == 1 and rng.random() < 0.9)
            truth.append(f"{frame},{label},{x:.2f},{y:.2f},40,100,{mark},{kind},1.0")
            if rng.random() < 0.8:
                dx, dy = rng.normal(0.0, 5.0, 2)
                named = label if frame < 25 or label > 2 else 3 - label
                tracks.append(f"{frame},{named},{x + dx:.2f},{y + dy:.2f},40,100,1,-1,-1,-1")
        x, y = rng.uniform([0.0, 0.0], [400.0, 100.0])
        tracks.append(f"{frame},99,{x:.2f},{y:.2f},40,100,1,-1,-1,-1")
    return truth, tracks


def test_classes_of_the_truth_are_those_of_trackeval(
    peers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = ["first", "second"]
    for seed, name in enumerate(names):
        for folder in (f"truth/{name}/gt", "tracks/ours/data"):
            Path(folder).mkdir(parents=True, exist_ok=True)
        truth, tracks = text_with_classes(seed)
        Path(f"truth/{name}/gt/gt.txt").write_text("".join(f"{line}\n" for line in truth))
        Path(f"truth/{name}/seqinfo.ini").write_text(f"[Sequence]\nname={name}\nseqLength=40\n")
        Path(f"tracks/ours/data/{name}.txt").write_text("".join(f"{line}\n" for line in tracks))
    Path("list.txt").write_text("".join(f"{line}\n" for line in ("name", *names)))
    answer = ask(peers, tmp_path)
    scores = []
    for rules, theirs in answer.items():
        for name in names:
            files = [f"tracks/ours/data/{name}.txt", "--truth", f"truth/{name}/gt/gt.txt"]
            asked = [] if rules == "MOT17" else ["--benchmark", rules.lower()]
            assert run(["evaluate", *files, *asked, "--clear-rule", "challenge", "--json", "-q"]) == 0
            ours = json.loads(capsys.readouterr().out)
            got = {k: np.mean(theirs[name][k]) for k in THEIRS}
            assert got == pytest.approx({k: ours[v] for k, v in THEIRS.items()}, rel=1e-9)
            scores.append(ours["mota"])
    assert len(set(scores)) == 6  # the rules matter
