"""`occlog listen`: open sound and scene, find directions, and write them sorted by time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, UsageError, abridged, option
from occlog.ingest.plan import for_sensor, pairs
from occlog.io.files.names import match_sensor
from occlog.io.files.timing.frame_times import to_world_time
from occlog.io.files.timing.times import parse_start_time
from occlog.io.formats.sound.formats import read_arrays
from occlog.io.formats.sound.wav import Sound, open_sound
from occlog.io.open import load_scene
from occlog.records.losses import Loss
from occlog.records.names import first_double
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Doa
from occlog.records.verdicts import summary_of
from occlog.runner import Job
from occlog.settings import configure

from .channels import Channels, checks
from .config import DoaConfig
from .locate import library, speed_of_sound
from .request import DoaRequest
from .stage import DoaTally, estimate_directions, frame_size, frames_of

T = TypeVar("T")
Pairs = tuple[tuple[str | None, T], ...]


class _Plan(NamedTuple):
    """Parsed inputs and settings of a request.

    Attributes:
        scene: file of the scene; None: not given.
        sounds: pairs of the name of an array (None: not named) and a sound file.
        arrays: pairs of the name of an array (None: not named) and a file of positions of microphones.
        channels: channels that are used, from 0; empty: all.
        start_time: pairs of the name of an array (None: all) and the text of the time of its first sample.
        config: settings.
    """

    scene: Path | None
    sounds: Pairs[Path]
    arrays: Pairs[Path]
    channels: tuple[int, ...]
    start_time: Pairs[str]
    config: DoaConfig


def _plan(request: DoaRequest) -> _Plan:
    """Parse a request; UsageError or SettingError if it is invalid."""
    settings = dict(request.settings)
    if request.source_limit is not None:
        settings["max_sources"] = parse_most(request.source_limit)
    if request.band is not None:
        settings |= {"low_hz": request.band[0], "high_hz": request.band[1]}
    return _Plan(
        scene=request.scene,
        sounds=pairs(map(str, request.sounds), Path),
        arrays=pairs(request.arrays, Path),
        channels=parse_channels(request.channels),
        start_time=pairs(request.start_time, str),
        config=configure(DoaConfig(), settings),
    )


def parse_most(text: str) -> int:
    """Parse the maximum number of directions per frame, 1 to 100; 0 for `auto`; UsageError for anything else."""
    if text == "auto":
        return 0
    if not (text.isdecimal() and 1 <= int(text) <= 100):
        raise UsageError(f"{option('max_sources')} {text}: must be 1 to 100, or auto")
    return int(text)


def parse_channels(parts: tuple[str, ...]) -> tuple[int, ...]:
    """Parse a list of channels (from 1) to indices (from 0); UsageError for anything else or a repeated one."""
    text = ",".join(parts)
    if not all(part.isdecimal() and 1 <= int(part) <= 4096 for part in parts):
        raise UsageError(f"{option('channels')} {text}: expected numbers from 1, with commas")
    found = tuple(int(part) - 1 for part in parts)
    if len(set(found)) != len(found):
        raise UsageError(f"{option('channels')} {text}: names a channel twice", id="duplicate-name")
    return found


def run_listen(request: DoaRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Estimate directions of arrival in sound files and write them; return the summary and the losses."""
    plan = _plan(request)
    library()  # before anything is read
    scene = _scene(plan)
    chosen = _arrays(plan, scene)
    sounds = {name: open_sound(path) for name, path in chosen.items()}
    tallies = {name: DoaTally() for name in chosen}
    in_scene = {array.name: array for array in scene.arrays}
    speed = speed_of_sound(plan.config, scene.length_unit)
    channels = {name: Channels(in_scene[name].microphones / speed, sounds[name].rate) for name in chosen}
    streams = [_directions(scene, name, sounds[name], plan, tallies[name], channels[name], job) for name in chosen]
    parameters = {
        **asdict(plan.config),
        "sounds": {n: p.name for n, p in chosen.items()},
        "channels": [c + 1 for c in plan.channels],
        "start_time": [list(p) for p in plan.start_time],
    }
    provenance = job.provenance(parameters)
    rows = dict.fromkeys(chosen, 0)
    with job.tables(provenance, scene.length_unit) as tables:
        for table in heapq.merge(*streams, key=lambda t: (int(t.t_ns[0]), str(t.sensor[0]))):
            tables.write(output=table)
            rows[str(table.sensor[0])] += len(table)
        losses = [loss for sound in sounds.values() for loss in sound.losses]
        made = replace(provenance, losses=tuple(losses))
        made = job.judged(made, checks(channels, tallies, rows))
        tables.annotate(made)
    seconds = {name: sound.frames / sound.rate for name, sound in sounds.items()}
    return {
        "doa": str(request.output),
        "rows": rows,
        "seconds": {name: round(s, 3) for name, s in seconds.items()},
        "frames": {name: t.frames for name, t in tallies.items()},
        "silent_frames": {name: t.silent for name, t in tallies.items()},
        "low_confidence_frames": {name: t.unsure for name, t in tallies.items()},
        **summary_of(made.judged),
    }, losses


def _scene(plan: _Plan) -> Scene:
    scene = load_scene(plan.scene, None, plan.scene) if plan.scene is not None else Scene()
    more = [a for name, path in plan.arrays for a in read_arrays(path, name)]
    if more and scene.length_unit != "m":
        raise UsageError(
            f"{option('arrays')}: tables are in m, but {plan.scene} is in {scene.length_unit}; state all arrays there",
            id="unit-mismatch",
        )
    arrays = (*scene.arrays, *more)
    if (double := first_double([a.name for a in arrays])) is not None:
        raise UsageError(
            f"array {double}: is given twice, in the scene or {option('arrays')}; keep one", id="duplicate-name"
        )
    if not arrays:
        raise UsageError(
            f"no array with known microphones; give {option('scene')} with microphone_arrays, or {option('arrays')}",
            id="too-few-sensors",
        )
    return replace(scene, arrays=arrays)


def _arrays(plan: _Plan, scene: Scene) -> dict[str, Path]:
    """Sound file of each array that has one, by name; UsageError if a file names no array, or two the same."""
    names = [a.name for a in scene.arrays]
    out: dict[str, Path] = {}
    for label, path in plan.sounds:
        if label is None and len(names) > 1:
            raise UsageError(
                f"{path}: does not name its array; give ARRAY={path.name} (arrays: {abridged(names)})",
                id="camera-not-named",
            )
        name = names[0] if label is None else match_sensor(label, names, str(path), what="array")
        if name in out:
            raise UsageError(f"array {name}: has two files; give each array one", id="duplicate-name")
        out[name] = path
    return out


def _directions(
    scene: Scene, name: str, sound: Sound, plan: _Plan, tally: DoaTally, channels: Channels, job: Job
) -> Iterator[Doa]:
    """Generate tables of the directions of the array `name`, sorted by world time.

    `tally` and `channels` are updated in place. InputError for a file shorter than a frame, or with another number of
    channels than the array has microphones.
    """
    array = next(a for a in scene.arrays if a.name == name)
    _check_channels(sound, array, plan.channels)
    text = for_sensor(plan.start_time, name)
    start = 0 if text is None else parse_start_time(text)
    clock = next((c for c in scene.clocks if c.name == array.clock), None)
    total = frames_of(sound.frames, sound.rate, plan.config)
    if total == 0:
        least = frame_size(sound.rate, plan.config)
        raise InputError(
            f"{sound.path}: {sound.frames} samples ({sound.frames / sound.rate:.3g} s) are fewer than one frame has, "
            f"{least} ({least / sound.rate:.3g} s); give a shorter {option('frame')} and {option('window')}, or leave "
            "the file out",
            id="insufficient-data",
        )
    blocks = channels.watch(_blocks(sound, plan.channels))
    found = estimate_directions(blocks, sound.rate, array, scene.length_unit, plan.config, start, tally)
    for table in job.progress(found, f"listen {name}", total):
        yield table if clock is None else replace(table, t_ns=to_world_time(table.t_ns, clock, start))


MIN_APART = 1e-3
"""Distance of two microphones, over the median one in the array, up to which they are at one position."""


def _check_channels(sound: Sound, array: MicrophoneArray, channels: tuple[int, ...]) -> None:
    over = [c + 1 for c in channels if c >= sound.channels]
    if over:
        raise UsageError(f"{sound.path}: has {sound.channels} channels, no channel {over[0]} ({option('channels')})")
    have = len(channels) or sound.channels
    if have != len(array.microphones):
        raise InputError(
            f"{sound.path}: {have} channels, but array {array.name} has {len(array.microphones)} microphones; "
            f"choose the channels of the microphones with {option('channels')}, or correct `microphones`",
            id="incompatible-inputs",
        )
    apart = np.linalg.norm(array.microphones[:, None] - array.microphones, axis=2)
    first, second = np.nonzero(np.triu(apart <= MIN_APART * np.median(apart), 1))
    if len(first):
        raise InputError(
            f"{sound.path}: microphones {first[0] + 1} and {second[0] + 1} of array {array.name} have one and the same "
            "position; correct it",
            id="conflicting-values",
        )


def _blocks(sound: Sound, channels: tuple[int, ...]) -> Iterator[Floats]:
    for block in sound.blocks():
        yield np.ascontiguousarray(block[:, list(channels)]) if channels else block
