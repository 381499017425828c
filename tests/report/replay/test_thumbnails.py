"""Small images next to the plan: as many as fit, of the right times, with what is tracked drawn over them."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_up import ring_scene, run

from occlog.cli.main import run as occlog
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.frames.codec import encode_image
from occlog.io.recording.writer import RecordingWriter
from occlog.records.scene import Scene
from occlog.report.overlay.plan import OverlayTables
from occlog.report.replay.thumbnails import WIDTH, thumbnails
from occlog.settings import METRES

STEP = 100_000_000
FRAMES = 20


def scene() -> Scene:
    made = ring_scene(2)
    cameras = tuple(replace(camera, name=f"cam{k + 1}") for k, camera in enumerate(made.cameras))
    return replace(made, cameras=cameras, occluders=())


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two cameras; the second one has every other frame, and each image is as bright as its number says."""
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, scene(), Provenance("test")) as out:
        for number in range(FRAMES):
            image = encode_image(np.full((480, 640), 10 * number, np.uint8), "png", 0)
            out.image("cam1", number * STEP, number, image, "png")
            if number % 2 == 0:
                out.image("cam2", number * STEP, number // 2, image, "png")
    return path


def brightness(data: bytes) -> float:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image.shape[1] == WIDTH
    return float(np.median(image[60:]))


def test_all_moments_are_there_where_they_fit(recording: Path) -> None:
    found = thumbnails(recording, None, [], 10**7)
    assert (found.n_steps, found.of, found.words) == (FRAMES, FRAMES, "")
    assert [t for t, _ in found.cameras["cam1"]] == [n * STEP for n in range(FRAMES)]
    assert [t for t, _ in found.cameras["cam2"]] == [n * STEP for n in range(0, FRAMES, 2)]
    for t, data in found.cameras["cam2"]:
        assert brightness(data) == pytest.approx(10 * t / STEP, abs=2)


def test_a_limit_is_kept_and_moments_are_evenly_spaced(recording: Path) -> None:
    whole = sum(len(each["data"][0]) for each in thumbnails(recording, None, [], 10**7).packed(0))
    limit = 5 * whole
    found = thumbnails(recording, None, [], limit)
    assert sum(len(text) for each in found.packed(0) for text in each["data"]) <= limit
    assert 3 <= found.n_steps <= 5
    assert found.words == f"Images: {found.n_steps} of {FRAMES} time steps."
    assert np.ptp(np.diff([t for t, _ in found.cameras["cam1"]])) <= STEP
    times = np.frombuffer(base64.b64decode(found.packed(STEP)[0]["times"][1]))
    np.testing.assert_allclose(times, [t / 1e9 - 0.1 for t, _ in found.cameras["cam1"]])


def test_tracks_are_drawn_over_the_cameras_that_see_them(recording: Path, tmp_path: Path) -> None:
    tracks = run(steps=FRAMES, cameras=2).tracks
    assert tracks is not None
    path = tmp_path / "tracks.parquet"
    write_table(path, tracks, Provenance("track"))
    plain, drawn = (thumbnails(recording, sources, [0], 10**7) for sources in (None, OverlayTables(path)))
    assert any(a[1] != b[1] for a, b in zip(plain.cameras["cam1"], drawn.cameras["cam1"], strict=True))
    page = tmp_path / "page.html"
    args = ["report", str(path), "--scene", str(recording), "--images", str(recording), "-o", str(page)]
    assert occlog(args) == ExitCode.DONE
    text = page.read_text(encoding="utf-8")
    assert 'id="replay-image-1" alt="Image of cam2' in text


def test_tracks_in_another_unit_are_drawn_at_the_same_places_or_refused(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The unit of the tracks was taken for that of the recording: places in mm were drawn as if they were in m."""
    tracks = run(steps=FRAMES, cameras=2).tracks
    assert tracks is not None
    metre = METRES[scene().length_unit]
    shown = {}
    for unit in METRES:
        path = tmp_path / f"{unit}.csv"
        rows = zip(
            tracks.t_ns.tolist(), tracks.x * (metre / METRES[unit]), tracks.y * (metre / METRES[unit]), strict=True
        )
        path.write_text(f"t_ns,id,x_{unit},y_{unit}\n" + "".join(f"{t},0,{x:.9f},{y:.9f}\n" for t, x, y in rows))
        shown[unit] = thumbnails(recording, OverlayTables(path), [0], 10**7).cameras["cam1"]
    page = str(tmp_path / "page.html")
    assert occlog(["report", str(path), "--images", str(recording), "-o", page]) == ExitCode.DONE
    assert all(images == shown["m"] for images in shown.values())
    assert shown["m"] != thumbnails(recording, None, [0], 10**7).cameras["cam1"]
    write_table(tmp_path / "ft.parquet", tracks, Provenance("track"), length_unit="ft")
    args = ["report", str(tmp_path / "ft.parquet"), "--images", str(recording), "-o", str(tmp_path / "no.html")]
    assert occlog(args) == ExitCode.BAD_INPUT
    assert "ft.parquet: lengths are in ft, but in m in the scene" in capsys.readouterr().err


def test_images_that_are_damaged_are_dark_and_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One ended the command."""
    path = tmp_path / "cut.mcap"
    image = encode_image(np.full((480, 640), 200, np.uint8), "png", 0)
    with RecordingWriter(path, scene(), Provenance("test")) as out:
        for number in range(6):
            out.image("cam1", number * STEP, number, image[: len(image) // 2] if number in (0, 3, 4) else image, "png")
    found = thumbnails(path, None, [], 10**7)
    assert [(loss.source, loss.place, loss.count) for loss in found.losses] == [
        ("cam1", "frame 0", 1),
        ("cam1", "frames 3 to 4", 2),
    ]
    assert [round(brightness(data), -2) for _, data in found.cameras["cam1"]] == [200, 200, 0, 0, 200]
    page = tmp_path / "page.html"
    args = ["report", "--scene", str(path), "--images", str(path), "-o", str(page), "--json"]
    assert occlog(args) == ExitCode.LOSSY
    assert [loss["count"] for loss in json.loads(capsys.readouterr().out)["losses"]] == [1, 2]
    assert "frames 3 to 4" in page.read_text(encoding="utf-8")


def test_recordings_without_images_are_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "r.mcap", scene(), Provenance("test")):
        pass
    with pytest.raises(InputError, match="holds no images; omit --images"):
        thumbnails(tmp_path / "r.mcap", None, [], 10**6)
