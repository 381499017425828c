"""A small run with everything that viewers are shown: two frames of a camera, two targets, an array, a pillar."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.writer import RecordingWriter
from occlog.records.declared.people import Events, PeopleTracks, PeopleViews
from occlog.records.scene import Camera, MicrophoneArray, Occluder, Scene, camera_rotation
from occlog.records.tables import Bearings, Diagnostics, Doa, Truth

MADE = Provenance("test")
NS = 10**9
CAMERA = Camera(
    "east", np.array([6.0, 1.0, 2.5]), camera_rotation(np.pi, -0.2, 0.0), np.array([60.0, 62.0]),
    np.array([31.5, 23.5]),
    image_size=(64, 48), fov=1.2,
)  # fmt: skip


def scene(unit: str = "m") -> Scene:
    room = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [0.0, 5.0]])
    pillar = Occluder("pillar", np.array([[1.0, 3.0], [1.5, 3.0], [1.5, 3.5], [1.0, 3.5]]), 2.0)
    array = MicrophoneArray("world", np.array([3.0, 0.1, 1.0]))
    return Scene((CAMERA,), (array,), (pillar,), room=room, length_unit=unit)


def tracks() -> PeopleTracks:
    """Targets 3 and 7 at two times; no one sees 7 at the second, and its identity is in doubt."""
    zero = {name: [0.0] * 4 for name in ("vx", "vy")}
    return PeopleTracks.of(
        t_ns=[NS, NS, 2 * NS, 2 * NS], target_id=[3, 7, 3, 7], x=[2.0, 1.0, 2.5, 1.0], y=[1.0, 2.0, 1.0, 2.5],
        cov_xx=[0.04] * 4, cov_xy=[0.0] * 4, cov_yy=[0.01] * 4, **zero,
        existence_probability=[1.0] * 4, height=[1.8, np.nan, 1.8, np.nan], width=[0.4] * 4,
        seen_by=["east", "east", "east", ""], quality_flags=["", "", "", "coasting"],
    )  # fmt: skip


def view_tracks() -> PeopleViews:
    nothing = {"similarity": [np.nan] * 2, "ess": [np.nan] * 2, "counterpart": [""] * 2, "neighbours": [""] * 2}
    return PeopleViews.of(
        t_ns=[NS] * 2, sensor=["east"] * 2, frame=[0] * 2, target_id=[3, 7], x_px=[20.0, 40.0], y_px=[25.0, 20.0],
        a_px=[4.0, 3.0], b_px=[10.0, 8.0], rho=[0.0] * 2, cov_xx_px=[1.0] * 2, cov_xy_px=[0.0] * 2, cov_yy_px=[1.0] * 2,
        likelihood_mode=["box", "ground"], assisting_views=[""] * 2, lifecycle=[""] * 2, **nothing,
    )  # fmt: skip


def diagnostics() -> Diagnostics:
    return Diagnostics.of(
        t_ns=[NS, 2 * NS], target_id=[3, 3], ess=[80.5, np.nan], log_likelihood=[-1.0, -2.0], n_observing=[1, 1],
        n_detected=[1, 0], fallback=["", "restart"], cameras=["east", "east"], n_available=[1, 1],
        selected=["east", ""],
        predicted_mse=[np.nan, np.nan], seen_by=["east", ""], quality_flags=["", ""],
    )  # fmt: skip


def bearings() -> Bearings:
    nothing = {name: [np.nan] * 3 for name in ("u_px", "sigma_px", "score")}
    return Bearings.of(
        t_ns=[NS, NS, 2 * NS], sensor=["east"] * 3, target_id=[3, 7, 7], seen=[True, True, False],
        bearing=[np.pi - 1e-9, 2.9, np.nan], sigma=[0.01, 0.01, np.nan], **nothing,
    )  # fmt: skip


def fill(folder: Path, unit: str = "m", broken: bool = False) -> Path:
    """A run folder with a recording of two frames and all tables."""
    made, image = scene(unit), np.full((48, 64, 3), 90, dtype=np.uint8)
    png = cv2.imencode(".png", image)[1].tobytes()
    with RecordingWriter(folder / "recording.mcap", made, MADE) as out:
        out.image("east", NS, 0, png, "png")
        out.image("east", 2 * NS, 1, png[:-30] if broken else png, "png")
        role = ["target", "occluder"]
        out.table(Truth.of(t_ns=[NS] * 2, target_id=[3, 9], role=role, x=[2.1, 5.0], y=[1.0, 4.0], z=[np.nan] * 2))
        none = {n: [np.nan] for n in ("elevation", "sigma_azimuth", "sigma_elevation", "confidence")}
        out.table(Doa.of(t_ns=[NS], sensor=["world"], source_id=[-1], azimuth=[0.5 * np.pi], **none))
    events = Events.of(t_ns=[NS], target_id=[7], kind=["possible_switch"], other_id=[3], probability=[0.25])
    for table in (tracks(), view_tracks(), diagnostics(), bearings(), events):
        write_table(folder / f"{table.NAME}.parquet", table, MADE, length_unit=unit)
    return folder
