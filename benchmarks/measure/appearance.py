"""How well people are known by their looks: galleries of several viewing angles against those of one.

    python -m benchmarks.measure.appearance [--pets FOLDER] [--seeds 0-2] [--seconds 40] [--work DIR] [--json]

The first half of a recording is learnt, the second half is matched, with true boxes and true identities.
Recordings are rendered (`simulate --render`): four people in plain clothes and, `two-sided`, in shirts of
another colour behind, where the back of each looks like the front of the next.  With --pets the video of PETS
2009 S2.L1, view 1, frames 0 to 399; headings there come from the floor below the boxes.

Galleries: `front`, the front alone, with which every box is compared; `front, suspended`, the same, but only
boxes that show the front are compared; `all sides`, one density of all sides; `N angles` from the front to the
back.  Of boxes whose person is in the gallery: the share compared with its own person, of these rank-1 and AUC,
and rank-1 and AUC once more of the boxes and people that all galleries but the front's have (`common`); the
shares of all boxes that get a right and a wrong identity by `occlog label`, those of people who are not in the
gallery included; and of tracks cut into pieces of 4 s, as after losses, the shares named right and wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.measure.pets_detection import ingest
from occlog.array_types import NS, Bools, Floats, Ints, Ints32
from occlog.cli.main import run as occlog
from occlog.core.metrics.ranking import area_under_curve, rank_one
from occlog.measure.appearance.config import LearnConfig, MatchConfig
from occlog.measure.appearance.run import SightingFiles, SightingInput
from occlog.measure.appearance.sightings import Sighting, SightingTally, observe_boxes
from occlog.measure.appearance.stage import EvidenceTally, identities, learn, match, sides_of
from occlog.records.declared.people import SAME
from occlog.records.tables import AppearanceMatches, Gallery
from occlog.settings import configure

SCENE = """\
occlog_scene: 1
length_unit: m
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
room_height: 2.8
cameras:
- {name: southwest, position: [0.1, 0.1, 2.4], yaw_deg: 37, pitch_deg: -15, focal_px: 220, image_size_px: [400, 260]}
- {name: southeast, position: [7.9, 0.1, 2.4], yaw_deg: 143, pitch_deg: -15, focal_px: 220, image_size_px: [400, 260]}
- {name: northeast, position: [7.9, 5.9, 2.4], yaw_deg: 217, pitch_deg: -15, focal_px: 220, image_size_px: [400, 260]}
- {name: northwest, position: [0.1, 5.9, 2.4], yaw_deg: 323, pitch_deg: -15, focal_px: 220, image_size_px: [400, 260]}
"""
PEOPLE = 4
PIECE_S = 4
STEPS = {"2 angles": 180.0, "4 angles": 60.0, "7 angles": 30.0}
FRONT, FRONT_ONLY, ALL = "front", "front, suspended", "all sides"
GALLERIES = (FRONT, FRONT_ONLY, ALL, *STEPS)
COMMON = (ALL, *STEPS)
"""Galleries that are compared on the same boxes."""
FIGURES = (
    "compared", "rank-1", "AUC", "rank-1, common", "AUC, common", "right", "wrong", "pieces right", "pieces wrong"
)  # fmt: skip


def quietly(args: list[str]) -> None:
    """Run a command; its summary does not belong to the figures."""
    with contextlib.redirect_stdout(sys.stderr):
        code = occlog(args)
    if code != 0:
        raise SystemExit(code)


def rendered(work: Path, seed: int, seconds: int, two_sided: bool) -> Path:
    """A recording of people who walk about."""
    (work / "scene.yaml").write_text(SCENE)
    out = work / f"{'two' if two_sided else 'plain'}{seed}_{seconds}.mcap"
    if not out.exists():
        sizes = ["--targets", str(PEOPLE), "--seconds", str(seconds), "--rate", "5", "--seed", str(seed)]
        own = ["--two-sided"] if two_sided else []
        quietly(["simulate", str(work / "scene.yaml"), "-o", str(out), "--render", *sizes, *own, "-q"])
    return out


def seen(recording: Path) -> list[Sighting]:
    """What the true boxes of a recording show, with their true identities."""
    files = SightingFiles(boxes=recording, images=recording, tracks=None, scene=None)
    inputs = SightingInput(files, labelled=False)
    config = LearnConfig.in_unit(inputs.scene.length_unit)
    found = observe_boxes(
        inputs.boxes(),
        inputs.images(),
        inputs.walks(config),
        inputs.scene,
        config,
        levels=config.colour_levels,
        own_identity=True,
        tally=SightingTally(),
    )
    return list(found)


def gallery_of(rows: Iterable[Sighting], kind: str) -> Gallery:
    """A gallery of one kind."""
    config = configure(LearnConfig(), {"angle_step": {ALL: 360.0}.get(kind, STEPS.get(kind, 30.0))})
    whole = learn(rows, config)
    if kind not in (FRONT, FRONT_ONLY):
        return whole
    front = whole.take(whole.angle == 1)
    if kind == FRONT_ONLY:
        return front
    return Gallery.merge([replace(front, angle=np.full(len(front), n + 1, dtype=np.int32)) for n in range(7)])


class Matched(NamedTuple):
    """Likenesses of n boxes to R people."""

    table: AppearanceMatches  # n R rows
    target: Ints32  # (R,)
    track: Ints32  # (n,)
    like: Floats  # (n, R)

    def of(self, boxes: Bools, people: Ints32) -> tuple[Floats, Ints]:
        """Likenesses of some boxes, of these people each, to these people, and the place of each box's own."""
        columns = np.searchsorted(self.target, people)
        return self.like[np.ix_(boxes, columns)], np.searchsorted(people, self.track[boxes])

    def compared(self) -> Bools:
        """(n,) boxes that are compared with their own person."""
        place = np.minimum(np.searchsorted(self.target, self.track), len(self.target) - 1)
        own = self.target[place] == self.track
        return np.asarray(own & np.isfinite(self.like[np.arange(len(place)), place]))


def matched(rows: list[Sighting], gallery: Gallery, similarity_limit: float) -> Matched:
    """All boxes beside a gallery."""
    sides = sides_of(gallery)
    table = AppearanceMatches.concat(match(rows, sides, MatchConfig(min_similarity=similarity_limit)))
    n = len(sides.target)
    return Matched(table, sides.target, table.track_id[::n], table.rho_corrected.reshape(-1, n))


def figures(found: Matched, common: Bools, people: Ints32) -> dict[str, float]:
    """The figures; of `common` boxes and people those of that name."""
    compared, n = found.compared(), len(found.target)
    like, owner = found.of(compared, found.target)
    known = np.isin(found.track, found.target)
    same = found.table.decision == SAME
    right = same & (found.table.target_id == found.table.track_id)
    out = {
        "compared": compared[known].mean(),
        "rank-1": rank_one(like, owner) if n > 1 else np.nan,
        "AUC": area_under_curve(like, owner),
        "right": right.sum() / known.sum(),
        "wrong": (same & ~right).sum() / len(found.track),
        "rank-1, common": np.nan,
        "AUC, common": np.nan,
    }
    if (common & ~compared).sum() == 0 and np.isin(people, found.target).all():
        like, owner = found.of(common, people)
        out |= {"rank-1, common": rank_one(like, owner), "AUC, common": area_under_curve(like, owner)}
    return {name: float(value) for name, value in out.items()}


def pieces(table: AppearanceMatches, target: Ints32, similarity_limit: float) -> dict[str, float]:
    """Shares of pieces of tracks that are named right and wrong."""
    number = (table.t_ns - table.t_ns[0]) // (PIECE_S * NS)
    piece = (number * 1000 + table.track_id).astype(np.int32)
    tally = EvidenceTally()
    tally.add(replace(table, track_id=piece))
    evidence = tally.evidence()
    together = evidence.track[:, None] // 1000 == evidence.track[None, :] // 1000
    named = identities(evidence, together, similarity_limit, 10)
    wanted = [p for p in np.unique(piece).tolist() if p % 1000 in target]
    right = sum(named.get(p) == p % 1000 for p in wanted)
    wrong = sum(who != p % 1000 for p, who in named.items())
    return {"pieces right": right / len(wanted), "pieces wrong": wrong / len(wanted)}


def halves(recording: Path, similarity_limit: float) -> dict[str, dict[str, float]]:
    """The figures of each kind of gallery, learnt from the first half."""
    rows = seen(recording)
    times = [each.boxes.t_ns for each in rows]
    middle = (times[0] + times[-1]) // 2
    first, second = ([r for r in rows if (r.boxes.t_ns < middle) == early] for early in (True, False))
    found = {kind: matched(second, gallery_of(first, kind), similarity_limit) for kind in GALLERIES}
    people = reduce(np.intersect1d, (found[kind].target for kind in COMMON))
    common = np.all([found[kind].compared() for kind in COMMON], axis=0) & np.isin(found[ALL].track, people)
    return {
        kind: figures(own, common, people) | pieces(own.table, own.target, similarity_limit)
        for kind, own in found.items()
    }


def mean(results: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Means over recordings."""
    return {k: {f: float(np.mean([r[k][f] for r in results])) for f in FIGURES} for k in results[0]}


def main() -> None:
    """Print a table of each kind of recording."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measure.appearance", description=__doc__)
    parser.add_argument("--pets", type=Path, metavar="FOLDER", help="real video with true boxes")
    parser.add_argument("--seeds", default="0-2", metavar="A-B", help="of the rendered recordings; default 0-2")
    parser.add_argument("--seconds", type=int, default=40, help="length of them; default 40")
    least = MatchConfig().min_similarity
    parser.add_argument("--least-likeness", type=float, default=least, help=f"of an identity; default {least}")
    parser.add_argument("--work", type=Path, help="keep the recordings there")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        results = {
            name: mean([halves(rendered(work, seed, options.seconds, two), options.similarity_limit) for seed in seeds])
            for name, two in (("rendered, plain", False), ("rendered, two-sided", True))
        }
        if options.pets:
            if not (work / "pets.mcap").exists():
                ingest(options.pets, work)
            results["PETS, one view"] = halves(work / "pets.mcap", options.similarity_limit)
    if options.json:
        print(json.dumps(results, sort_keys=True))
        return
    for name, table in results.items():
        print(f"\n| {name} | {' | '.join(FIGURES)} |\n|{'---|' * (len(FIGURES) + 1)}")
        for kind, row in table.items():
            print(f"| {kind} | {' | '.join(f'{row[f]:.3f}' for f in FIGURES)} |")


if __name__ == "__main__":
    main()
