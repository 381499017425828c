"""Files for viewers: memory and work of an hour, and how much of the room's run Rerun shows.

Rerun's program is taken from PATH; it is no dependency, and without it its part is left out.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from occlog.array_types import NS, Ints
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import read_scene
from occlog.io.frames.codec import encode_image
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.declared.people import PeopleTracks
from occlog.records.scene import Scene
from occlog.records.tables import Boxes

NAME = "viewers"
SUMMARY = "peak memory of an export for viewers: an hour to 20 minutes, five people, two cameras, 10 Hz; and eight"
LIMIT = 1.10
ROOT = Path(__file__).resolve().parents[2]
PEOPLE = 5
MINUTES = (20, 60)
RATE, EIGHT_HZ = 10, (2, 1)
"""Times and frames a second; tracks and frames of the hour of eight cameras."""
MADE = Provenance("benchmark")
CHUNK = re.compile(r"^Chunk\(\S+\) with \d+ rows \(.*?\) - (\S+) - data columns: \[(.*)\]$")
DRAWN = {
    "EncodedImage:blob", "VideoStream:sample", "Pinhole:image_from_camera", "Points3D:positions", "Scalars:scalars",
    "TextLog:text", "Transform3D:translation",
}  # fmt: skip
"""The components that Rerun's views draw, or that place others in space, of those that come of such files."""


def shown_by_rerun(rerun: str, path: Path) -> set[str]:
    """Entities of which Rerun draws something, each named as the topic `/NAME`.

    Args:
        rerun: its program.
        path: an MCAP file.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.rrd"
        subprocess.run([rerun, "mcap", "convert", str(path), "-o", str(out)], check=True, capture_output=True)
        text = subprocess.run([rerun, "rrd", "print", str(out)], check=True, capture_output=True, text=True).stdout
    columns: dict[str, set[str]] = {}
    for line in text.splitlines():
        found = CHUNK.match(line.strip())
        if found is not None:
            columns.setdefault(found[1], set()).update(found[2].split())
    return {entity for entity, names in columns.items() if names & DRAWN}


def shares(rerun: str, path: Path) -> tuple[float, Collection[str]]:
    """Share of the topics of a file that Rerun draws, and the others.

    Topics whose names differ in a slash before them are one: Rerun makes one entity of them.
    """
    topics = {f"/{topic.name.removeprefix('/')}" for topic in open_recording(path).topics}
    drawn = shown_by_rerun(rerun, path)
    return len(topics & drawn) / len(topics), topics - drawn


def eight(scene: Scene) -> Scene:
    """The scene with four more cameras, each in the middle between two and turned as the first of them."""
    between = zip(scene.cameras, (*scene.cameras[1:], scene.cameras[0]), strict=True)
    more = [replace(a, name=f"{a.name}2", position=0.5 * (a.position + b.position)) for a, b in between]
    return replace(scene, cameras=(*scene.cameras, *more))


def fill(folder: Path, seconds: int, rate: int = RATE, shots: int = RATE, cameras: int = 2) -> None:
    """A run of people who walk in circles in the room of the examples.

    Args:
        folder: in which the recording and the tables are written.
        seconds: its length.
        rate: of tracks [Hz].
        shots: of frames [Hz], by which `rate` can be divided; where they are of all eight cameras, with boxes.
        cameras: two small ones of its four, or eight.
    """
    scene = read_scene(ROOT / "examples" / "room.yaml")
    scene = eight(scene) if cameras > len(scene.cameras) else scene
    times = np.arange(seconds * rate) * (NS // rate)
    image = encode_image(np.full((72, 96, 3), 90, dtype=np.uint8), "jpeg", 80)
    with RecordingWriter(folder / "recording.mcap", scene, MADE) as out:
        for index, t_ns in enumerate(times[:: rate // shots].tolist()):
            for camera in scene.cameras[:cameras]:
                out.image(camera.name, t_ns, index, image, "jpeg")
    if cameras > 2:
        write_table(folder / "boxes.parquet", _boxes(times[:: rate // shots], scene), MADE)
    t_ns, target = np.repeat(times, PEOPLE), np.tile(np.arange(PEOPLE, dtype=np.int32), len(times))
    angle, rows = t_ns / NS * 0.5 + target, np.ones(len(t_ns))
    covariance = {"cov_xx": 0.02 * rows, "cov_xy": 0.0 * rows, "cov_yy": 0.01 * rows}
    place = {"x": 4.0 + 2.0 * np.cos(angle), "y": 3.0 + 2.0 * np.sin(angle), "vx": 0.0 * rows, "vy": 0.0 * rows}
    seen = {"existence": rows, "seen_by": np.full(len(rows), scene.cameras[0].name)}
    tracks = PeopleTracks.of(t_ns=t_ns, target_id=target, **place, **covariance, **seen)
    write_table(folder / "tracks.parquet", tracks, MADE, length_unit=scene.length_unit)


def _boxes(times: Ints, scene: Scene) -> Boxes:
    """As many boxes as people in each frame of each camera, side by side."""
    names = [camera.name for camera in scene.cameras]
    frame, sensor, box = (a.reshape(-1) for a in np.indices((len(times), len(names), PEOPLE)))
    rows = np.ones(len(frame))
    place = {"left_px": 16.0 * box, "top_px": 20.0 * rows, "width_px": 12.0 * rows, "height_px": 30.0 * rows}
    ids = {"frame": frame, "box": box.astype(np.int32), "target_id": np.full(len(frame), -1, dtype=np.int32)}
    return Boxes.of(t_ns=times[frame], sensor=np.array(names)[sensor], **ids, **place, confidence=0.9 * rows)


EXPORT = """
import resource, sys
from pathlib import Path
from occlog.cli.main import run
code = run(["export", sys.argv[1], "-o", sys.argv[2], "-q", "--overwrite"])
used = resource.getrusage(resource.RUSAGE_SELF)
(peak,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")]
print(code, int(peak.split()[1]) / 1024, used.ru_utime + used.ru_stime)
"""


def export(folder: Path) -> tuple[float, float, float]:
    """Peak [MB], CPU [s] and size [MB] of an export in a process of its own.

    It says its peak itself: what `wait4` tells of a process is never less than what its parent held.
    """
    words = [sys.executable, "-c", EXPORT, str(folder), str(folder / "out.mcap")]
    stdout = subprocess.run(words, check=True, capture_output=True, text=True).stdout.splitlines()[-1]
    code, peak, cpu = (float(word) for word in stdout.split())
    if code:
        raise RuntimeError("occlog export failed")
    return peak, cpu, (folder / "out.mcap").stat().st_size / 1e6


def run(repeats: int) -> dict[str, Any]:  # noqa: ARG001
    """Ratio of the peaks; memory needs no repeats."""
    peaks, parts = [], {}
    with tempfile.TemporaryDirectory() as name:
        for minutes in MINUTES:
            folder = Path(name) / str(minutes)
            folder.mkdir()
            fill(folder, 60 * minutes)
            peak, cpu, size = export(folder)
            peaks.append(peak)
            parts |= {
                f"MB at {minutes} min": peak,
                f"CPU s at {minutes} min": cpu,
                f"MB of file at {minutes} min": size,
            }
        parts |= _of_eight_cameras(Path(name))
        rerun = shutil.which("rerun")
        if rerun is not None:
            parts |= _of_the_room(rerun, Path(name))
    return {"ratio": peaks[1] / peaks[0], "limit": LIMIT, "parts": parts}


def _of_eight_cameras(base: Path) -> dict[str, float]:
    """Peak, work and size of an hour of eight small cameras with boxes, and tracks of people."""
    folder = base / "eight"
    folder.mkdir()
    fill(folder, 3600, *EIGHT_HZ, cameras=8)
    peak, cpu, size = export(folder)
    return {"MB of eight cameras": peak, "CPU s of eight cameras": cpu, "MB of file of eight cameras": size}


def _of_the_room(rerun: str, folder: Path) -> dict[str, float]:
    """Shares of the topics of the room's run that Rerun shows, in each format and of the recording itself."""
    occlog = [sys.executable, "-m", "occlog"]
    room = ROOT / "sample_data" / "room"
    subprocess.run(
        [*occlog, "run", str(room / "run.yaml"), "-o", str(folder / "room"), "-q"], check=True, capture_output=True
    )
    parts = {}
    recording = room / "recording.mcap"
    for name in ("recording", "viewers", "rerun", "foxglove"):
        path = recording if name == "recording" else folder / f"{name}.mcap"
        if name != "recording":
            words = ["export", str(folder / "room"), "--recording", str(recording), "--to", name, "-o", str(path), "-q"]
            subprocess.run([*occlog, *words], check=True, capture_output=True)
        parts[f"{name}: share of topics that Rerun draws"] = shares(rerun, path)[0]
    return parts
