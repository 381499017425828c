"""Makes the pictures of the pages by the command line: `python -m docs.pictures [NAME...]`, all without a name.

A picture is not compared byte by byte: fonts and compiled kernels of another machine may move a pixel.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from urllib.parse import urlencode

import numpy as np

from docs.browser import CHROMIUM, browser
from docs.pictures.served import served
from occlog.array_types import NS
from occlog.io.recording.reader import open_recording

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
MOST_BYTES = 1_000_000
"""Of the moving picture on the first page."""
SHOWN_NS = 27 * NS // 5
"""From the beginning of the room's run to the time at which Lichtblick shows it: particles are wide apart."""
LOADING_MS = 120_000
"""A software renderer takes its time."""


class StaysError(Exception):
    """A picture stays as it was: what is missing to make it."""


def occlog(work: Path, *words: str) -> None:
    """Run a command of occlog in a folder, in which the examples and the sample data lie."""
    for name in ("examples", "sample_data"):
        if not (work / name).exists():
            (work / name).symlink_to(ROOT / name)
    subprocess.run([sys.executable, "-m", "occlog", *words, "-q"], cwd=work, check=True, stdout=subprocess.DEVNULL)


def moving(work: Path, to: Path) -> None:
    """Ten seconds of everybody in all images and on the plan, for the first page: every second frame."""
    import cv2

    occlog(work, "run", "examples/people.yaml", "-o", "people")
    occlog(
        work, "report", "people", "--recording", "people/recording.mcap", "--scale", "0.9", "--video", "people.avi",
    )  # fmt: skip
    video, frames = cv2.VideoCapture(str(work / "people.avi")), []
    while (read := video.read())[0]:
        frames.append(read[1])
    shown = cv2.Animation()
    frames = frames[10::2]  # from where there are tracks on: pages that do not move show the first
    shown.frames, shown.durations = frames, [200] * len(frames)
    if not cv2.imwriteanimation(str(to), shown, [cv2.IMWRITE_WEBP_QUALITY, 40]) or to.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{to}: could not be made of at most {MOST_BYTES} bytes")


def viewer(work: Path, to: Path) -> None:
    """A run in Rerun; the picture stays as it was where Rerun or a screen for it (xvfb-run) is missing."""
    import cv2

    rerun, screen = shutil.which("rerun"), shutil.which("xvfb-run")
    if rerun is None or screen is None:
        raise StaysError("no rerun or no xvfb-run")
    occlog(work, "run", "examples/people.yaml", "-o", "people")
    occlog(work, "export", "people", "--to", "rerun", "-o", "occlog.mcap")
    shot = ["--screenshot-to", str(work / "shot.png"), "--window-size", "1300x850"]
    # A screen so large that its pointer, in its middle, is beside the window
    large = [screen, "-a", "-s", "-screen 0 3800x2600x24"]
    subprocess.run([*large, rerun, str(work / "occlog.mcap"), *shot], cwd=work, check=True, capture_output=True)
    picture = cv2.resize(cv2.imread(str(work / "shot.png")), (1300, 850), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(to), picture[36:600, 200:1000])  # without Rerun's own lists at the sides


def report(work: Path, to: Path) -> None:
    """The figures of a report."""
    occlog(work, "run", "sample_data/room/run.yaml", "-o", "room")
    (work / "room/report.png").replace(to)


def replay(work: Path, to: Path) -> None:
    """The replay of a run in Chromium; the picture stays as it was where that is missing."""
    if CHROMIUM is None:
        raise StaysError("no Chromium")
    occlog(work, "run", "examples/people.yaml", "-o", "people")
    images = [
        "--images",
        "people/recording.mcap",
        "--truth",
        "people/recording.mcap",
        "--scene",
        "people/recording.mcap",
    ]
    occlog(work, "report", "people", "-o", "page.html", *images)
    with browser() as chromium:
        page = chromium.new_page(viewport={"width": 960, "height": 900}, color_scheme="light")
        page.goto((work / "page.html").as_uri() + "#t=6")
        page.wait_for_timeout(500)
        page.locator("#replay").screenshot(path=to)


def beside(work: Path, to: Path) -> None:
    """Everybody with three cameras and with two, in Chromium; the picture stays as it was where that is missing."""
    if CHROMIUM is None:
        raise StaysError("no Chromium")
    occlog(work, "run", "examples/people.yaml", "-o", "three")
    shutil.copytree(work / "three", work / "two")
    occlog(
        work, "track", "three/views.parquet", "--scene", "three/recording.mcap", "--method", "jipda",
        "--without", "view3", "-o", "two/tracks.parquet", "--events", "two/events.parquet", "--overwrite",
    )  # fmt: skip
    for table in ("errors.parquet", "metrics.json"):
        (work / "two" / table).unlink()
    occlog(work, "report", "three", "two", "-o", "page.html")
    with browser() as chromium:
        page = chromium.new_page(viewport={"width": 1280, "height": 900}, color_scheme="light")
        page.goto((work / "page.html").as_uri() + "#t=8.3")
        page.wait_for_timeout(500)
        page.locator("#replay").screenshot(path=to)


def overlay(work: Path, to: Path) -> None:
    """Targets that look alike, with epipolar lines."""
    occlog(work, "simulate", "--scene", "balls", "--seed", "1", "--store", "ffv1", "-o", "balls.mcap")
    occlog(
        work, "track", "balls.mcap", "--method", "bmct", "--initial-ellipses", "balls.mcap", "-o", "view_tracks.parquet"
    )
    occlog(
        work, "report", "view_tracks.parquet", "--recording", "balls.mcap", "--truth", "balls.mcap", "--frame", "86",
        "--png", str(to), "--scale", "1.5", "--overwrite",
    )  # fmt: skip


def video(work: Path, to: Path) -> None:
    """A frame of the real video of people, with the person who is tracked."""
    occlog(work, "start", "sample_data/people", "-o", "walk")
    occlog(
        work, "report", "walk/view_tracks.parquet", "--recording", "walk/recording.mcap", "--frame", "110",
        "--png", str(to), "--scale", "0.75", "--overwrite",
    )  # fmt: skip


def navigation(work: Path, to: Path) -> None:
    """A robot among people."""
    occlog(
        work, "simulate", "examples/room.yaml", "-o", "walk.mcap", "--seconds", "20", "--occluders", "3", "--seed", "4",
        "--motion", "field",
    )  # fmt: skip
    occlog(
        work, "navigate", "examples/room.yaml", "--from", "1,1", "--to", "7,5", "--obstacles", "walk.mcap",
        "-o", "among.parquet", "--picture", str(to), "--strict", "--overwrite",
    )  # fmt: skip


def plan(work: Path, to: Path) -> None:
    """What is expected of four cameras, and where two more would help most."""
    occlog(
        work, "plan", "examples/room.yaml", "--people", "6", "--max-expected-error", "0.1", "--samples-per-cell", "48",
        "--along-walls", "southwest", "--add", "2", "--picture", str(to), "--overwrite",
    )  # fmt: skip


def lichtblick(work: Path, to: Path) -> None:
    """The room's run with particles in Lichtblick, with the layout of `--layout`.

    OCCLOG_LICHTBLICK names the folder of its web application, which no package has: `web/.webpack` of its sources after
    `yarn web:build:prod`. The picture stays as it was without one, or without Chromium.
    """
    application = os.environ.get("OCCLOG_LICHTBLICK")
    if CHROMIUM is None or application is None or not (Path(application) / "index.html").is_file():
        raise StaysError("no Chromium, or OCCLOG_LICHTBLICK names no folder with an index.html")
    room = (ROOT / "sample_data/room/run.yaml").read_text()
    room = room.replace("track: {}", "track: {cloud: true}").replace(
        "recording.mcap", "sample_data/room/recording.mcap"
    )
    (work / "room.yaml").write_text(room)
    occlog(work, "run", "room.yaml", "-o", "room")
    shown = work / "shown"
    shown.mkdir()
    words = ("--recording", "sample_data/room/recording.mcap", "--to", "foxglove", "--layout", "shown/layout.json")
    occlog(work, "export", "room", "-o", "shown/room.mcap", *words)
    begin_ns, _ = open_recording(shown / "room.mcap").time_ns or (0, 0)
    at = np.datetime64(begin_ns + SHOWN_NS, "ns")
    with served(root=Path(application), shown=shown) as address, browser("--enable-unsafe-swiftshader") as chromium:
        source = {"ds": "remote-file", "ds.url": f"{address}/shown/room.mcap", "time": f"{at}Z"}
        source["layoutUrl"] = f"{address}/shown/layout.json"
        page = chromium.new_page(viewport={"width": 1400, "height": 860}, color_scheme="light")
        page.goto(f"{address}/?{urlencode(source)}")
        page.get_by_test_id("left-sidebar-button").click(timeout=LOADING_MS)
        page.mouse.move(700, 850)
        page.get_by_text("/diagnostics/0.ess").wait_for(timeout=LOADING_MS)
        page.wait_for_timeout(10_000)  # nothing tells that all panels are drawn
        page.get_by_test_id("workspace-panels").screenshot(path=to)


PICTURES: dict[str, Callable[[Path, Path], None]] = {
    "people.webp": moving,
    "rerun.png": viewer,
    "lichtblick.png": lichtblick,
    "report.png": report,
    "replay.png": replay,
    "beside.png": beside,
    "overlay.png": overlay,
    "video.png": video,
    "navigation.png": navigation,
    "plan.png": plan,
}
"""Name of each picture of this folder, and what makes it from a folder to work in and the place of the picture."""


def main(names: Sequence[str]) -> None:
    """Make these pictures, or all."""
    for name in names or PICTURES:
        try:
            with tempfile.TemporaryDirectory() as work:
                PICTURES[name](Path(work), FOLDER / name)
        except StaysError as why:
            sys.stderr.write(f"docs/pictures/{name} stays as it was: {why}\n")
        else:
            sys.stdout.write(f"made docs/pictures/{name}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
