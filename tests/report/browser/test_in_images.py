"""The page of tracks in images: no floor plan, images in step with the time line, tracks with their lengths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser_pages import EVIL, Open, clock, settled

from docs.browser import CHROMIUM
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.frames.codec import encode_image
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.epipolar.views import TrackedView
from occlog.records.declared.people import BOX, PREDICTED, Events
from occlog.records.declared.views import ViewTracks
from occlog.report.content.model import ReportInput
from occlog.report.gather import pixel_positions
from occlog.report.overlay.stage import OverlayFrameRows, OverlayRig, frame_shot
from occlog.report.page import build_page, life_rows, switch_rows
from occlog.report.replay.steps import ReplaySteps
from occlog.report.replay.thumbnails import Thumbnails

STEP = 100_000_000
FRAMES = 40


def rows(*of: tuple[int, str, int, str]) -> ViewTracks:
    """Time step, camera, target and mode of each row; the centre is at (100 + 10 target, 50 + step)."""
    count = len(of)
    step, sensor, target, mode = (np.array(column) for column in zip(*of, strict=True))
    one, none, text = np.ones(count), np.full(count, np.nan), [""] * count
    return ViewTracks.of(
        t_ns=step * STEP, sensor=sensor, frame=step, target_id=target, x_px=100.0 + 10 * target, y_px=50.0 + step,
        a_px=20 * one, b_px=8 * one, rho=0 * one - np.pi / 2, cov_xx_px=4 * one, cov_xy_px=0 * one, cov_yy_px=9 * one,
        similarity=none, ess=none, likelihood_mode=mode, counterpart=text, neighbours=text, assisting_views=text,
        lifecycle=text,
    )  # fmt: skip


def walk(camera: str) -> ViewTracks:
    """Target 0 from step 0 to 15, predicted in the last four; the hall is empty; target 7 from step 30 on."""
    first = [(k, camera, 0, PREDICTED if k >= 12 else BOX) for k in range(16)]
    return rows(*first, *[(k, camera, 7, BOX) for k in range(30, FRAMES)])


EVENTS = Events.of_rows(
    [
        (0, "initiated", 0, -1, np.nan),
        (30 * STEP, "initiated", 7, -1, np.nan),
        (34 * STEP, "possible_switch", 0, 7, 0.25),
        (34 * STEP, "possible_switch", 7, 0, 0.25),
    ]
)


def test_rows_of_several_cameras_are_one_with_those_that_see_the_target() -> None:
    found = pixel_positions(rows((0, "a", 1, PREDICTED), (0, "b", 1, BOX), (1, "a", 1, PREDICTED), (1, "a", 2, "mipf")))
    assert found.t_ns.tolist() == [0, STEP, STEP]
    assert found.target_id.tolist() == [1, 1, 2]
    assert found.seen_by.tolist() == ["b", "", "a"]
    assert found.quality_flags.tolist() == ["", "coasting", ""]
    assert found.x.tolist() == [110.0, 110.0, 120.0]
    assert len(pixel_positions(ViewTracks.empty())) == 0


def test_each_track_has_its_span_and_its_share_of_predicted_rows() -> None:
    data = ReportInput(tracks=pixel_positions(walk("hall")), events=EVENTS, length_unit="px", in_images=True)
    first, second = life_rows(data)
    assert (first.target, first.begin, first.end, first.length, first.rows) == (0, 0.0, 1.5, "1.50", "16")
    assert (first.predicted, first.cameras, first.switches) == ("25", "hall", "1")
    assert (second.target, second.begin, second.end, second.predicted) == (7, 3.0, 3.9, "0")
    assert life_rows(replace(data, boxes_stated=False))[0].predicted == "–"
    assert [(row.seconds, row.target, row.other, row.probability) for row in switch_rows(data)] == [
        (3.4, 0, "7", "0.25")
    ]


def test_predicted_rows_are_dashed_and_nothing_is_shown_across_a_gap() -> None:
    table = walk("hall")
    of = [OverlayFrameRows(table.take(table.frame == k), None, None) for k in (11, 12)]
    rig = OverlayRig([TrackedView("hall", 200, 120)], [None], None)
    assert [frame_shot(0, 0, [one], rig).outlines[0].dashed for one in of] == [False, True]
    data = ReportInput(tracks=pixel_positions(table), length_unit="px", in_images=True)
    kept = ReplaySteps(data, np.array([[0.0, 0.0], [1.0, 1.0]])).kept
    assert (kept // STEP).tolist() == [*range(17), *range(29, FRAMES)]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page that the command makes of a grey video, each image as bright as its number."""
    folder = tmp_path_factory.mktemp("walk")
    with RecordingWriter(folder / "recording.mcap", None, Provenance("ingest")) as out:
        for k in range(FRAMES):
            out.image("hall", k * STEP, k, encode_image(np.full((120, 200), 5 * k, np.uint8), "png", 0), "png")
    write_table(folder / "view_tracks.parquet", walk("hall"), Provenance("track"))
    write_table(folder / "events.parquet", EVENTS, Provenance("track"))
    page, tracks, recording = (str(folder / name) for name in ("p.html", "view_tracks.parquet", "recording.mcap"))
    assert run(["report", tracks, "--recording", recording, "-o", page, "-q"]) == ExitCode.DONE
    assert run(["report", str(folder), "-o", str(folder / "of_folder.html"), "-q"]) == ExitCode.DONE
    return folder / "of_folder.html"


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium; install it, or name it in OCCLOG_CHROMIUM")
@pytest.mark.drawn
def test_images_follow_the_time_line_and_names_are_text(opened: Open, shown: Path, tmp_path: Path) -> None:
    page = opened()
    assert page.locator("#replay-plan").count() == 0
    image = page.locator("#replay-image-0")
    first = image.get_attribute("src")
    page.locator("#replay-time").fill("20")
    settled(page)
    assert clock(page) == 2.0  # between the tracks, where the images go on
    assert image.get_attribute("src") != first
    assert page.locator("#replay-rows tr").count() == 0
    page.locator("table a[data-time='3.4']").click()
    settled(page)
    assert clock(page) == 3.4
    assert page.locator("#replay-rows th, #replay-rows td").all_inner_texts() == [
        "7",
        "170.00, 84.00",
        "3.61",
        "hall",
        "–",
    ]
    for width in (390, 1600):
        page.set_viewport_size({"width": width, "height": 900})
        settled(page)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    assert "image" in opened(shown.parent / "p.html").locator("#replay").inner_html()
    jpeg = encode_image(np.zeros((9, 16, 3), np.uint8), "jpeg", 70)
    data = ReportInput(title=EVIL, tracks=pixel_positions(walk(EVIL)), length_unit="px", in_images=True)
    evil = tmp_path / "evil.html"
    evil.write_text(build_page(data, Thumbnails({EVIL: [(0, jpeg)]}, 1, 1)), encoding="utf-8")
    page = opened(evil)
    assert page.evaluate("() => window.evil") is None
    assert page.locator("#replay-image-0").get_attribute("alt") == f"Image of {EVIL} at the selected time"
    assert EVIL in page.locator("#replay-rows").inner_text()
    assert page.locator("img").count() == 1
