"""Faults of clocks in every file that states times, and recordings of the same kinds without any.

Bags of ROS (MCAP, SQLite, ROS 1), boxes with a column of times, videos with and without a file of frame times, counts
of ODAS, and logs of directions.  Sizes are random: steps of 0.6 to 600 s, drifts of 500 to 20,000 ppm.  Sound ones have
jitter, delays, stalls and pauses of the recorder, and frames that are missing in all files.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

import occlog
from benchmarks.references import scene
from benchmarks.setups._judge import SWITCHES, Answer, Said, answers
from benchmarks.setups._rigs import Rig, other_camera, rig, write
from occlog.array_types import Floats, Ints
from occlog.examine.doctor.run import check_files
from occlog.records.messages import DOCTOR, Severity

Random = np.random.Generator
EPOCH_S = 1_700_000_000.0
"""When recordings begin, by UTC."""
ORIGINS = {"1980": -315_964_800.0, "since boot": -EPOCH_S + 900.0, "TAI": 37.0, "a time zone": 7200.0}
"""Times of clocks that count from elsewhere, minus UTC [s]."""
CAMERAS = ("cam1", "cam2", "cam3")
JUMP, OFFSET = "clock-jump|set|goes? back|not after|jump|begins again", "disjoint|offset|late|epoch|stamps"
UNIT, DRIFT, REPEAT = "unit|from frame to frame|implausible|disjoint", "drift", "repeat"
"""What must be said of the kinds of faults."""


class Clocks(NamedTuple):
    """A kind of recording with times.

    Attributes:
        run: makes the files in a folder, from a seed, with the fault or without it, and runs the stages; what was said,
            and what must be.
        count: faulty ones of sixty.
    """

    run: Callable[[Path, int, bool], tuple[list[Said], Answer]]
    count: int = 4


class Changed(NamedTuple):
    """Times [s] of one sensor with a fault, and what must be said."""

    times: Floats
    answer: Answer


Fault = Callable[[Floats, Random, str], Changed]


def _size(rng: Random, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _at(times: Floats, rng: Random) -> int:
    return int(rng.uniform(0.25, 0.75) * len(times))


def _step(*signs: float) -> Fault:
    """A clock that is set, forward or back, while it runs."""

    def change(times: Floats, rng: Random, name: str) -> Changed:
        step, at = float(rng.choice(signs)) * _size(rng, 0.6, 600.0), _at(times, rng)
        out = times + step * (np.arange(len(times)) >= at)
        return Changed(out, Answer(JUMP, (name,), abs(step), _period(times)))

    return change


def _period(times: Floats) -> float:
    return float(np.median(np.diff(times)))


def _drift(times: Floats, rng: Random, name: str) -> Changed:
    ppm = float(rng.choice([-1.0, 1.0])) * _size(rng, 500.0, 20_000.0)
    out = times[0] + (times - times[0]) * (1.0 + 1e-6 * ppm)
    return Changed(out, Answer(DRIFT, (name,), abs(ppm)))


def _drift_by_frames(times: Floats, rng: Random, name: str) -> Changed:
    """A drift of at least three frames by the end."""
    least = 3.0 * _period(times) / float(times[-1] - times[0])
    share = float(rng.choice([-1.0, 1.0])) * _size(rng, least, 4.0 * least)
    out = times[0] + (times - times[0]) * (1.0 + share)
    return Changed(out, Answer(DRIFT, (name,), abs(1e6 * share)))


def _origin(times: Floats, rng: Random, name: str) -> Changed:
    """A clock with another origin for all the time."""
    offset = ORIGINS[str(rng.choice(list(ORIGINS)))]
    return Changed(times + offset, Answer(OFFSET, (name,), abs(offset)))


def _origin_in_parts(times: Floats, rng: Random, name: str) -> Changed:
    """A clock with another origin, or one that is reset while it runs."""
    if rng.random() < 0.5:
        return _origin(times, rng, name)
    offset, at = ORIGINS[str(rng.choice(["1980", "since boot"]))], _at(times, rng)
    return Changed(times + offset * (np.arange(len(times)) >= at), Answer(JUMP, (name,), abs(offset)))


def _repeats(times: Floats, rng: Random, name: str) -> Changed:
    count, at = int(rng.integers(5, 40)), _at(times, rng)
    out = times.copy()
    out[at : at + count + 1] = out[at]
    return Changed(out, Answer(REPEAT, (name,), float(count)))


def _said(ingest: Callable[[], Any], files: Sequence[Path], track: bool = False) -> list[Said]:
    """What `ingest`, `doctor` and `track` say; losses are said, too."""
    made: dict[str, Any] = {}

    def run() -> Any:
        made["recording"] = ingest()
        return made["recording"]

    said = answers([("ingest", run)])
    said += [Said("ingest", "loss", str(loss)) for loss in (made["recording"].losses if made else ())]
    said += [
        Said("doctor", each.kind, str(each))
        for each in check_files(files).findings
        if DOCTOR[each.kind].severity is not Severity.NOTE and each.kind != "gap"  # there are pauses
    ]
    if track and made:
        tracked = answers([("track", lambda: occlog.track(made["recording"], method="jipda", seed=0))])
        said += [each for each in tracked if each.id != SWITCHES]
    return said


def _times(rng: Random, names: Sequence[str], seconds: float, rate_hz: float) -> dict[str, Floats]:
    """(n,) times [s] of the frames of each camera, free-running or triggered together, with jitter."""
    shared = bool(rng.random() < 0.5)
    out = {}
    for name in names:
        begin = 0.0 if shared else rng.uniform(0.0, 1.0 / rate_hz)
        numbers = np.arange(round(seconds * rate_hz))
        out[name] = EPOCH_S + begin + numbers / rate_hz + rng.uniform(-0.02, 0.02, len(numbers)) / rate_hz
    return out


def _ns(times: Floats) -> Ints:
    return np.asarray(np.round((times - EPOCH_S) * 1e9).astype(np.int64) + round(EPOCH_S * 1e9))


def _bag(fault: Fault) -> Callable[[Path, int, bool], tuple[list[Said], Answer]]:
    """A bag of images with header stamps, recorded with delays and one stall of the recorder."""

    def run(folder: Path, seed: int, faulty: bool) -> tuple[list[Said], Answer]:
        ros, rng = scene("ros_bags"), np.random.default_rng((seed, 53))
        times = _times(rng, CAMERAS, rng.uniform(40.0, 60.0), float(rng.choice([5.0, 8.0, 10.0])))
        pause = rng.uniform(10.0, 30.0)
        if rng.random() < 0.5:  # nothing is published for a while
            times = {c: t[(t < EPOCH_S + pause) | (t > EPOCH_S + pause + 3.0)] for c, t in times.items()}
        stall, length = EPOCH_S + rng.uniform(5.0, 35.0), rng.uniform(0.3, 1.5)
        logged = {c: t + 0.002 + rng.exponential(0.003, len(t)) for c, t in times.items()}
        for c, t in logged.items():
            held = (t > stall) & (t < stall + length)
            t[held] = stall + length + 0.001 * np.arange(held.sum())
            logged[c] = np.maximum.accumulate(t)
        name = str(rng.choice(CAMERAS))
        changed = fault(times[name], rng, name)
        if faulty:
            times[name] = changed.times
        rows = []
        for c, own in times.items():
            for k, (stamp, log) in enumerate(zip(_ns(own).tolist(), _ns(logged[c]).tolist(), strict=True)):
                message = ros.compressed(max(stamp, 1), c, ros.picture(k + 7 * CAMERAS.index(c)))
                rows.append((f"/{c}/image_raw/compressed", "sensor_msgs/msg/CompressedImage", log, message))
        rows.sort(key=lambda row: row[2])
        form = str(rng.choice(["mcap", "db3", "bag"]))
        if form == "bag":
            path = scene("ros1_bags").write_bag(folder / "walk.bag", rows)
        else:
            path = (ros.write_mcap if form == "mcap" else ros.write_db3)(folder / f"walk.{form}", rows)
        return _said(lambda: occlog.ingest(path, allow_uncalibrated=True), [path]), changed.answer

    return run


def _boxes(fault: Fault, seconds: float = 0.0) -> Callable[[Path, int, bool], tuple[list[Said], Answer]]:
    """Boxes of a rig of three or four cameras with a column of times."""

    def run(folder: Path, seed: int, faulty: bool) -> tuple[list[Said], Answer]:
        rng = np.random.default_rng((seed, 59))
        made = rig(seed, int(rng.integers(3, 5)))
        if seconds:
            made.lengthen(seconds)
        made.truth = made.truth[:0]
        name = other_camera(made, rng)
        made.options = {}
        files, own = write(made, folder), {c: _frame_times(made, rng) for c in made.names}
        changed = fault(own[name], rng, name)
        if faulty:
            own[name] = changed.times
        for c, path in files["boxes"].items():
            _with_times(path, own[c])
        return _said(lambda: occlog.ingest(**files), list(files["boxes"].values()), track=not faulty), changed.answer

    return run


def _frame_times(made: Rig, rng: Random) -> Floats:
    return np.asarray(EPOCH_S + (np.arange(made.frames) + rng.uniform(-0.02, 0.02, made.frames)) / made.fps)


def _with_times(path: Path, times: Floats, column: str = "time", factor: float = 1.0) -> None:
    """Add a column of times to a file of boxes."""
    lines = path.read_text().splitlines()
    frames = [int(line.split(",")[0]) for line in lines[1:]]
    cells = [f"{factor * times[k]:.6f}" for k in frames]
    path.write_text("\n".join([f"{lines[0]},{column}", *map(",".join, zip(lines[1:], cells, strict=True))]) + "\n")


UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}


def _boxes_unit(folder: Path, seed: int, faulty: bool) -> tuple[list[Said], Answer]:
    """Times of one camera in another unit than those of the others, or than their column states, from 1 s on."""
    rng = np.random.default_rng((seed, 61))
    made = rig(seed, 3)
    made.truth = made.truth[:0]
    name, unit = other_camera(made, rng), str(rng.choice(list(UNITS)))
    made.options = {}
    files = write(made, folder)
    stated, column = bool(rng.random() < 0.5), str(rng.choice(["time", "timestamp"]))
    for c, path in files["boxes"].items():
        factor = UNITS[unit] if faulty and c == name else 1.0
        _with_times(path, _frame_times(made, rng) - EPOCH_S + 1.0, "t_s" if stated else column, factor)
    said = _said(lambda: occlog.ingest(**files), list(files["boxes"].values()), track=not faulty)
    return said, Answer(UNIT, (name,), UNITS[unit], similar=UNITS[unit] / made.fps)


def _matroska(path: Path, times_ms: Sequence[int], brightness: int = 120) -> Path:
    """A video of small pictures (Motion JPEG) with these times [ms]."""

    def element(name: int, content: bytes) -> bytes:
        head = name.to_bytes((name.bit_length() + 7) // 8, "big")
        return head + (len(content) | 1 << 56).to_bytes(8, "big") + content

    def number(name: int, value: int) -> bytes:
        return element(name, value.to_bytes(8, "big"))

    size = element(0xE0, number(0xB0, 64) + number(0xBA, 48))
    track = number(0xD7, 1) + number(0x73C5, 1) + number(0x83, 1) + element(0x86, b"V_MJPEG") + size
    parts = [element(0x1549A966, number(0x2AD7B1, 1_000_000)), element(0x1654AE6B, element(0xAE, track))]
    for k, time in enumerate(times_ms):
        image = np.full((48, 64, 3), brightness, np.uint8)
        image[:, : 8 + 2 * (k % 24)] = 30 + 3 * (k % 60)
        picture = cv2.imencode(".jpg", image)[1].tobytes()
        block = element(0xA3, b"\x81" + struct.pack(">hB", 0, 0x80) + picture)
        parts.append(element(0x1F43B675, number(0xE7, int(time)) + block))
    head = element(0x1A45DFA3, element(0x4282, b"matroska") + number(0x4287, 4) + number(0x4285, 2))
    path.write_bytes(head + element(0x18538067, b"".join(parts)))
    return path


def _videos(fault: Fault | None, *, container: bool = False) -> Callable[[Path, int, bool], tuple[list[Said], Answer]]:
    """Three videos with files of the times of their frames, or with times in the container alone; None: a unit."""

    def run(folder: Path, seed: int, faulty: bool) -> tuple[list[Said], Answer]:
        rng = np.random.default_rng((seed, 67))
        rate_hz = float(rng.choice([5.0, 8.0, 10.0]))
        times = _times(rng, CAMERAS, rng.uniform(30.0, 60.0), rate_hz)
        name, unit = str(rng.choice(CAMERAS)), str(rng.choice(list(UNITS)))
        if fault is not None:
            changed = fault(times[name], rng, name)
            times[name] = changed.times if faulty else times[name]
            answer = changed.answer
        else:
            answer = Answer(UNIT, (name,), UNITS[unit], similar=UNITS[unit] / rate_hz)
        stamps = {}
        for c, own in times.items():
            shown = (1e3 * (own - own[0] if container else np.arange(len(own)) / rate_hz)).astype(int)
            _matroska(folder / f"{c}.mkv", shown, 120 + 20 * CAMERAS.index(c))
            since = own - EPOCH_S + 1.0 if fault is None else own
            factor = UNITS[unit] if fault is None and faulty and c == name else 1.0
            stamps[c] = folder / f"{c}.times.csv"
            rows = [f"{k},{factor * t:.6f}" for k, t in enumerate(since.tolist())]
            stamps[c].write_text("\n".join(["frame,time", *rows]) + "\n")
        videos = {c: folder / f"{c}.mkv" for c in CAMERAS}
        given: dict[str, Any] = {} if container else {"timestamps": stamps}
        said = _said(
            lambda: occlog.ingest(
                video=videos, allow_uncalibrated=True, store="link", output=folder / "made.mcap", **given
            ),
            [*videos.values(), *(() if container else stamps.values())],
        )
        return said, answer

    return run


ARRAYS = ("array1", "array2", "array3")


def _room(folder: Path) -> Path:
    spots = ((0.2, 0.2), (9.8, 0.2), (5.0, 7.8))
    arrays = "".join(
        f"- {{name: {name}, position: [{x}, {y}, 1.5], sigma_deg: 3, planar: true}}\n"
        for name, (x, y) in zip(ARRAYS, spots, strict=True)
    )
    path = folder / "scene.yaml"
    path.write_text(
        f"occlog_scene: 1\nlength_unit: m\nroom: [[0, 0], [10, 0], [10, 8], [0, 8]]\nmicrophone_arrays:\n{arrays}"
    )
    return path


def _odas(folder: Path, seed: int, faulty: bool) -> tuple[list[Said], Answer]:
    """A stream of ODAS in which the count of hops begins again."""
    rng = np.random.default_rng((seed, 71))
    hop, begin = 0.008, int(rng.integers(0, 2000))
    counts = begin + 5 * np.arange(int(rng.integers(1500, 4000)))
    at = _at(counts.astype(np.float64), rng)
    again = counts.copy()
    again[at:] -= counts[at] - int(rng.integers(0, 10))
    back_s = hop * float(again[at - 1] - again[at])
    lines = []
    for k, count in enumerate((again if faulty else counts).tolist()):
        x, y = np.cos(0.001 * k), np.sin(0.001 * k)
        heard = {"id": 1, "tag": "dynamic", "x": round(x, 4), "y": round(y, 4), "z": 0.0, "activity": 0.9}
        source = heard if rng.random() > 0.1 else {"id": 0, "tag": "", "x": 0.0, "y": 0.0, "z": 0.0, "activity": 0.0}
        lines.append(json.dumps({"timeStamp": count, "src": [source]}))
    path = folder / "sst.json"
    path.write_text("\n".join(lines) + "\n")
    said = _said(
        lambda: occlog.ingest(doa={"array1": path}, scene=_room(folder), odas_hop_s=str(hop), doa_convention="array"),
        [path],
    )
    return said, Answer(JUMP, ("array1",), back_s, 10 * hop)


def _directions(folder: Path, seed: int, faulty: bool) -> tuple[list[Said], Answer]:
    """Logs of three arrays as tables, one of which is set, of another origin, or in another unit."""
    rng = np.random.default_rng((seed, 73))
    name, kind = str(rng.choice(ARRAYS)), int(rng.integers(3))
    answer, paths = Answer(""), {}
    for array in ARRAYS:
        times = 100.0 + np.arange(300) / 10.0
        times, factor = times[rng.random(300) < 0.9] + (EPOCH_S if kind < 2 else 0.0), 1.0
        if array == name:
            changed = (_step(-1.0, 1.0), _origin)[kind](times, rng, name) if kind < 2 else None
            unit = str(rng.choice(list(UNITS)))
            answer = (
                Answer(UNIT, (name,), UNITS[unit], similar=0.1 * UNITS[unit]) if changed is None else changed.answer
            )
            if faulty:
                times, factor = (times, UNITS[unit]) if changed is None else (changed.times, 1.0)
        rows = [f"{factor * t:.6f},{np.degrees(np.sin(0.01 * k)):.2f}" for k, t in enumerate(times.tolist())]
        paths[array] = folder / f"{array}.csv"
        paths[array].write_text("\n".join(["time,azimuth_deg", *rows]) + "\n")
    return _said(lambda: occlog.ingest(doa=paths, scene=_room(folder)), list(paths.values())), answer


CLOCKS: dict[str, Clocks] = {
    "stamps of a bag set forward": Clocks(_bag(_step(1.0))),
    "stamps of a bag set back": Clocks(_bag(_step(-1.0))),
    "stamps of a bag that drift": Clocks(_bag(_drift)),
    "stamps of a bag of another origin": Clocks(_bag(_origin_in_parts)),
    "stamps of a bag that repeat": Clocks(_bag(_repeats)),
    "times of boxes set": Clocks(_boxes(_step(-1.0, 1.0))),
    "times of boxes of another origin": Clocks(_boxes(_origin)),
    "times of boxes in another unit": Clocks(_boxes_unit),
    "times of boxes that drift": Clocks(_boxes(_drift_by_frames, 20.0)),
    "times of frames set": Clocks(_videos(_step(-1.0, 1.0))),
    "times of frames of another origin": Clocks(_videos(_origin)),
    "times of frames that drift": Clocks(_videos(_drift_by_frames)),
    "times of frames that repeat": Clocks(_videos(_repeats)),
    "times of frames in another unit": Clocks(_videos(None)),
    "times of a video container set": Clocks(_videos(_step(1.0), container=True)),
    "count of ODAS that begins again": Clocks(_odas),
    "times of directions": Clocks(_directions),
}
