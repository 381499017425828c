"""`track` after `calibrate` against `track` with the true calibration, through the command line.

    python -m benchmarks.track.calibrated_tracks [--rooms N] [--seed N] [--cameras N] [--seconds S]
        [--sigma-position M --sigma-angle DEG] [--smooth]

Rooms, lenses, detectors and people are those of `benchmarks.setups`.  All poses are off by errors that are drawn with
the stated standard deviations, then `occlog calibrate` is given these.  Compared are the tracks of method `jipda` with
the true, the rough and the calibrated cameras; with these also after the common similarity transform by which the
calibrated cameras differ from the true ones, without the part of covariances that is due to it.  The normalised squared
errors (NSE) of that transform are 1 in the mean if `sigma_all_cameras` is right.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow.parquet as pq
from scipy.optimize import linear_sum_assignment

from benchmarks.setups import _rigs
from occlog.array_types import NS, Floats
from occlog.cli.main import run as run_command
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.records.scene import Camera, CommonNoise, Scene

MATCH_M = 1.0
"""Largest distance of a track and a person who are matched."""
CHI2_95 = 5.991


class Tracked(NamedTuple):
    """IDF1, and distances [m] and normalised squared errors of the matched positions (n,)."""

    idf1: float
    error_m: Floats
    nees: Floats

    @property
    def figures(self) -> list[float]:
        """IDF1, root mean square of the distances [m], mean and median NEES, share inside the 95 % ellipse."""
        inside = float((self.nees < CHI2_95).mean())
        return [
            self.idf1,
            float(np.sqrt((self.error_m**2).mean())),
            float(self.nees.mean()),
            float(np.median(self.nees)),
            inside,
        ]


class Similarity(NamedTuple):
    """Similarity transform of the plane from the calibrated to the true world: z -> factor (z - from_) + to."""

    factor: complex
    from_: complex
    to: complex

    @classmethod
    def of_cameras(cls, found: list[Camera], true: list[Camera]) -> Similarity:
        """The one that moves the positions of the cameras to the true ones, by least squares."""
        ours, real = (np.array([complex(*c.position[:2].tolist()) for c in each]) for each in (found, true))
        z, w = ours - ours.mean(), real - real.mean()
        return cls(complex((w * np.conj(z)).sum() / (np.abs(z) ** 2).sum()), complex(ours.mean()), complex(real.mean()))


def command(*words: str | Path) -> dict[str, Any]:
    """Run a command of occlog in this process; return its summary."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = run_command([str(word) for word in (*words, "-q", "--json")])
    if code != 0:
        raise RuntimeError(f"{' '.join(map(str, words))}: {code}: {out.getvalue()}")
    return dict(json.loads(out.getvalue()))


def rough_cameras(cameras: list[Camera], position: float, angle: float, rng: np.random.Generator) -> list[Camera]:
    """Cameras with errors of their positions [m] and angles [rad] of these standard deviations."""
    return [
        replace(
            c, position=c.position + rng.normal(0.0, position, 3),
            rotation=rotation_from_angles(*(np.array(angles_from_rotation(c.rotation)) + rng.normal(0, angle, 3))),
        )
        for c in cameras
    ]  # fmt: skip


def moved_truth(truth: Floats, moved: Similarity) -> Floats:
    """True positions (M, 4), frame, identity, x and y, in the world of the calibrated cameras."""
    at = (truth[:, 2] + 1j * truth[:, 3] - moved.to) / moved.factor + moved.from_
    return np.column_stack([truth[:, :2], at.real, at.imag])


def tracked(folder: Path, scene: Path, *, smooth: bool) -> Path:
    """Track the recording of a folder with a scene; return the table."""
    out = folder / f"{scene.stem}{'-smooth' if smooth else ''}.parquet"
    extra = ["--smooth"] if smooth else []
    command("track", folder / "walk.mcap", "--method", "jipda", "--scene", scene, *extra, "-o", out)
    return out


def evaluated(tracks: Path, truth: Floats, fps: float, without: CommonNoise | None = None) -> Tracked:
    """IDF1 of tracks by `occlog evaluate`, and the errors of positions that are matched within `MATCH_M`, by frame.

    `truth` (M, 4) are frame, identity, x and y; the effect of the noise `without` is taken from the covariances.
    """
    times = tracks.parent / "moved.csv"
    rows = [f"{f / fps:.9g},{int(i)},{x:.9g},{y:.9g}" for f, i, x, y in truth.tolist()]
    times.write_text("\n".join(["t_s,target_id,x,y", *rows]) + "\n")
    metrics = command("evaluate", tracks, "--truth", times)
    table = pq.read_table(tracks)
    frame = np.round(table["t_ns"].to_numpy() / NS * fps)
    at = np.column_stack([table["x"].to_numpy(), table["y"].to_numpy()])
    xx, xy, yy = (table[f"cov_{name}"].to_numpy() for name in ("xx", "xy", "yy"))
    P = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
    if without is not None:
        P = P - without.covariances(np.column_stack([at, np.zeros((len(at), 4))]))[:, :2, :2]
    out = []
    for k in np.unique(truth[:, 0]):
        own, real = np.flatnonzero(frame == k), truth[truth[:, 0] == k, 2:]
        off = at[own, None] - real[None]
        away = np.linalg.norm(off, axis=-1)
        for i, j in zip(*linear_sum_assignment(np.where(away < MATCH_M, away, 1e3)), strict=True):
            if away[i, j] < MATCH_M:
                out.append((away[i, j], off[i, j] @ np.linalg.solve(P[own[i]], off[i, j])))
    return Tracked(float(metrics["idf1"]), *np.array(out).T)


class Room(NamedTuple):
    """Result of a room: figures of tracks by scene, NSE and size of the common similarity transform."""

    figures: dict[str, list[float]]
    nse: Floats
    transform: Floats


def room(seed: int, cameras: int, position: float, angle_deg: float, folder: Path, *, smooth: bool) -> Room:
    """Calibrate the cameras of a room, and track with the true, rough and calibrated ones.

    The transform and its NSE are x, y [m], yaw [deg] and log of the scale.
    """
    rig = _rigs.rig(seed, cameras)
    true = [rig.cameras[name] for name in rig.names]
    files = _rigs.write(rig, folder)
    for name, cams in (
        ("true", true),
        ("rough", rough_cameras(true, position, np.radians(angle_deg), np.random.default_rng((seed, 11)))),
    ):
        (folder / f"{name}.yaml").write_text(scene_to_yaml(Scene(tuple(cams))))
    boxes = [word for name, path in files["boxes"].items() for word in ("--boxes", f"{name}={path}")]
    fps = float(rig.fps)
    command("ingest", *boxes, "--scene", folder / "rough.yaml", "--fps", fps, "-o", folder / "walk.mcap")
    stated = ["--sigma-position", position, "--sigma-angle", angle_deg]
    summary = command("calibrate", folder / "walk.mcap", *stated, "-o", folder / "found.yaml")
    scene = read_scene(folder / "found.yaml")
    found = {c.name: c for c in scene.cameras}
    moved = Similarity.of_cameras([found[name] for name in rig.names], true)
    away, sigma = moved.from_ - moved.to, summary["sigma_all_cameras"]
    transform = np.array([away.real, away.imag, np.degrees(np.angle(moved.factor)), np.log(abs(moved.factor))])
    nse = (transform / [sigma[name] for name in ("x", "y", "yaw_deg", "scale")]) ** 2
    inner, out = moved_truth(rig.truth, moved), {}
    for again in (False, True)[: 1 + smooth]:
        end = ", smoothed" if again else ""
        for name in ("true", "found") if again else ("true", "rough", "found"):
            table = tracked(folder, folder / f"{name}.yaml", smooth=again)
            out[name + end] = evaluated(table, rig.truth, fps).figures
            if name == "found":
                out["found, moved" + end] = evaluated(table, inner, fps, scene.common_noise).figures
    return Room(out, nse, transform)


def main() -> None:
    """Calibrate, track, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--seed", type=int, default=700_000)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--sigma-position", type=float, default=0.3)
    parser.add_argument("--sigma-angle", type=float, default=3.0)
    parser.add_argument("--smooth", action="store_true")
    given = parser.parse_args()
    _rigs.SECONDS = given.seconds
    rooms = []
    for seed in range(given.seed, given.seed + given.rooms):
        with tempfile.TemporaryDirectory() as folder:
            try:
                rooms.append(
                    room(
                        seed, given.cameras, given.sigma_position, given.sigma_angle, Path(folder), smooth=given.smooth
                    )
                )
            except RuntimeError as error:
                print(f"{seed}: {error}", flush=True)
                continue
        print(seed, "transform", np.round(rooms[-1].transform, 4), "NSE", np.round(rooms[-1].nse, 2), flush=True)
        for name, row in rooms[-1].figures.items():
            print(f"  {name:22}", np.round(row, 3), flush=True)
    print("mean of the rooms: IDF1, RMSE [m], mean and median NEES, share inside 95 %")
    for name in rooms[0].figures:
        print(f"  {name:22}", np.round(np.mean([each.figures[name] for each in rooms], axis=0), 3))
    print("NSE of the common x, y, yaw, scale:", np.round(np.mean([each.nse for each in rooms], axis=0), 2))


if __name__ == "__main__":
    main()
