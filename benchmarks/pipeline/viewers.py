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
from pathlib import Path
from typing import Any

import numpy as np

from occlog.array_types import NS
from occlog.io.files.parquet import write_table
from occlog.io.files.provenance import Provenance
from occlog.io.frames.codec import encode_image
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.io.scenes.scene import read_scene
from occlog.records.people import PeopleTracks

NAME = "viewers"
SUMMARY = "peak memory of an export for viewers: an hour to 20 minutes, five people, two cameras, 10 Hz"
LIMIT = 1.10
ROOT = Path(__file__).resolve().parents[2]
RATE, PEOPLE = 10, 5
MINUTES = (20, 60)
"""The shorter one is of nearly as many rows as are read at a time, so that all that is held at once is held in both."""
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


def fill(folder: Path, seconds: int) -> None:
    """A run of people who walk in circles, in the room of the examples, with two small cameras of its four."""
    scene = read_scene(ROOT / "examples" / "room.yaml")
    times = np.arange(seconds * RATE) * (NS // RATE)
    image = encode_image(np.full((72, 96, 3), 90, dtype=np.uint8), "jpeg", 80)
    with RecordingWriter(folder / "recording.mcap", scene, MADE) as out:
        for index, t_ns in enumerate(times.tolist()):
            for camera in scene.cameras[:2]:
                out.image(camera.name, t_ns, index, image, "jpeg")
    t_ns, target = np.repeat(times, PEOPLE), np.tile(np.arange(PEOPLE, dtype=np.int32), len(times))
    angle, rows = t_ns / NS * 0.5 + target, np.ones(len(t_ns))
    covariance = {"cov_xx": 0.02 * rows, "cov_xy": 0.0 * rows, "cov_yy": 0.01 * rows}
    place = {"x": 4.0 + 2.0 * np.cos(angle), "y": 3.0 + 2.0 * np.sin(angle), "vx": 0.0 * rows, "vy": 0.0 * rows}
    seen = {"existence": rows, "seen_by": np.full(len(rows), scene.cameras[0].name)}
    tracks = PeopleTracks.of(t_ns=t_ns, target_id=target, **place, **covariance, **seen)
    write_table(folder / "tracks.parquet", tracks, MADE, length_unit=scene.length_unit)


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
    said = subprocess.run(words, check=True, capture_output=True, text=True).stdout.splitlines()[-1]
    code, peak, cpu = (float(word) for word in said.split())
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
        rerun = shutil.which("rerun")
        if rerun is not None:
            parts |= _of_the_room(rerun, Path(name))
    return {"ratio": peaks[1] / peaks[0], "limit": LIMIT, "parts": parts}


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
