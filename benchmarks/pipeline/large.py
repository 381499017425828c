"""Peak memory of the commands that read whole tables, on tables of rising length."""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from occlog.core.geometry.camera import planar_offsets, u_to_azimuth
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import (
    APPEARANCE_BINS,
    Bearings,
    Boxes,
    Diagnostics,
    Events,
    Measurements,
    PeopleTracks,
    Tracks,
    Truth,
    TruthBoxes,
    Views,
)

NAME = "large"
SUMMARY = "peak memory of evaluate, report, diff, export and info: ten times as many rows to fewer"
LIMIT = 1.25
ROWS = int(os.environ.get("OCCLOG_BENCHMARK_ROWS", "800000"))
"""Rows of the shorter tables; as many as are drawn whole by `report` where only every fourth is one of theirs."""
STEP_NS, CHUNK = 10**8, 50_000
PEOPLE = 50
PLACES = {"a": (0.0, 0.0), "b": (20.0, 0.0), "c": (20.0, 20.0), "d": (0.0, 20.0)}
"""Cameras, which look at the middle of a room."""


def make(folder: Path, rows: int) -> None:
    """A track and its truth of so many rows, and the errors that `evaluate` finds."""
    folder.mkdir()
    made = Provenance("track")
    with (
        TableWriter(folder / "tracks.parquet", Tracks, made) as tracks,
        TableWriter(folder / "truth.parquet", Truth, made) as truth,
    ):
        for start in range(0, rows, CHUNK):
            step = np.arange(start, min(start + CHUNK, rows))
            n, error = len(step), np.random.default_rng(start).normal(0.0, 0.1, (2, len(step)))
            x, y = 4.0 * np.cos(0.02 * step), 4.0 * np.sin(0.022 * step)
            shared = {"t_ns": step * STEP_NS, "target_id": np.zeros(n, np.int32)}
            truth.write(Truth.of(**shared, role=np.full(n, "target"), x=x, y=y, z=np.zeros(n)))
            spread = {"cov_xx": np.full(n, 0.01), "cov_xy": np.zeros(n), "cov_yy": np.full(n, 0.01)}
            tracks.write(Tracks.of(**shared, x=x + error[0], y=y + error[1], vx=error[0], vy=error[1], **spread))


def make_many(folder: Path, rows: int) -> None:
    """Tracks of `PEOPLE` people who walk apart and are exchanged now and then, in the world and in two cameras."""
    random, names = np.random.default_rng(7), np.arange(PEOPLE)
    made, phase = Provenance("track"), random.uniform(0.0, 2.0 * np.pi, PEOPLE)
    middle = 3.0 * np.stack([np.arange(PEOPLE) % 7, np.arange(PEOPLE) // 7])
    with (
        TableWriter(folder / "many.parquet", Tracks, made) as tracks,
        TableWriter(folder / "people.parquet", Truth, made) as truth,
        TableWriter(folder / "boxes.parquet", Boxes, made) as boxes,
        TableWriter(folder / "true_boxes.parquet", TruthBoxes, made) as true_boxes,
        TableWriter(folder / "everybody.parquet", PeopleTracks, made) as people_tracks,
        TableWriter(folder / "events.parquet", Events, made) as events,
    ):
        for start in range(0, rows // PEOPLE, CHUNK // PEOPLE):
            step = np.arange(start, min(start + CHUNK // PEOPLE, rows // PEOPLE))
            n, labels = len(step) * PEOPLE, np.empty((len(step), PEOPLE), dtype=np.int32)
            for t in range(len(step)):
                if random.random() < 0.002:
                    i, j = random.integers(0, PEOPLE, 2)
                    names[[i, j]] = names[[j, i]]
                labels[t] = names
            x = (middle[0] + 1.3 * np.cos(0.02 * step[:, None] + phase)).ravel()
            y = (middle[1] + 1.3 * np.sin(0.017 * step[:, None] + 2.0 * phase)).ravel()
            t_ns, who = np.repeat(step * STEP_NS, PEOPLE), np.tile(np.arange(PEOPLE, dtype=np.int32), len(step))
            truth.write(Truth.of(t_ns=t_ns, target_id=who, role=np.full(n, "target"), x=x, y=y, z=np.zeros(n)))
            order = np.lexsort((labels.ravel(), t_ns))
            found, off = labels.ravel()[order], random.normal(0.0, 0.15, (2, n))
            spread = {"cov_xx": np.full(n, 0.0225), "cov_xy": np.zeros(n), "cov_yy": np.full(n, 0.0225)}
            ours = {"x": x[order] + off[0], "y": y[order] + off[1], "vx": np.zeros(n), "vy": np.zeros(n)}
            tracks.write(Tracks.of(t_ns=t_ns, target_id=found, **ours, **spread))
            there = {"existence": random.uniform(0.5, 1.0, n), "seen_by": random.choice(["", "a", "a,b"], n)}
            people_tracks.write(PeopleTracks.of(t_ns=t_ns, target_id=found, **ours, **spread, **there))
            first = np.arange(0, n, PEOPLE)
            kinds, empty = random.choice(["birth", "death", "doubt"], len(first)), np.full(len(first), -1)
            sure = np.full(len(first), 0.9)
            events.write(
                Events.of(t_ns=t_ns[first], target_id=found[first], kind=kinds, other_id=empty, probability=sure)
            )
            # Half of the people in each camera, 100 px a metre
            seen = {"t_ns": t_ns, "sensor": np.where(who < PEOPLE // 2, "a", "b"), "frame": np.repeat(step, PEOPLE)}
            size = {"width_px": np.full(n, 50.0), "height_px": np.full(n, 80.0), "confidence": np.full(n, np.nan)}
            place = {"left_px": 100.0 * x, "top_px": 100.0 * y}
            true_boxes.write(TruthBoxes.of(**seen, box=who, target_id=who, **place, **size))
            place = {"left_px": 100.0 * (x + 0.5 * off[0]), "top_px": 100.0 * (y + 0.5 * off[1])}
            boxes.write(Boxes.of(**seen, box=who, target_id=labels.ravel(), **place, **size))


def make_seen(folder: Path, rows: int) -> None:
    """Bearings and ranges of one person, with tracks, truth and a scene; the boxes of `make_many` as views."""
    made, middle, size = Provenance("detect"), 10.0, rows // len(PLACES)
    cameras = tuple(
        Camera(
            name=name,
            position=np.array([*position, 0.0]),
            rotation=camera_rotation(float(np.arctan2(middle - position[1], middle - position[0])), 0.0, 0.0),
            focal_px=np.array([500.0, 500.0]),
            principal_px=np.zeros(2),
            fov=np.pi / 2,
            sigma_read_px=2.0,
        )
        for name, position in PLACES.items()
    )
    room = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])
    (folder / "scene.yaml").write_text(scene_to_yaml(Scene(cameras=cameras, room=room)))
    with (
        TableWriter(folder / "seen_tracks.parquet", Tracks, made) as tracks,
        TableWriter(folder / "seen_truth.parquet", Truth, made) as truth,
        TableWriter(folder / "seen.parquet", Bearings, made) as bearings,
        TableWriter(folder / "fared.parquet", Diagnostics, made) as diagnostics,
        TableWriter(folder / "measured.parquet", Measurements, made) as measured,
    ):
        for start in range(0, size, CHUNK):
            step = np.arange(start, min(start + CHUNK, size))
            n, random = len(step), np.random.default_rng(start)
            x, y = middle + 4.0 * np.cos(0.02 * step), middle + 4.0 * np.sin(0.022 * step)
            off = random.normal(0.0, 0.1, (2, n))
            shared = {"t_ns": step * STEP_NS, "target_id": np.zeros(n, np.int32)}
            truth.write(Truth.of(**shared, role=np.full(n, "target"), x=x, y=y, z=np.zeros(n)))
            spread = {"cov_xx": np.full(n, 0.01), "cov_xy": np.zeros(n), "cov_yy": np.full(n, 0.01)}
            tracks.write(Tracks.of(**shared, x=x + off[0], y=y + off[1], vx=off[0], vy=off[1], **spread))
            reported = {c.name: np.zeros(n, c.dtype) for c in Diagnostics.columns() if not c.optional and c.kind != "U"}
            reported |= {c.name: np.full(n, "") for c in Diagnostics.columns() if not c.optional and c.kind == "U"}
            names = np.full(n, ",".join(PLACES))
            diagnostics.write(Diagnostics.of(**reported | shared | {"cameras": names, "ess": np.full(n, 100.0)}))
            u, azimuth, far = (np.empty((n, len(cameras))) for _ in range(3))
            for k, camera in enumerate(cameras):
                far[:, k] = np.hypot(x - camera.ground[0], y - camera.ground[1]) + random.normal(0.0, 0.1, n)
                h, d = planar_offsets(np.column_stack([x, y]), camera.ground, camera.yaw)
                u[:, k] = -500.0 * h / d + random.normal(0.0, 2.0, n)
                azimuth[:, k] = u_to_azimuth(u[:, k], camera.yaw, 500.0)
            at = np.repeat(step * STEP_NS, len(cameras))
            nan, sure = np.full(len(at), np.nan), np.full(len(at), 0.1)
            measured.write(
                Measurements.of(
                    t_ns=at,
                    sensor=np.tile(list(PLACES), n),
                    target_id=np.zeros(len(at), np.int32),
                    range=far.ravel(),
                    sigma_range=sure,
                    rssi=nan,
                    sigma_rssi=nan,
                )
            )
            bearings.write(
                Bearings.of(
                    t_ns=at,
                    sensor=np.tile(list(PLACES), n),
                    target_id=np.zeros(len(at), np.int32),
                    seen=np.ones(len(at), np.bool_),
                    bearing=azimuth.ravel(),
                    sigma=np.full(len(at), 0.004),
                    u_px=u.ravel(),
                    sigma_px=np.full(len(at), 2.0),
                    score=np.full(len(at), np.nan),
                )
            )
    views_of_boxes(folder)


def views_of_boxes(folder: Path) -> None:
    """The boxes of `make_many` as views."""
    with TableWriter(folder / "views.parquet", Views, Provenance("detect")) as views:
        for boxes in iter_table(folder / "boxes.parquet", Boxes, CHUNK // 2):
            n = len(boxes)
            same = {name: getattr(boxes, name) for name in ("t_ns", "sensor", "frame", "width_px", "height_px")}
            nan = {c.name: np.full(n, np.nan) for c in Views.columns() if c.kind == "f8" and not c.optional}
            place = {"left_px": boxes.left_px, "top_px": boxes.top_px, "x_px": boxes.left_px + 0.5 * boxes.width_px}
            place |= {"y_px": boxes.top_px, "area_px": boxes.width_px * boxes.height_px}
            place |= {"cov_xx_px": np.ones(n), "cov_xy_px": np.zeros(n), "cov_yy_px": np.ones(n)}
            identity = {"cluster": boxes.box, "target_id": np.full(n, -1, np.int32)}
            looks = np.full((n, APPEARANCE_BINS), np.nan, dtype=np.float32)
            views.write(Views.of(**nan | same | place | identity, appearance=looks))


def peak_mb(*args: str) -> float:
    """Largest resident set [MB] of an occlog command that must succeed."""
    quiet = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    pid = os.posix_spawn(sys.executable, [sys.executable, "-m", "occlog", *args], os.environ, file_actions=quiet)
    _, status, usage = os.wait4(pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"occlog {' '.join(args)} failed")
    return usage.ru_maxrss / 1024


def measure(folder: Path, rows: int) -> dict[str, float]:
    """Peak of each command."""
    # In a process of its own: the system counts what a parent has in memory as its child's
    for how in (make, make_many, make_seen):
        maker = multiprocessing.get_context("spawn").Process(target=how, args=(folder, rows))
        maker.start()
        maker.join()
    tracks, truth, errors = (str(folder / f"{name}.parquet") for name in ("tracks", "truth", "errors"))
    out = {"evaluate": peak_mb("evaluate", tracks, "--truth", truth, "--errors", errors, "--quiet")}
    shown = ("--truth", truth, "--errors", errors, "-o", str(folder / "page.html"))
    out["report"] = peak_mb("report", tracks, *shown)
    out["diff"] = peak_mb("diff", tracks, tracks)
    for name in ("csv", "tum", "mot3d", "trc", "geojson"):
        place = ("--origin", "52.5,13.4") if name == "geojson" else ()
        out[f"export {name}"] = peak_mb("export", tracks, "--to", name, *place, "-o", str(folder / f"out.{name}"))
        (folder / f"out.{name}").unlink()
    out["info"] = peak_mb("info", tracks)
    many, people, boxes, true_boxes = (
        str(folder / f"{name}.parquet") for name in ("many", "people", "boxes", "true_boxes")
    )
    tables = [f"--{name}={folder / name}.parquet" for name in ("failures", "counts")]
    out["evaluate of several"] = peak_mb("evaluate", many, "--truth", people, "--match", "optimal", *tables, "--quiet")
    out["evaluate in images"] = peak_mb("evaluate", boxes, "--truth", true_boxes, "--quiet")
    part = f"--frames={rows // PEOPLE // 8}:{rows // PEOPLE // 4}"
    out["evaluate some frames in images"] = peak_mb("evaluate", boxes, "--truth", true_boxes, part, "--quiet")
    for ours, true in ((many, people), (boxes, true_boxes)):
        also = ("--truth", true, "--also", ours, true, part)
        out[f"evaluate --also of {Path(ours).stem}"] = peak_mb("evaluate", ours, *also, "--quiet")
    seen, filter_diagnostics = f"--bearings={folder / 'seen.parquet'}", f"--diagnostics={folder / 'fared.parquet'}"
    room, true = f"--scene={folder / 'scene.yaml'}", f"--truth={folder / 'seen_truth.parquet'}"
    ours, bound = str(folder / "seen_tracks.parquet"), f"--bound={folder / 'bound.parquet'}"
    out["evaluate bearings"] = peak_mb("evaluate", seen, true, room, "--quiet")
    errors = f"--errors={folder / 'seen_errors.parquet'}"
    out["evaluate tracks and bearings"] = peak_mb(
        "evaluate", ours, seen, filter_diagnostics, true, room, errors, bound, "--quiet"
    )
    page = ("-o", str(folder / "seen.html"), "--overwrite")
    out["report bearings"] = peak_mb("report", ours, seen, filter_diagnostics, true, room, errors, bound, *page)
    out["report without truth"] = peak_mb("report", ours, seen, room, *page)
    out["evaluate without truth"] = peak_mb("evaluate", ours, seen, room, "--quiet")
    measured, new = f"--measurements={folder / 'measured.parquet'}", f"--write-scene={folder / 'new.yaml'}"
    out["evaluate measurements"] = peak_mb(
        "evaluate", ours, measured, true, room, errors, bound, "--overwrite", "--quiet"
    )
    out["evaluate write-scene"] = peak_mb("evaluate", seen, true, room, new, "--quiet")
    some = f"--frames={rows // 40}:{rows // 5}"
    out["evaluate some frames"] = peak_mb("evaluate", ours, true, room, some, "--quiet")
    views = f"--views={folder / 'views.parquet'}"
    out["evaluate views"] = peak_mb("evaluate", views, f"--truth={true_boxes}", "--quiet")
    out["evaluate some frames of views"] = peak_mb("evaluate", views, f"--truth={true_boxes}", part, "--quiet")
    out["report of several"] = peak_mb("report", many, "--truth", people, "-o", str(folder / "many.html"))
    people_tracks, events = str(folder / "everybody.parquet"), f"--events={folder / 'events.parquet'}"
    out["report of everybody"] = peak_mb("report", people_tracks, events, "--truth", people, *page)
    out["export coco"] = peak_mb("export", boxes, "-o", str(folder / "out.json"))
    return out


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Ratio of the peaks, the largest of all commands; memory needs no repeats."""
    with tempfile.TemporaryDirectory() as name:
        short, long = (measure(Path(name) / str(rows), rows) for rows in (ROWS, 10 * ROWS))
    parts = {
        f"{command}: MB at {rows:.0e} rows": of[command]
        for command in short
        for rows, of in ((ROWS, short), (10 * ROWS, long))
    }
    return {"ratio": max(long[name] / short[name] for name in short), "limit": LIMIT, "parts": parts}
