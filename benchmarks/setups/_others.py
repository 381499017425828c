"""Set-ups without boxes on the ground: directions of arrays, ranges of stations, sound, and tracks in images."""

from __future__ import annotations

import subprocess
import sys
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import occlog
from benchmarks.setups._judge import Answer, Said, answers
from benchmarks.setups._rigs import rig
from occlog.array_types import NS, Floats

Random = np.random.Generator
SPEED_OF_SOUND, RATE_HZ = 343.0, 16_000


class Other(NamedTuple):
    """A kind of set-up.

    Attributes:
        run: makes the files in a folder, from a seed, with the fault or without it, and runs the stages.
        answer: what must be said of the fault.
        count: set-ups of a hundred that have it.
    """

    run: Callable[[Path, int, bool], list[Said]]
    answer: Answer
    count: int


def _walk(folder: Path, seed: int, kind: str, **settings: Any) -> tuple[Path, dict[str, Any]]:
    """A simulated walk of one person among stations (arrays or direction finders): scene, and its tables."""
    rng = np.random.default_rng((seed, 31))
    width, depth = rng.uniform(8.0, 14.0), rng.uniform(6.0, 10.0)
    spots = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0], [1.0, 1.0]])[: int(rng.integers(3, 5))]
    places = 0.2 + spots * (np.array([width, depth]) - 0.4) + rng.uniform(-0.1, 0.1, spots.shape)
    arrays = "".join(
        f"- {{name: {kind}{n}, position: [{x:.3f}, {y:.3f}, 1.5], sigma_deg: 3, planar: true}}\n"
        for n, (x, y) in enumerate(places.tolist(), start=1)
    )
    room = f"[[0, 0], [{width:.3f}, 0], [{width:.3f}, {depth:.3f}], [0, {depth:.3f}]]"
    path = folder / "scene.yaml"
    path.write_text(f"occlog_scene: 1\nlength_unit: m\nroom: {room}\nmicrophone_arrays:\n{arrays}")
    made = occlog.simulate(path, seconds=20, rate_hz=10, seed=seed, object_height=1.5, **settings)
    tables = {name: made[name].to_pandas() for name in made.tables}
    start = int(tables["truth"].t_ns.min())
    for table in tables.values():
        table["time"] = (table.t_ns - start) / NS
    return path, tables


def _directions(change: Callable[[Any], Any] | None, **options: Any) -> Callable[[Path, int, bool], list[Said]]:
    def run(folder: Path, seed: int, faulty: bool) -> list[Said]:
        scene, tables = _walk(folder, seed, "array")
        doa = tables["doa"][["time", "sensor", "azimuth"]]
        if faulty and change is not None:
            doa = change(doa)
        doa.to_csv(folder / "doa.csv", index=False)
        truth = tables["truth"].rename(columns={"target_id": "id"})[["time", "id", "x", "y"]]
        truth.to_csv(folder / "truth.csv", index=False)
        given = {"doa_unit": "rad", **(options if faulty else {})}
        made: dict[str, Any] = {}

        def ingest() -> Any:
            made["all"] = occlog.ingest(doa=[folder / "doa.csv"], scene=scene, truth=[folder / "truth.csv"], **given)
            return made["all"]

        def track() -> Any:
            made["tracks"] = occlog.track(made["all"], method="apf", seed=seed)
            return made["tracks"]

        return answers(
            [("ingest", ingest), ("track", track), ("evaluate", lambda: occlog.evaluate(made["tracks"], made["all"]))]
        )

    return run


def _turned(doa: Any) -> Any:
    """The first array is turned by 15 degrees."""
    first = doa.sensor == "array1"
    doa.loc[first, "azimuth"] = (doa.azimuth[first] + np.radians(15.0) + np.pi) % (2.0 * np.pi) - np.pi
    return doa


def _in_degrees(doa: Any) -> Any:
    doa["azimuth"] = np.degrees(doa.azimuth)
    return doa


def _ranges(folder: Path, seed: int, faulty: bool) -> list[Said]:
    """Ranges of stations; the first one states them 0.8 m too long."""
    scene, tables = _walk(folder, seed, "station", measure="range", range_noise=0.1)
    found = tables["measurements"]
    if faulty:
        found.loc[found.sensor == "station1", "range"] += 0.8
    path = folder / "ranges.csv"
    found.drop(columns=["t_ns"]).dropna(axis=1, how="all").to_csv(path, index=False)
    made: dict[str, Any] = {}

    def track() -> Any:
        made["tracks"] = occlog.track(path, scene, method="map", seed=seed, tag_height=1.5)
        return made["tracks"]

    return answers([("track", track)])


def _sound(folder: Path, seed: int, faulty: bool) -> list[Said]:
    """A talker who moves about a square of four microphones, one of which is late by 80 to 600 samples."""
    rng = np.random.default_rng((seed, 37))
    microphones = 0.032 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    seconds = 6
    dry = rng.normal(size=seconds * RATE_HZ) * np.repeat(rng.uniform(0.05, 1.0, seconds * 8), RATE_HZ // 8)
    angle = rng.uniform(-np.pi, np.pi)
    direction = np.array([np.cos(angle), np.sin(angle), 0.3]) / np.hypot(1.0, 0.3)
    spectrum, bins = np.fft.rfft(dry), np.fft.rfftfreq(len(dry), 1.0 / RATE_HZ)
    heard = np.array(
        [
            np.fft.irfft(spectrum * np.exp(2j * np.pi * bins * (m @ direction) / SPEED_OF_SOUND), len(dry))
            for m in microphones
        ]
    )
    heard += rng.normal(0.0, 0.05, heard.shape)
    if faulty:
        late = int(rng.integers(80, 600))
        heard[2] = np.concatenate([np.zeros(late), heard[2][:-late]])
    with wave.open(str(folder / "talk.wav"), "wb") as file:
        file.setparams((len(microphones), 2, RATE_HZ, 0, "NONE", ""))
        file.writeframes((heard.T / np.abs(heard).max() * 3e4).astype("<i2").tobytes())
    lines = [",".join(f"{value:.4f}" for value in row) for row in microphones]
    (folder / "mics.csv").write_text("\n".join(["x,y,z", *lines]) + "\n")
    arguments = [
        "listen",
        "--arrays",
        f"table={folder / 'mics.csv'}",
        folder / "talk.wav",
        "-o",
        folder / "doa.parquet",
    ]
    done = subprocess.run([sys.executable, "-m", "occlog", *arguments, "--json"], capture_output=True, text=True)
    if done.returncode not in (0, 3):
        return [Said("listen", "refused", done.stderr.strip().splitlines()[-1])]
    # The summary of `listen` has no findings
    lines = [line.partition("warning: ")[2] for line in done.stderr.splitlines()]
    return [Said("listen", "note", text) for text in lines if text]


def _image_tracks(change: Callable[[Floats], Floats]) -> Callable[[Path, int, bool], list[Said]]:
    """Tracks in the image of one camera in MOTChallenge text: true boxes with errors and misses."""

    def run(folder: Path, seed: int, faulty: bool) -> list[Said]:
        rng = np.random.default_rng((seed, 41))
        true = _true_boxes(seed)
        tracks = true[rng.random(len(true)) > 0.1].copy()
        tracks[:, 2:] += rng.normal(0.0, 2.0, (len(tracks), 4))
        if faulty:
            tracks = change(tracks)
        tracks = tracks[tracks[:, 0] >= 1]
        for name, rows, end in (("tracks.txt", tracks, "1,-1,-1,-1"), ("gt.txt", true, "1,1,1.0")):
            lines = [f"{int(f)},{int(i)},{x:.2f},{y:.2f},{w:.2f},{h:.2f},{end}" for f, i, x, y, w, h in rows.tolist()]
            (folder / name).write_text("\n".join(lines) + "\n")
        return answers([("evaluate", lambda: occlog.evaluate(folder / "tracks.txt", folder / "gt.txt"))])

    return run


def _true_boxes(seed: int) -> Floats:
    """(N, 6) frame from 1, identity, left, top, width and height of the people of a rig in its first camera."""
    made = rig(seed)
    rows = []
    for person in range(len(made.bodies)):
        alone = made.boxes_of(made.names[0], person)
        rows.append(
            np.column_stack(
                [alone[:, 0] + 1.0, np.full(len(alone), person + 1.0), alone[:, 1:3], alone[:, 3:] - alone[:, 1:3]]
            )
        )
    found = np.concatenate(rows)
    return np.asarray(found[np.lexsort((found[:, 1], found[:, 0]))])


def _scaled(rows: Floats) -> Floats:
    rows[:, 2:] *= 2.0 / 3.0
    return rows


def _shifted(rows: Floats) -> Floats:
    rows[:, 0] += 25.0
    return rows


def _corners(rows: Floats) -> Floats:
    rows[:, 4:] += rows[:, 2:4]
    return rows


OTHERS: dict[str, Other] = {
    "directions in degrees for radians": Other(_directions(_in_degrees), Answer("degree|radian|unit"), 1),
    "directions in radians for degrees": Other(_directions(None, doa_unit="deg"), Answer("degree|radian|unit"), 1),
    "array turned by 15 degrees": Other(_directions(_turned), Answer("sensor-turned", ("array1",)), 1),
    "station with biased ranges": Other(_ranges, Answer("range-bias", ("station1",)), 1),
    "microphone late": Other(_sound, Answer("late|delay.*3|3.*samples"), 1),
    "image tracks of another size": Other(_image_tracks(_scaled), Answer("size|scale"), 1),
    "image tracks with other frame numbers": Other(_image_tracks(_shifted), Answer("shifted|frame number"), 1),
    "image tracks with corners for sizes": Other(_image_tracks(_corners), Answer("corner|xyxy"), 1),
}
