"""Faults that set-ups have: each changes a sound rig, and states what must be said of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.setups._judge import Answer
from benchmarks.setups._rigs import Rig, of_lens, other_camera
from occlog.array_types import Floats
from occlog.records.scene import Camera

Random = np.random.Generator


class Fault(NamedTuple):
    """A kind of fault.

    Attributes:
        make: changes a rig, and gives what must be said of it.
        count: set-ups of a hundred that have it.
        cameras: least number of cameras.
        of_camera: it is a fault of one or two cameras, so that rigs have it, too.
    """

    make: Callable[[Rig, Random], Answer]
    count: int
    cameras: int = 2
    of_camera: bool = False


def _boxes_scaled(rig: Rig, rng: Random) -> Answer:
    factor = float(rng.choice([0.5, 2.0 / 3.0, 0.75, 1.5]))
    for rows in rig.boxes.values():
        rows[:, 1:] *= factor
    return Answer("scaled|end at .* px|end beyond its images|image.size|another size")


def _boxes_of_one_scaled(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    rig.boxes[name][:, 1:] *= float(rng.choice([0.5, 2.0 / 3.0, 1.5]))
    return Answer("scaled|end at .* px|end beyond its images|image.size|another size", (name,))


def _truth_late(rig: Rig, rng: Random) -> Answer:
    rig.truth[:, 0] += round(float(rng.choice([-1.0, 1.0])) * rng.uniform(0.3, 2.0) * rig.fps)
    rig.truth = rig.truth[rig.truth[:, 0] >= 0]
    return Answer("tracks-delayed|times-shifted")


def _boxes_exchanged(rig: Rig, rng: Random) -> Answer:
    first = other_camera(rig, rng)
    second = other_camera(rig, rng, (first,))
    rig.boxes[first], rig.boxes[second] = rig.boxes[second], rig.boxes[first]
    return Answer("boxes of camera|exchanged", (first, second))


def _flipped(axes: tuple[bool, bool], words: str) -> Callable[[Rig, Random], Answer]:
    def make(rig: Rig, rng: Random) -> Answer:
        name = other_camera(rig, rng)
        rows, size = rig.boxes[name].copy(), rig.cameras[name].image_size or (0, 0)
        for axis in (0, 1):
            if axes[axis]:
                rig.boxes[name][:, [1 + axis, 3 + axis]] = size[axis] - 1.0 - rows[:, [3 + axis, 1 + axis]]
        return Answer(words, (name,))

    return make


def _one_inverted(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    own = rig.calibration[name]
    rig.calibration[name] = replace(own, rotation=own.rotation.T, position=-own.rotation.T @ own.position)
    return Answer("inverted|camera-to-world", (name,))


def _all_inverted(rig: Rig, _: Random) -> Answer:
    rig.world_to_camera = False
    return Answer("inverted|camera-to-world|world-to-camera")


def _millimetres(rig: Rig, _: Random) -> Answer:
    for name, own in rig.calibration.items():
        rig.calibration[name] = replace(own, position=own.position * 1000.0)
    rig.truth[:, 2:] *= 1000.0
    return Answer(r"\bmm\b|unit|too tall|people are")


def _rotation_in_degrees(rig: Rig, _: Random) -> Answer:
    rig.rotation_vectors = np.degrees
    return Answer("degree|radian")


def _lens_of_one_missing(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    _barrel(rig, [name], rng)
    return Answer("lens|distortion", (name,))


def _lens_of_all_missing(rig: Rig, rng: Random) -> Answer:
    _barrel(rig, rig.names, rng)
    return Answer("lens|distortion")


def _barrel(rig: Rig, names: list[str], rng: Random) -> None:
    """Cameras with a barrel distortion that the calibration lacks."""
    k1 = rng.uniform(-0.24, -0.14)
    for name in names:
        lens = np.array([k1, -0.4 * k1, 0.0, 0.0, 0.0])
        rig.cameras[name] = of_lens(rig.cameras[name], lens, "brown")
        rig.calibration[name] = of_lens(rig.calibration[name], np.zeros(5), "brown")
        rig.boxes[name] = rig.shoot(name)


def _wrong_lens_model(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    lens = np.array([rng.uniform(-0.06, 0.02), rng.uniform(-0.01, 0.01), 0.0, 0.0, 0.0])
    rig.cameras[name] = of_lens(rig.cameras[name], lens, "equidistant")
    rig.calibration[name] = of_lens(rig.calibration[name], lens, "brown")
    rig.boxes[name] = rig.shoot(name)
    return Answer("lens|distortion|fisheye", (name,))


def _time_in_milliseconds(rig: Rig, _: Random) -> Answer:
    rig.time_factor = 1000.0
    rig.options = {}
    rig.truth = rig.truth[:0]
    return Answer(r"t_ms|milliseconds|\bms\b|unit|rate-implausible")


def _rate_tenfold(rig: Rig, rng: Random) -> Answer:
    rig.options["fps"] = 10.0 * rig.fps
    if rng.random() < 0.5:
        rig.truth = rig.truth[:0]
    return Answer("speeds-high|rate|fps")


def _rate_tenth(rig: Rig, _: Random) -> Answer:
    rig.options["fps"] = 0.1 * rig.fps
    rig.truth = rig.truth[:0]
    return Answer("speeds-low|rate|fps")


def _third_renumbered(rig: Rig, _: Random) -> Answer:
    for name, rows in rig.boxes.items():
        third = rows[rows[:, 0] % 3 == 0]
        third[:, 0] //= 3
        rig.boxes[name] = third
    return Answer("rate|fps|every frame in 3|frame numbers|speeds-high")


def _late(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    rig.boxes[name] = rig.shoot(name, late_s=float(rng.choice([-1.0, 1.0])) * rng.uniform(0.1, 0.5))
    return Answer("camera-late|clock", _either(rig, name))


def _frames_shifted(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    rig.boxes[name][:, 0] += int(rng.integers(3, 20))
    return Answer("camera-late|clock", _either(rig, name))


def _either(rig: Rig, name: str) -> tuple[str, ...]:
    """Cameras that may be named: with two, one late and the other one early are the same."""
    return tuple(rig.names) if len(rig.names) == 2 else (name,)


def _frozen(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    rows, length = rig.boxes[name], int(rng.uniform(4.0, 9.0) * rig.fps)
    present = np.unique(rows[:, 0])
    begin = rng.choice(present[(present > 2.0 * rig.fps) & (present < rig.frames - length - 2.0 * rig.fps)])
    still = rows[rows[:, 0] == begin]
    others = rows[(rows[:, 0] < begin) | (rows[:, 0] >= begin + length)]
    repeated = [np.column_stack([np.full(len(still), begin + k), still[:, 1:]]) for k in range(length)]
    whole = np.concatenate([others, *repeated])
    rig.boxes[name] = whole[np.argsort(whole[:, 0], kind="stable")]
    return Answer("frozen|repeat", (name,))


def _bumped(rig: Rig, rng: Random) -> Answer:
    """A camera is turned by 2 to 5 degrees: since its calibration, or in the middle."""
    name = other_camera(rig, rng)
    turned = _turned(rig, name, rng)
    if rng.random() < 0.5:
        rig.boxes[name] = rig.shoot(name, turned)
    else:
        at = round(rng.uniform(0.3, 0.6) * rig.frames)
        before = rig.boxes[name][rig.boxes[name][:, 0] < at]
        rig.boxes[name] = np.concatenate([before, rig.shoot(name, turned, start=at)])
    return Answer("rotated|orientation|moved", _either(rig, name))


def _turned(rig: Rig, name: str, rng: Random) -> Camera:
    direction = rng.normal(size=3)
    angle = np.radians(rng.uniform(2.0, 5.0))
    own = rig.cameras[name]
    # About the vertical and the horizontal axis: a roll alone does not come of a push
    axis = own.rotation @ (np.array([1.0, 1.0, 0.2]) * direction)
    return replace(own, rotation=cv2.Rodrigues(angle * axis / np.linalg.norm(axis))[0] @ own.rotation)


def _exchanged_for_a_while(rig: Rig, rng: Random) -> Answer:
    first = other_camera(rig, rng)
    second = other_camera(rig, rng, (first,))
    begin = rng.uniform(4.0, 11.0) * rig.fps
    end = begin + 5.0 * rig.fps
    for mine, other in ((first, second), (second, first)):
        rig.boxes[f"{mine} "] = _spliced(rig.boxes[mine], rig.boxes[other], begin, end)
    for name in (first, second):
        rig.boxes[name] = rig.boxes.pop(f"{name} ")
    return Answer("exchanged|boxes of camera", (first, second))


def _spliced(rows: Floats, other: Floats, begin: float, end: float) -> Floats:
    own, its = (((each[:, 0] >= begin) & (each[:, 0] < end)) for each in (rows, other))
    whole = np.concatenate([rows[~own], other[its]])
    return np.asarray(whole[np.argsort(whole[:, 0], kind="stable")])


def _truncated(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    rows = rig.boxes[name]
    rig.boxes[name] = rows[rows[:, 0] < rng.uniform(0.3, 0.75) * rig.frames]
    return Answer("no box|boxes-end|truncated", (name,))


def _truth_in_other_unit(rig: Rig, rng: Random) -> Answer:
    rig.truth[:, 2:] *= float(rng.choice([1000.0, 100.0, 1.0 / 0.3048]))
    return Answer("length-unit-differs|unit")


def _truth_in_other_axes(rig: Rig, rng: Random) -> Answer:
    kind = int(rng.integers(4))
    x, y = rig.truth[:, 2].copy(), rig.truth[:, 3].copy()
    angle, middle = rng.uniform(0.5, 5.5), 0.5 * np.array(rig.size)
    turned = (np.column_stack([x, y]) - middle) @ np.array(
        [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    )
    rig.truth[:, 2:] = (
        np.column_stack([y, x]),
        np.column_stack([x, -y]),
        turned,
        np.column_stack([x, y]) + rng.uniform(3.0, 8.0, 2),
    )[kind]
    return Answer("axes-differ")


def _corners_for_sizes(rig: Rig, rng: Random) -> Answer:
    name = other_camera(rig, rng)
    rows = rig.boxes[name]
    rows[:, 3:] += rows[:, 1:3]
    return Answer("corner|xyxy|right and lower", (name,))


FAULTS: dict[str, Fault] = {
    "boxes of images of another size": Fault(_boxes_scaled, 5, 2),
    "boxes of one camera of images of another size": Fault(_boxes_of_one_scaled, 3, 2, of_camera=True),
    "truth with other frame numbers": Fault(_truth_late, 6, 2),
    "files of two cameras exchanged": Fault(_boxes_exchanged, 5, 3, of_camera=True),
    "images mirrored": Fault(_flipped((True, False), "mirrored"), 4, 2, of_camera=True),
    "images turned by 180 degrees": Fault(_flipped((True, True), "turned by 180|upside down"), 4, 2, of_camera=True),
    "extrinsics of one camera inverted": Fault(_one_inverted, 4, 2, of_camera=True),
    "extrinsics of all cameras inverted": Fault(_all_inverted, 3, 2),
    "calibration and truth in millimetres": Fault(_millimetres, 2, 2),
    "rotations in degrees": Fault(_rotation_in_degrees, 2, 2),
    "lens of one camera missing": Fault(_lens_of_one_missing, 3, 2, of_camera=True),
    "lenses of all cameras missing": Fault(_lens_of_all_missing, 3, 2),
    "wrong lens model": Fault(_wrong_lens_model, 3, 2, of_camera=True),
    "times in milliseconds": Fault(_time_in_milliseconds, 2, 2),
    "frame rate ten times too high": Fault(_rate_tenfold, 3, 2),
    "frame rate ten times too low": Fault(_rate_tenth, 2, 2),
    "every third frame, numbered consecutively": Fault(_third_renumbered, 3, 2),
    "one camera late": Fault(_late, 6, 2, of_camera=True),
    "frames of one camera numbered from elsewhere": Fault(_frames_shifted, 3, 2, of_camera=True),
    "one camera frozen": Fault(_frozen, 4, 2, of_camera=True),
    "one camera bumped": Fault(_bumped, 6, 2, of_camera=True),
    "two cameras exchanged for 5 s": Fault(_exchanged_for_a_while, 4, 3, of_camera=True),
    "log of one camera truncated": Fault(_truncated, 4, 2, of_camera=True),
    "truth in another unit": Fault(_truth_in_other_unit, 3, 2),
    "truth in other axes": Fault(_truth_in_other_axes, 3, 2),
    "corners for sizes in one camera": Fault(_corners_for_sizes, 2, 2, of_camera=True),
}


def _late_by_any(rig: Rig, rng: Random) -> Answer:
    """A camera is late or early by 40 ms to 30 s, all orders of magnitude alike."""
    name = other_camera(rig, rng)
    late_s = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.04), np.log(30.0))))
    rig.lengthen(2.0 * abs(late_s))
    within = float(np.clip(late_s, -2.5, 2.5))
    rig.boxes[name] = rig.shoot(name, late_s=within)
    # The rest is in the numbers of frames
    rig.boxes[name][:, 0] += round((late_s - within) * rig.fps)
    least = min(rows[:, 0].min() for rows in rig.boxes.values())
    for rows in rig.boxes.values():
        rows[:, 0] -= min(least, 0.0)
    rig.truth = rig.truth[:0]
    return Answer("camera-late|clock|camera-times", _either(rig, name))


def _yawed(rig: Rig, rng: Random) -> Answer:
    """A camera is turned about the vertical by 0.5 to 10 degrees since its calibration."""
    name = other_camera(rig, rng)
    own = rig.cameras[name]
    angle = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.5), np.log(10.0)))
    turned = replace(own, rotation=cv2.Rodrigues(np.radians([0.0, 0.0, angle]))[0] @ own.rotation)
    rig.boxes[name] = rig.shoot(name, turned)
    return Answer("rotated|orientation|moved", _either(rig, name))


def _raised(rig: Rig, rng: Random) -> Answer:
    """The height of a camera is stated wrong by 0.2 to 0.6 m."""
    name = other_camera(rig, rng)
    own = rig.calibration[name]
    shift = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.6)
    rig.calibration[name] = replace(own, position=own.position + np.array([0.0, 0.0, shift]))
    return Answer("stated height", (name,))


def _focal_length_off(rig: Rig, rng: Random) -> Answer:
    """The focal length of a camera is stated wrong by 5 %."""
    name = other_camera(rig, rng)
    own = rig.calibration[name]
    rig.calibration[name] = replace(own, focal_px=own.focal_px * (1.0 + 0.05 * rng.choice([-1.0, 1.0])))
    return Answer("focal length", (name,))


CALIBRATIONS: dict[str, Fault] = {
    "one camera late by 40 ms to 30 s": Fault(_late_by_any, 9),
    "one camera turned by 0.5 to 10 degrees": Fault(_yawed, 9),
    "height of one camera": Fault(_raised, 5),
    "focal length of one camera": Fault(_focal_length_off, 5),
    "two cameras exchanged": Fault(_boxes_exchanged, 4, 3),
    "calibration in another unit": Fault(_millimetres, 4),
    "mirrored image": Fault(_flipped((True, False), "mirrored"), 4),
}
"""Faults of the poses, lenses and clocks of cameras in which people walk: 40."""
