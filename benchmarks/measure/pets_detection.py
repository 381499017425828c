"""Detection on real video against true boxes: PETS 2009 S2.L1, view 1, frames 0 to 399.

    python -m benchmarks.measure.pets_detection FOLDER [--json]

FOLDER holds `vtest.avi`, `calibration/View_001.xml` and the annotations (it is not
shipped).  For each method and background model: recall, precision and the horizontal
error of the regions' centres.

A region is a true person's if the boxes overlap by at least half (intersection over
union, rule `box`), or if its centre lies in the middle half of the true box, across and
along (rule `centre`: what a bearing needs); one region for one person, as many pairs as
possible.  People are `clear`, in
`front` of another, partly `hidden` by another (a nearer box covers more than 10 % of
theirs), or behind the `sign` post in the middle of the image (it covers more than 10 %).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.cli.main import run as occlog
from occlog.core.geometry.camera import wrap_angle
from occlog.core.metrics.errors import intersection_areas, intersection_over_union, pair_within
from occlog.evaluate.bearings.detections import CLASSES, SHARED, box_classes
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.measure.detect.by_background.learning import learn
from occlog.measure.detect.by_background.stage import detect
from occlog.measure.detect.config import DetectConfig
from occlog.records.tables import TruthBoxes, Views

CAMERA = "View_001"
LAST = 400  # frames with true boxes
RULES = ("box", "centre")
SIGN = np.array([[413.0, 204.0, 33.0, 40.0], [426.0, 244.0, 12.0, 148.0]])  # plate and post
KINDS = (*CLASSES, "sign")


class Matched(NamedTuple):
    """True boxes of all frames, one row each, and the number of regions."""

    kind: Ints
    error_px: Floats  # NaN: not found
    error_sigma: Floats  # error of the bearing over its stated standard deviation
    regions: int


def ingest(folder: Path, work: Path) -> McapRecording:
    """The recording, linked to the video."""
    annotations = next((folder / "annotations").glob("*.xml"))
    args = ["--calibration", str(folder / "calibration" / f"{CAMERA}.xml")]
    args += ["--video", f"{CAMERA}={folder / 'vtest.avi'}", "--truth", f"{CAMERA}={annotations}"]
    # The command's own summary does not belong to the figures.
    with contextlib.redirect_stdout(sys.stderr):
        code = occlog(["ingest", "-o", str(work / "pets.mcap"), *args, "--store", "link", "-q"])
    if code != 0:
        raise SystemExit(code)
    return open_recording(work / "pets.mcap")


def kinds(boxes: Floats) -> Ints:
    """(n,) index into KINDS of the (n, 4) true boxes of a frame."""
    out = box_classes(boxes)
    behind = intersection_areas(boxes, SIGN).sum(axis=1) / np.prod(boxes[:, 2:], axis=1) > SHARED
    return np.where(behind & (boxes[:, 1] + boxes[:, 3] < 392.0), KINDS.index("sign"), out)


def columns(table: Views | TruthBoxes) -> Floats:
    """(n, 4) boxes."""
    return np.column_stack([table.left_px, table.top_px, table.width_px, table.height_px])


def costs(rule: str, found: Views, boxes: Floats) -> Floats:
    """(regions, boxes) cost of a pair, at most 0.5 for one that the rule allows."""
    if rule == "box":
        return 1.0 - intersection_over_union(columns(found), boxes)
    centres = boxes[:, :2] + 0.5 * boxes[:, 2:]
    away = np.abs(np.column_stack([found.x_px, found.y_px])[:, None] - centres) / boxes[:, 2:]
    return 2.0 * away.max(axis=2)


def match(recording: McapRecording, views: Views, frames: range, rule: str) -> Matched:
    """Regions of some frames paired with the true boxes."""
    camera = recording.scene.camera(CAMERA)  # type: ignore[union-attr]
    truth = recording.read(TruthBoxes)
    parts: list[tuple[Ints, Floats, Floats]] = []
    regions = 0
    for k in frames:
        mine, real = views.take(views.frame == k), truth.take((truth.frame == k) & (truth.box >= 0))
        boxes = columns(real)
        error, normal = np.full(len(real), np.nan), np.full(len(real), np.nan)
        centres = boxes[:, :2] + 0.5 * boxes[:, 2:]
        for i, j in pair_within(costs(rule, mine, boxes), 0.5):
            error[j] = mine.x_px[i] - centres[j, 0]
            normal[j] = wrap_angle(mine.bearing[i] - camera.bearings(centres[j : j + 1]))[0] / mine.sigma[i]
        parts.append((kinds(boxes), error, normal))
        regions += len(mine)
    return Matched(*(np.concatenate(c) for c in zip(*parts, strict=True)), regions)  # type: ignore[arg-type]


def figures(m: Matched) -> dict[str, Any]:
    """Recall, precision, errors [px]; by class: true boxes, recall, errors, root mean square of error over sigma."""
    found = np.isfinite(m.error_px)
    out: dict[str, Any] = {"recall": found.mean(), "precision": found.sum() / m.regions}
    for number, name in enumerate(KINDS):
        mine = m.kind == number
        good = mine & found
        out[name] = {
            "boxes": int(mine.sum()),
            "recall": found[mine].mean(),
            "rms_px": np.sqrt(np.mean(m.error_px[good] ** 2)),
            "median_px": np.median(np.abs(m.error_px[good])),
            "rms_sigma": np.sqrt(np.mean(m.error_sigma[good] ** 2)),
        }
    return out


def cases(recording: McapRecording) -> Iterator[tuple[str, Views]]:
    """Regions of every combination of method and background model."""
    scene = recording.scene
    if scene is None:
        raise SystemExit(f"{recording.path}: holds no scene")
    learned, _ = learn(recording.frames(), scene, DetectConfig())
    for method in ("em", "components"):
        for background in ("mog2", "knn"):
            frames = (f for f in recording.frames() if f.index < LAST)
            parts = detect(frames, scene, DetectConfig(method=method, background=background), 1, learned)
            yield f"{method} {background}", Views.concat(p.views for p in parts)


def show(name: str, got: dict[str, Any]) -> None:
    """A few lines for a person."""
    print(f"{name}: recall {got['recall']:.3f}, precision {got['precision']:.3f}")
    for kind in KINDS:
        c = got[kind]
        print(
            f"  {kind:<7}{c['boxes']:5d} boxes, recall {c['recall']:.3f}, horizontal error rms {c['rms_px']:.1f} px, "
            f"median {c['median_px']:.1f} px, over sigma {c['rms_sigma']:.2f}"
        )


def main() -> None:
    """Run all combinations."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measure.pets_detection", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    results = {}
    with tempfile.TemporaryDirectory() as work:
        recording = ingest(options.folder, Path(work))
        for name, views in cases(recording):
            spans = {"frames 0-399": range(LAST), "frames 0-199": range(200), "frames 200-399": range(200, LAST)}
            for span, frames in spans.items():
                for rule in RULES:
                    results[f"{name}, {span}, rule {rule}"] = figures(match(recording, views, frames, rule))
    if options.json:
        print(json.dumps(results, sort_keys=True, default=float))
        return
    for name, got in results.items():
        show(name, got)


if __name__ == "__main__":
    main()
