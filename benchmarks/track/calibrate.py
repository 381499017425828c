"""Calibration by people who walk, against the true cameras: simulated rooms with rough poses and late clocks.

    python -m benchmarks.track.calibrate [--rigs N] [--seed N] [--cameras N] [--seconds S]
        [--without-poses | --arrays | --sizes-alone]

Rooms, lenses, detectors and people are those of `benchmarks.setups`; bodies are not the ellipsoids of the estimator.
Stated poses are off by 3 degrees and 0.5 m per axis, clocks by up to 0.8 s.  Errors are relative to all cameras
together, after a similarity in the plane.  NEES is that of each parameter: 1 if standard deviations are right.

With --arrays three microphone arrays of unknown pose and clock are in each room, on two walls and in the middle.  Each
person speaks for 3 s on average and is silent for 8 s; a tenth of the directions is missed, and one in two seconds is
of no person.  With --sizes-alone nothing is known of cameras but the size of their images.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.setups import _rigs
from occlog.array_types import NS, Floats
from occlog.calibrate.adjustment import FOCAL
from occlog.calibrate.config import CalibrateConfig
from occlog.calibrate.microphones.arrays import ArrayPrior, Directions, place_array
from occlog.calibrate.stage import Calibrated, CameraResult, calibrate, tracks_in_images
from occlog.calibrate.starts.focal import focal_of_people, with_focal
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles, wrap_angle
from occlog.errors import InputError
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.records.tables import Doa, Truth
from occlog.simulate.config import ObserveConfig, SoundConfig
from occlog.simulate.sensors.arrays import observe_arrays
from occlog.track.methods.jipda.interface import FrameDetections
from occlog.track.people.frame_detections import FrameDetectionsWithIds

NAME = "calibrate"
SUMMARY = "error of positions of calibrated cameras over the limit: median of simulated rooms, 4 cameras, 30 s [m]"
LIMIT = 0.05
MAX_LATE_S, SIGMA_POSITION, SIGMA_ANGLE = 0.8, 0.5, np.radians(3.0)


def frames_of(rig: _rigs.Rig, late: Floats) -> list[FrameDetectionsWithIds]:
    """Boxes of a rig as frames, stamped by clocks that are late [s]."""
    out, row = [], 0
    for c, name in enumerate(rig.names):
        boxes = rig.boxes[name]
        for k in range(rig.frames):
            own = boxes[boxes[:, 0] == k, 1:]
            n = len(own)
            none = np.full(n, np.nan), np.full(n, -1), np.zeros((n, 0)), np.arange(row, row + n)
            stamp = round((k / rig.fps + late[c]) * NS)
            out.append(FrameDetectionsWithIds(FrameDetections(stamp, c, own, *none), k, np.arange(n)))
            row += n
    return sorted(out, key=lambda each: each.detections.t_ns)


def stated(cameras: list[Camera], rng: np.random.Generator, *, poses: bool) -> list[Camera]:
    """Cameras with rough poses, or without."""
    out = []
    for camera in cameras:
        angles = np.array(angles_from_rotation(camera.rotation)) + rng.normal(0.0, SIGMA_ANGLE, 3)
        position = camera.position + rng.normal(0.0, SIGMA_POSITION, 3)
        out.append(replace(camera, position=position, rotation=rotation_from_angles(*angles.tolist()), placed=poses))
    return out


def errors(found: list[CameraResult], true: list[Camera], late: Floats) -> dict[str, Floats]:
    """Errors of positions [m], yaw [deg] and clocks [s] of the calibrated cameras, and their NEES."""
    own = [c for c, each in enumerate(found) if each.estimated]
    ours = np.array([complex(*found[c].camera.position[:2].tolist()) for c in own])
    real = np.array([complex(*true[c].position[:2].tolist()) for c in own])
    m = ((real - real.mean()) * np.conj(ours - ours.mean())).sum() / (np.abs(ours - ours.mean()) ** 2).sum()
    off = m * (ours - ours.mean()) - (real - real.mean())
    z = np.array([abs(m) * found[c].camera.position[2] - true[c].position[2] for c in own])
    yaw = [angles_from_rotation(found[c].camera.rotation)[0] - angles_from_rotation(true[c].rotation)[0] for c in own]
    turned = np.angle(np.exp(1j * (np.array(yaw) + np.angle(m))))
    sigma_yaw = [np.linalg.norm(found[c].camera.rotation[2] * found[c].sigma[:3]) for c in own]
    clock = np.array([found[c].late_s - late[c] for c in own]) + np.sort(late[own])[(len(own) - 1) // 2]
    sigma = np.array([found[c].sigma for c in own])
    # Without the direction of a similarity, errors of x and y are those along other axes
    with np.errstate(divide="ignore", invalid="ignore"):
        nees = [
            np.abs(off) ** 2 / (sigma[:, 3] ** 2 + sigma[:, 4] ** 2),
            (z / sigma[:, 5]) ** 2,
            (clock / sigma[:, 8]) ** 2,
            (turned / np.array(sigma_yaw)) ** 2,
        ]
    return {
        "position": np.abs(off), "height": np.abs(z), "yaw": np.degrees(np.abs(turned)), "clock": np.abs(clock),
        "nees": np.column_stack(nees),
    }  # fmt: skip


ARRAY_SIGMA_DEG, ARRAY_HZ, MOUTH_SHARE = 3.0, 5.0, 0.88
"""Errors of directions, their rate, and the height of mouths over that of people."""


def arrays_of(rig: _rigs.Rig, rng: np.random.Generator) -> list[MicrophoneArray]:
    """Arrays on two walls and in the middle, in any direction."""
    width, depth = rig.size
    at = [(0.1, 0.6 * depth, 2.2), (0.7 * width, depth - 0.1, 2.5), (0.45 * width, 0.4 * depth, 0.8)]
    return [
        MicrophoneArray(
            f"array{k}", np.array(position), float(rng.uniform(-np.pi, np.pi)), sigma=np.radians(ARRAY_SIGMA_DEG),
            rate_hz=ARRAY_HZ,
        )
        for k, position in enumerate(at)
    ]  # fmt: skip


def sounds_of(rig: _rigs.Rig, arrays: list[MicrophoneArray]) -> Doa:
    """Directions of people who speak in turns, by `occlog simulate`."""
    step = round(_rigs.FINE_HZ / 10.0)
    rows = round(_rigs.MARGIN_S * _rigs.FINE_HZ) + step * np.arange(round(rig.seconds * 10.0))
    at, people = rig.paths[rows], len(rig.bodies)
    n = len(rows) * people
    truth = Truth.of(
        t_ns=np.repeat(np.arange(len(rows)) * (NS // 10), people), target_id=np.tile(np.arange(people), len(rows)),
        x=at[..., 0].ravel(), y=at[..., 1].ravel(), z=np.tile(MOUTH_SHARE * rig.bodies[:, 0], len(rows)),
        role=np.full(n, "target"),
    )  # fmt: skip
    sound = SoundConfig(sound_and_silence_s=(3.0, 8.0), false_alarm_rate=0.5)
    scene = Scene((), arrays=tuple(arrays))
    return Doa.concat(observe_arrays(scene, [truth], ObserveConfig(miss_probability=0.1), rig.seed, sound))


def placed_arrays(rig: _rigs.Rig, found: Calibrated, late: Floats) -> Floats:
    """(A, 9) errors of arrays: position [m], height, yaw [deg], clock [s], their NEES, and whether one is refused."""
    rng = np.random.default_rng((rig.seed, 17))
    arrays = arrays_of(rig, rng)
    heard = sounds_of(rig, arrays)
    own = [c for c, each in enumerate(found.cameras) if each.estimated]
    true = [rig.cameras[name] for name in rig.names]
    ours = np.array([complex(*found.cameras[c].camera.position[:2].tolist()) for c in own])
    real = np.array([complex(*true[c].position[:2].tolist()) for c in own])
    m = ((real - real.mean()) * np.conj(ours - ours.mean())).sum() / (np.abs(ours - ours.mean()) ** 2).sum()
    middle, out = float(np.sort(late[own])[(len(own) - 1) // 2]), []
    for array in arrays:
        part = heard.take(np.flatnonzero(heard.sensor == array.name))
        array_late = float(rng.uniform(-MAX_LATE_S, MAX_LATE_S))
        # Directions as an array reports them, and a scene that knows nothing of its pose
        stated = replace(array, position=np.zeros(3), yaw=0.0)
        azimuth = wrap_angle(part.azimuth - array.yaw)
        own_t = part.t_ns / NS + array_late
        directions = Directions(own_t, azimuth, part.elevation, part.sigma_azimuth, part.sigma_elevation)
        config = CalibrateConfig()
        prior = ArrayPrior(
            0.0, config.max_clock_offset, config.source_height, config.sigma_source_height, 1.0
        )  # fmt: skip
        each = place_array(stated, directions, found.paths, prior)
        off = m * (complex(*each.array.position[:2].tolist()) - ours.mean()) + real.mean()
        away = abs(off - complex(*array.position[:2].tolist()))
        up = abs(m) * each.array.position[2] - array.position[2]
        yaw = abs(float(wrap_angle(np.array(each.array.yaw + np.angle(m) - array.yaw))))
        clock = each.late_s - array_late + middle
        sx, sy, sz, syaw, slate = each.sigma.tolist()
        nees = [away**2 / (sx**2 + sy**2), (up / sz) ** 2, (yaw / syaw) ** 2, (clock / slate) ** 2]
        figures = f"position {away:.3f} height {up:.3f} yaw {np.degrees(yaw):.2f} clock {clock:.3f}"
        print(rig.seed, array.name, each.reason or figures, flush=True)
        out.append([away, abs(up), np.degrees(yaw), abs(clock), *nees, float(bool(each.reason))])
    return np.array(out)


def sizes_measured(seeds: Iterable[int], cameras: int) -> None:
    """Calibrate cameras of which the image size alone is known; print errors of positions, yaw and focal lengths."""
    rows = []
    for seed in seeds:
        frames, true, start, late = room(seed, cameras, poses=False)
        bare = [replace(c, principal_px=np.zeros(2), distortion=np.zeros(5), focal_px=np.ones(2)) for c in start]
        guess = [focal_of_people(c, tracks_in_images(frames, k, c), 1.7) for k, c in enumerate(bare)]
        lenses = [with_focal(c, each.focal_px) for c, each in zip(bare, guess, strict=True)]
        sigma = np.array([each.sigma_log for each in guess])
        try:
            found = calibrate(frames, Scene(tuple(lenses)), lenses, CalibrateConfig(), sigma_log_focal=sigma)
        except InputError as error:
            print(f"{seed}: refused: {error}", flush=True)
            continue
        off = errors(found.cameras, true, late)
        own = [c for c, each in enumerate(found.cameras) if each.estimated]
        for n, c in enumerate(own):
            focal, first = float(found.cameras[c].camera.focal_px[0]), guess[c].focal_px
            real = float(true[c].focal_px[0])
            nees = (np.log(focal / real) / found.cameras[c].sigma[FOCAL]) ** 2
            rows.append([off["position"][n], off["yaw"][n], abs(first / real - 1.0), abs(focal / real - 1.0), nees])
        print(f"{seed}: " + str(np.round(rows[-len(own) :], 3).tolist()), flush=True)
    names = ("position [m]", "yaw [deg]", "focal length at the start", "focal length", "NEES of focal length")
    for name, column in zip(names, np.array(rows).T, strict=True):
        print(f"{name}: median {np.median(column):.4g}, 95 % {np.percentile(column, 95):.4g}, mean {column.mean():.4g}")


def arrays_measured(seeds: Iterable[int], cameras: int) -> None:
    """Calibrate cameras with rough poses, then arrays; print errors."""
    every = []
    for seed in seeds:
        frames, _, start, late = room(seed, cameras, poses=True)
        found = calibrate(frames, Scene(tuple(start)), start, CalibrateConfig())
        every.append(placed_arrays(_rigs.rig(seed, cameras), found, late))
    rows = np.concatenate(every)
    good = rows[rows[:, 8] == 0.0]
    print(f"arrays {len(rows)}, refused {len(rows) - len(good)}")
    for k, name in enumerate(("position", "height", "yaw", "clock")):
        print(
            f"{name}: median {np.median(good[:, k]):.4g}, 95 % {np.percentile(good[:, k], 95):.4g}, "
            f"mean NEES {good[:, 4 + k].mean():.4g}"
        )


Case = tuple[list[FrameDetectionsWithIds], list[Camera], list[Camera], Floats]
"""Frames, true and stated cameras, and by how much clocks are late [s]."""


def room(seed: int, cameras: int, *, poses: bool) -> Case:
    """A room with cameras about its walls."""
    rig, rng = _rigs.rig(seed, cameras), np.random.default_rng((seed, 11))
    true, late = [rig.cameras[name] for name in rig.names], rng.uniform(-MAX_LATE_S, MAX_LATE_S, cameras)
    return frames_of(rig, late), true, stated(true, rng, poses=poses), late


def measured(cases: Iterable[tuple[int, Case]], config: CalibrateConfig, *, show: bool) -> dict[str, Any]:
    """Medians and largest values over simulated rooms."""
    every: list[dict[str, Floats]] = []
    refused = left = count = 0
    for k, (frames, true, start, late) in cases:
        count += 1
        try:
            found = calibrate(frames, Scene(tuple(start)), start, config)
        except InputError as error:
            refused += 1
            print(f"{k}: refused: {error}") if show else None
            continue
        left += sum(not each.estimated for each in found.cameras)
        every.append(errors(found.cameras, true, late))
        if show:
            worst = {name: float(np.max(values)) for name, values in every[-1].items() if name != "nees"}
            print(f"{k}: " + ", ".join(f"{name} {value:.3f}" for name, value in worst.items()), flush=True)
    out: dict[str, Any] = {"rigs": count, "refused": refused, "cameras left": left}
    for name in ("position", "height", "yaw", "clock"):
        values = np.concatenate([each[name] for each in every])
        out |= {f"{name}, median": float(np.median(values)), f"{name}, 95 %": float(np.percentile(values, 95))}
    nees = np.concatenate([each["nees"] for each in every])
    for name, column in zip(("position", "height", "clock", "yaw"), nees.T, strict=True):
        finite = column[np.isfinite(column)]
        if not len(finite):
            continue
        out |= {f"NEES of {name}, mean": float(finite.mean()), f"NEES of {name}, median": float(np.median(finite))}
    return out


def run(repeats: int = 5) -> dict[str, Any]:
    """Median error of positions; `repeats` rooms."""
    _rigs.SECONDS = 30.0
    rooms = ((k, room(k, 4, poses=True)) for k in range(91_000, 91_000 + repeats))
    found = measured(rooms, CalibrateConfig(), show=False)
    return {"ratio": found["position, median"], "limit": LIMIT, "parts": found}


def main() -> None:
    """Calibrate, and print the errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=91_000)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--without-poses", action="store_true")
    parser.add_argument("--arrays", action="store_true")
    parser.add_argument("--sizes-alone", action="store_true")
    given = parser.parse_args()
    _rigs.SECONDS = given.seconds
    seeds, poses = range(given.seed, given.seed + given.rigs), not given.without_poses
    if given.arrays or given.sizes_alone:
        (arrays_measured if given.arrays else sizes_measured)(seeds, given.cameras)
        return
    rooms = ((k, room(k, given.cameras, poses=poses)) for k in seeds)
    found = measured(rooms, CalibrateConfig(), show=True)
    print("\n".join(f"{name}: {value:.4g}" for name, value in found.items()))


if __name__ == "__main__":
    main()
