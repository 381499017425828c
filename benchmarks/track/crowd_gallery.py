"""What a gallery of looks is worth to the tracks of everybody, where cameras lose people.

    python -m benchmarks.track.crowd_gallery [--seeds 0-2] [--people 6,12] [--work DIR]

Two kinds of recordings of 30 s at 5 frames a second:

* rendered rooms with four people in shirts of another colour behind, regions of `occlog detect`; the gallery is learnt
  from a recording of another seed, in which the same people walk about before four cameras;
* simulated crowds of `crowd_colours`, two cameras that do not see all of the room; boxes have histograms of 72 colours,
  Dirichlet about those of the person, and the gallery has what each person wears.

`occlog track --method jipda` with `--gallery` and without, filter and `--smooth`, on the same boxes: means over the
seeds with standard errors.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.measure.appearance import quietly, rendered
from benchmarks.peers.views_peer import seeds
from benchmarks.references import scene
from benchmarks.track.crowd import cell
from occlog.array_types import NS
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.on_ground import evaluate_ground
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.open import open_input
from occlog.records.declared.people import MAX_BINS
from occlog.records.tables import APPEARANCE_BINS, Gallery, Tracks, Truth, Views

SECONDS, FRAMES, HZ, CAMERAS, SIZE = 30, 150, 5.0, 2, (10.0, 8.0)
ALIKE = 300.0
"""Concentration of the histograms of a person's boxes: 72 colours of 16 have as much noise as 67 of 16 colours."""
SETTINGS = {"southwest": ["southwest"], "southwest, northeast": ["southwest", "northeast"]}
WAYS = {"filter": [], "`--smooth`": ["--smooth"]}
FIGURES = {"IDF1": "idf1", "MOTA": "mota", "switches": "id_switches", "identities": "tracks"}


class Given:
    """What is tracked, and the truth."""

    def __init__(self, boxes: Path, where: Path, gallery: Path, truth: Truth) -> None:
        self.boxes, self.where, self.gallery, self.truth = boxes, where, gallery, truth

    def figures(self, work: Path, *arguments: str) -> dict[str, float]:
        """Of one run."""
        out = work / "tracks.parquet"
        given = [str(self.boxes), "--scene", str(self.where), "--method", "jipda", *arguments]
        quietly(["track", *given, "-o", str(out), "--overwrite", "-q", "--json"])
        tracks = read_table(out, Tracks)
        got = evaluate_ground(tracks, self.truth, MultiTargetConfig.in_unit("m"), None).metrics
        got["tracks"] = float(len(np.unique(tracks.target_id)))
        return {name: got[key] for name, key in FIGURES.items()}


def room(work: Path, seed: int) -> Given:
    """A rendered room and the gallery of another recording."""
    recording, other = (rendered(work, s, SECONDS, True) for s in (seed, seed + 1))
    gallery, views = work / f"gallery{seed}.parquet", work / f"views{seed}.parquet"
    if not views.exists():
        quietly(["appearance", "learn", str(other), "-o", str(gallery), "--overwrite", "-q"])
        quietly(["detect", str(recording), "-o", str(work / "b.parquet"), "--views", str(views), "--overwrite", "-q"])
    return Given(views, recording, gallery, open_input(recording).read(Truth))


def crowd(work: Path, people: int, seed: int) -> Given:
    """A simulated crowd, and a gallery of what everybody wears."""
    made = scene("crowds").crowd(people, CAMERAS, FRAMES, HZ, SIZE, seed=seed, colours=APPEARANCE_BINS, similar=ALIKE)
    frames_of_step = [(t, frame_detections) for t, group in enumerate(made.moments) for frame_detections in group]
    frame = np.concatenate([np.full(len(frame_detections.boxes), t) for t, frame_detections in frames_of_step])
    edges = np.concatenate([frame_detections.boxes for _, frame_detections in frames_of_step])
    n = len(edges)
    nan, one, zero = np.full(n, np.nan), np.ones(n), np.zeros(n)
    unknown = dict.fromkeys(("bearing", "sigma", "u_px", "sigma_px", "confidence", "similarities"), nan)
    size = edges[:, 2:] - edges[:, :2]
    views = Views.of(
        t_ns=np.rint(frame * NS / HZ).astype(np.int64),
        sensor=np.repeat(
            [made.scene.cameras[frame_detections.camera].name for _, frame_detections in frames_of_step],
            [len(k.boxes) for _, k in frames_of_step],
        ),
        frame=frame,
        cluster=np.concatenate(
            [np.arange(len(frame_detections.boxes)) for _, frame_detections in frames_of_step]
        ).astype(np.int32),
        x_px=edges[:, [0, 2]].mean(axis=1),
        y_px=edges[:, [1, 3]].mean(axis=1),
        left_px=edges[:, 0],
        top_px=edges[:, 1],
        width_px=size[:, 0],
        height_px=size[:, 1],
        area_px=0.5 * size.prod(axis=1),
        cov_xx_px=one,
        cov_xy_px=zero,
        cov_yy_px=one,
        target_id=np.full(n, -1, dtype=np.int32),
        appearance=np.concatenate([frame_detections.appearance for _, frame_detections in frames_of_step]).astype(
            np.float32
        ),
        **unknown,
    )
    boxes, where, gallery = (work / f"crowd{people}_{seed}.{end}" for end in ("parquet", "yaml", "gallery.parquet"))
    write_table(boxes, views, Provenance("detect"), overwrite=True)
    where.write_text(scene_to_yaml(made.scene))
    write_table(gallery, _worn(people, seed), Provenance("appearance learn"), overwrite=True)
    t, person = (a.ravel() for a in np.meshgrid(range(FRAMES), range(people), indexing="ij"))
    truth = Truth.of(
        t_ns=np.rint(t * NS / HZ).astype(np.int64),
        target_id=person.astype(np.int32),
        x=made.truth[..., 0].ravel(),
        y=made.truth[..., 1].ravel(),
        z=np.full(len(t), np.nan),
        role=np.full(len(t), "target"),
    )
    return Given(boxes, where, gallery, truth)


def _worn(people: int, seed: int) -> Gallery:
    """What everybody wears, by the same draws as the crowd's."""
    clothes = np.random.default_rng((seed, 1)).dirichlet(np.ones(APPEARANCE_BINS), people)
    one = np.ones(people, dtype=np.int32)
    density = np.zeros((people, MAX_BINS))
    density[:, :APPEARANCE_BINS] = clothes
    return Gallery.of(
        t_ns=np.zeros(people, dtype=np.int64),
        target_id=np.arange(people, dtype=np.int32),
        angle=one,
        angles=one,
        bins=APPEARANCE_BINS * one,
        samples=100 * one,
        pixels=1_000_000 * one.astype(np.int64),
        density=density,
    )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.track.crowd_gallery", description=__doc__)
    parser.add_argument("--people", default="6,12", help="numbers of people in the crowds, joined by commas")
    parser.add_argument("--seeds", type=seeds, default=seeds("0-2"), help="default 0-2")
    parser.add_argument("--work", type=Path, help="keep the recordings there")
    options = parser.parse_args()
    print(f"| | | {' | '.join(FIGURES)} |\n|---|---|{'---|' * len(FIGURES)}")
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        cases = [(name, [room(work, s) for s in options.seeds], cameras) for name, cameras in SETTINGS.items()]
        cases += [
            (f"{n} people", [crowd(work, int(n), s) for s in options.seeds], []) for n in options.people.split(",") if n
        ]
        for name, given, cameras in cases:
            chosen = ["--cameras", ",".join(cameras)] if cameras else []
            for way, arguments in WAYS.items():
                for looks in (False, True):
                    runs = [
                        each.figures(work, *arguments, *chosen, *(["--gallery", str(each.gallery)] if looks else []))
                        for each in given
                    ]
                    cells = " | ".join(cell([run[k] for run in runs]) for k in FIGURES)
                    print(f"| {name} | {way}{', `--gallery`' if looks else ''} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
