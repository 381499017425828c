"""Figures for many targets against TrackEval 1.3.0 and py-motmetrics 1.4.0.

Both run in an environment that is made for this test, over the packages of the tests;
OCCLOG_PEERS names the Python of one that exists.  Without an index of packages the tests are skipped, or fail
if OCCLOG_PEERS_REQUIRED=1.
"""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import mot_reference as plain
import numpy as np
import pytest
from mot_environment import ask

from occlog.core.metrics.mot.clear_mot import CHALLENGE, CLASSIC, clear_mot
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_boxes, of_points, reaches
from occlog.core.metrics.mot.hota import hota, identity
from occlog.io.formats.boxes.mot_challenge import WrittenSequence, write_mot, write_sequence, write_sequence_list
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.frames.streams import rate_times
from occlog.records.tables import Boxes, TruthBoxes

pytestmark = pytest.mark.statistics
NAMES = ("TUD-Campus", "TUD-Stadtmitte")
LIMIT = 0.8
SCENES = 40
B = TypeVar("B", bound=Boxes)


def as_frames(frames: MatchedFrames) -> list[dict[str, Any]]:
    """Frames as the peers' script reads them."""
    out = []
    for t in range(len(frames.frame)):
        left, right = frames.rows(t)
        distance, similarity = frames.compare(t)
        pairs = np.where(reaches(similarity, 0.5), distance, None)
        truth, tracks = frames.truth[left].tolist(), frames.track[right].tolist()
        out.append({"truth": truth, "tracks": tracks, "similarity": similarity.tolist(), "distance": pairs.tolist()})
    return out


def scene(seed: int) -> MatchedFrames:
    """Boxes or points; every other pair of scenes has no frame without truth or tracks."""
    boxes = seed % 2 == 0
    made = plain.random_scene(seed, boxes, frames=60, targets=5)
    if full(seed):
        made = {t: (truth, tracks) for t, (truth, tracks) in made.items() if len(truth) == 5 and tracks}
        made = dict(enumerate(made.values()))
    sides = plain.objects(made, 0), plain.objects(made, 1)
    return of_boxes(*sides) if boxes else of_points(*sides, LIMIT)


def full(seed: int) -> bool:
    return seed % 4 < 2


@pytest.fixture(scope="session")
def answers(peers: Path, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[MatchedFrames, dict[str, Any]]]:
    """Scenes with what both peers say of them."""
    scenes = [scene(seed) for seed in range(SCENES)]
    given = tmp_path_factory.mktemp("scenes") / "scenes.json"
    given.write_text(json.dumps([as_frames(frames) for frames in scenes]))
    return list(zip(scenes, ask(peers, given), strict=True))


def check_trackeval(frames: MatchedFrames, theirs: dict[str, Any], whole: bool) -> None:
    """`whole`: every target is in every frame and no frame lacks tracks, see below."""
    clear, who, higher = clear_mot(frames, CHALLENGE), identity(frames), hota(frames)
    counts = {"CLR_TP": clear.tp, "CLR_FP": clear.fp, "CLR_FN": clear.fn, "IDSW": clear.switches}
    counts |= {"IDTP": who.idtp, "IDFP": who.idfp, "IDFN": who.idfn}
    counts |= {"MT": int(np.sum(clear.tracked > 0.8)), "ML": clear.mostly_lost}
    if whole:
        # TrackEval counts a target that was away as fragmented, and forgets frames in which one side is empty.
        counts["Frag"] = clear.fragmentations
    assert {name: theirs[name] for name in counts} == counts
    rates = {"MOTA": clear.mota, "MOTP": clear.motp_similarity, "CLR_Re": clear.recall, "CLR_Pr": clear.precision}
    rates |= {"IDF1": who.idf1, "IDP": who.idp, "IDR": who.idr}
    assert {name: theirs[name] for name in rates} == pytest.approx(rates, rel=1e-12)
    names = {"HOTA": "hota", "DetA": "det_a", "AssA": "ass_a", "LocA": "loc_a"}
    names |= {"DetRe": "det_re", "DetPr": "det_pr", "AssRe": "ass_re", "AssPr": "ass_pr", "HOTA_TP": "tp"}
    for name, own in names.items():
        np.testing.assert_allclose(getattr(higher, own), theirs[name], rtol=1e-12, atol=1e-15, err_msg=name)


def test_figures_are_those_of_trackeval(answers: list[tuple[MatchedFrames, dict[str, Any]]]) -> None:
    for seed, (frames, theirs) in enumerate(answers):
        check_trackeval(frames, theirs["trackeval"], full(seed))


def test_figures_are_those_of_motmetrics(answers: list[tuple[MatchedFrames, dict[str, Any]]]) -> None:
    for frames, both in answers:
        theirs, clear, who = both["motmetrics"], clear_mot(frames, CLASSIC), identity(frames)
        counts = {
            "num_detections": clear.tp,
            "num_false_positives": clear.fp,
            "num_misses": clear.fn,
            "num_switches": clear.switches,
            "num_fragmentations": clear.fragmentations,
            "mostly_tracked": clear.mostly_tracked,
            "partially_tracked": clear.partly_tracked,
            "mostly_lost": clear.mostly_lost,
            "idtp": who.idtp,
            "idfp": who.idfp,
            "idfn": who.idfn,
        }
        assert {name: theirs[name] for name in counts} == counts
        rates = {"mota": clear.mota, "motp": clear.motp, "recall": clear.recall, "precision": clear.precision}
        rates |= {"idf1": who.idf1, "idp": who.idp, "idr": who.idr}
        assert {name: theirs[name] for name in rates} == pytest.approx(rates, rel=1e-12)


def read(path: Path, table: type[B]) -> B:
    file, options = [BoxFile(path, "view")], BoxOptions()
    times = {"view": rate_times(Fraction(25), "given")}
    return table.concat(read_boxes(file, survey_boxes(file, (), options), times, (), options, table))


def side(boxes: Boxes, view: int) -> Objects:
    there = boxes.take(boxes.box >= 0)
    position = np.column_stack([there.left_px, there.top_px, there.width_px, there.height_px])
    return Objects(there.frame, there.target_id.astype(np.int64), position, np.full(len(there), view))


def test_trackeval_reads_what_is_written_and_gives_the_same_figures(
    peers: Path, shared_data: Path, tmp_path: Path
) -> None:
    sides: list[tuple[Objects, Objects]] = []
    tracks = tmp_path / "tracks" / "ours" / "data"
    tracks.mkdir(parents=True)
    for view, name in enumerate(NAMES):
        folder = shared_data / "tud_mot" / name
        truth, found = read(folder / "gt.txt", TruthBoxes), read(folder / "test.txt", Boxes)
        length = int(max(truth.frame.max(), found.frame.max())) + 1
        write_sequence(tmp_path / "truth" / name, truth, WrittenSequence(name, length, 25.0, 640, 480))
        write_mot(tracks / f"{name}.txt", found, "tracks")
        sides.append((side(truth, view), side(found, view)))
    write_sequence_list(tmp_path / "list.txt", NAMES)
    known = dict(zip(NAMES, (of_boxes(*both) for both in sides), strict=True))
    pooled = [Objects(*map(np.concatenate, zip(*part, strict=True))) for part in zip(*sides, strict=True)]
    known["COMBINED_SEQ"] = of_boxes(*pooled)
    answer = ask(peers, tmp_path)
    assert sorted(answer) == ["MOT15", "MOT17", "MOT20"]
    for sequences in answer.values():
        assert sorted(sequences) == sorted(known)
        for name, frames in known.items():
            check_trackeval(frames, sequences[name], False)
