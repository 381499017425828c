"""Pauses so long that what was before says nothing of what comes after: the trajectory begins again."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.io.formats.scenes.scene import read_scene
from occlog.records.tables import Tracks
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.gauss_markov import transitions
from occlog.track.methods.map.search.problem_of_record import FORGET_EXTENTS, memory_ns, motion_of

SCENE = """occlog_scene: 1
room: [[0, 0], [20, 0], [20, 20], [0, 20]]
cameras:
- {name: a, position: [0, 10, 1.2], yaw_deg: 0, focal_px: 142, image_size_px: [256, 128]}
- {name: b, position: [10, 0, 1.2], yaw_deg: 90, focal_px: 142, image_size_px: [256, 128]}
"""
SIGMA = 0.01
PLACE = (10.0, 10.0)
"""Where the target stands before the pause, and after it: 10 m from both cameras, whose sight lines cross."""


def scene_file(folder: Path) -> Path:
    path = folder / "scene.yaml"
    path.write_text(SCENE)
    return path


def tracks(folder: Path, pause_s: float, frames: int, *options: str) -> Tracks:
    rows = ["t_s,sensor,target_id,azimuth_rad,sigma_rad"]
    for t in (begin + 0.5 * k for begin in (0.0, pause_s) for k in range(frames)):
        rows += [f"{t},a,1,0,{SIGMA}", f"{t},b,1,{math.pi / 2},{SIGMA}"]
    (folder / "b.csv").write_text("\n".join(rows) + "\n")
    out = folder / "t.parquet"
    words = ["track", str(folder / "b.csv"), "--scene", str(scene_file(folder)), "--method", "map", "-o", str(out)]
    assert run([*words, "--overwrite", *options]) == ExitCode.DONE
    return read_table(out, Tracks)


@pytest.mark.parametrize(
    ("hours", "frames", "options"),
    [
        (0.1, 1, ()),
        (8, 3, ()),
        (10_000, 1, ()),
        (24, 1, ("--set", "process_noise_velocity=5")),
        (10_000, 3, ("--set", "process_noise_velocity=5")),
        (1, 1, ("--lag", "2")),
        (10_000, 3, ("--lag", "2")),
    ],
)
def test_a_target_is_where_its_cameras_see_it_after_any_pause(
    tmp_path: Path, hours: float, frames: int, options: tuple[str, ...]
) -> None:
    found = tracks(tmp_path, hours * 3600, frames, *options)
    assert len(found) == 2 * frames
    assert np.allclose(np.column_stack([found.x, found.y]), PLACE, atol=1e-3)
    assert np.all(np.sqrt(np.maximum(found.cov_xx, found.cov_yy)) < 1.01 * 10 * SIGMA)


@pytest.mark.parametrize("acceleration", [1e-3, 0.5, 10.0])
def test_the_pause_is_the_one_after_which_a_target_may_be_anywhere(tmp_path: Path, acceleration: float) -> None:
    scene, config = read_scene(scene_file(tmp_path)), MapConfig(process_noise_velocity=acceleration)
    pause_ns = memory_ns(scene, config)
    assert pause_ns is not None
    _, sigma = transitions(motion_of(config), np.array([0.5, 1.0]) * pause_ns / NS)
    half, whole = np.sqrt(sigma[:, 0, 0]) / math.hypot(20, 20)
    assert half <= FORGET_EXTENTS < whole


def test_a_motion_that_stays_in_its_place_is_never_forgotten(tmp_path: Path) -> None:
    A = np.kron(np.eye(2), [[0.9, 0.0], [0.0, 0.9]])
    config = MapConfig(A=tuple(A.ravel()), Sigma=tuple(np.eye(4).ravel()))
    assert memory_ns(read_scene(scene_file(tmp_path)), config) is None
