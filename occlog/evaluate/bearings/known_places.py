"""Noise of each camera's readings, measured where the target's place is known ([Rahimi] Sec. 7), and a scene with it.

"We estimated Sigma_omega by averaging the measurement error at various known locations in the room, at various target
speeds."  The error of a reading holds everything: the image, the detector, and what is wrong with the camera's pose.
So in the scene that is written the errors of poses are 0, and `read_px` is the standard deviation of [Rahimi] Eq. 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.metrics.errors import ratio
from occlog.core.metrics.sums import Sum
from occlog.errors import InputError
from occlog.evaluate.matching.looks import SensorLooks
from occlog.io.files.put_aside.spool import IN_MEMORY, Spool
from occlog.records.scene import Scene

from .noise import noise_scale, noise_scale_of_many

FEWEST_READINGS = 60
"""From fewer readings no noise is measured."""
STRETCHES = 10
"""Stretches of time that are left out in turn for the error bar: errors of neighbouring frames are alike."""
BIASED = 3.0
"""A mean error of so many of its errors, and of half a standard deviation, is said: the pose is off."""


class MeasuredNoise(NamedTuple):
    """Errors of one camera's readings at known places [px]."""

    sigma: float  # standard deviation about the truth
    error: float  # standard error of it
    bias: float  # mean
    bias_error: float
    readings: int


def measured_noise(residual_px: Floats) -> MeasuredNoise | None:
    """The noise of readings in the order of time, without false ones; None for fewer than `FEWEST_READINGS`.

    False readings are told as in `occlog.evaluate.bearings.noise`.  Error bars are those of a jackknife over
    `STRETCHES` of time.
    """
    n = len(residual_px)
    if n < FEWEST_READINGS:
        return None
    sigma = _sigma(residual_px)
    true = np.abs(residual_px) <= 4.0 * sigma
    parts = np.array_split(np.arange(n), STRETCHES)
    rest = [np.delete(residual_px, part) for part in parts]
    sigmas = np.array([_sigma(one, sigma) for one in rest])
    biases = np.array([one[np.abs(one) <= 4.0 * sigma].mean() for one in rest])
    return MeasuredNoise(sigma, _jackknife(sigmas), float(residual_px[true].mean()), _jackknife(biases), n)


def _measured_noise_of_many(residual_px: Spool) -> MeasuredNoise:
    """`measured_noise` of numbers in a file."""
    n = residual_px.count
    # As `np.array_split` cuts them
    cuts = [n // STRETCHES * k + min(n % STRETCHES, k) for k in range(STRETCHES + 1)]
    spans = [(0, 0), *pairwise(cuts)]

    def without(first: int, stop: int) -> Iterator[Floats]:
        at = 0
        for block in residual_px.blocks():
            low, high = (min(max(cut - at, 0), len(block)) for cut in (first, stop))
            yield np.delete(block, slice(low, high))
            at += len(block)

    def scale(first: int, stop: int, near: float | None = None) -> float:
        def squares() -> Iterator[tuple[Floats, Floats]]:
            return ((one**2, np.ones(len(one))) for one in without(first, stop))

        return noise_scale_of_many(squares, n - (stop - first), near)

    whole = scale(*spans[0])
    sigmas = [whole, *(scale(*span, whole) for span in spans[1:])]

    def bias(first: int, stop: int) -> float:
        total, count = Sum(), 0
        for one in without(first, stop):
            true = one[np.abs(one) <= 4.0 * sigmas[0]]
            total.add(float(true.sum()))
            count += len(true)
        return ratio(total.value, count)

    biases = [bias(*span) for span in spans]
    errors = (_jackknife(np.array(each[1:])) for each in (sigmas, biases))
    return MeasuredNoise(sigmas[0], next(errors), biases[0], next(errors), n)


def _sigma(residual_px: Floats, near: float | None = None) -> float:
    return noise_scale(residual_px**2, np.ones(len(residual_px), dtype=np.int64), near)


def _jackknife(without: Floats) -> float:
    """Standard error from values without one part each."""
    B = len(without)
    return math.sqrt((B - 1) / B * float(((without - without.mean()) ** 2).sum()))


class KnownPlaces:
    """Gathers readings of targets in plain view, while looks stream by."""

    def __init__(self, scene: Scene, in_memory: int = IN_MEMORY) -> None:
        """No reading yet.

        Args:
            scene: the cameras.
            in_memory: how many errors of all cameras are kept in memory; more go to files without names.
        """
        share = in_memory // max(len(scene.cameras), 1)
        self._residuals = {camera.name: Spool(share) for camera in scene.cameras}

    def update(self, looks: Mapping[str, SensorLooks]) -> None:
        """Looks of some more frames, by sensor."""
        for name in looks.keys() & self._residuals.keys():
            own = looks[name].looks
            use = own.truth & own.visible & own.reported & np.isfinite(own.residual_px)
            # Labelled looks and those of candidates come one after the other, each in the order of time
            order = np.argsort(own.t_ns[use], kind="stable")
            self._residuals[name].add(own.residual_px[use][order])

    def noise(self) -> dict[str, MeasuredNoise]:
        """The noise of every camera with enough readings.

        Raises:
            InputError: none has them.
        """
        out = {}
        for name, residuals in self._residuals.items():
            whole = residuals.whole
            found = _measured_noise_of_many(residuals) if whole is None else measured_noise(whole)
            if found is not None and found.sigma > 0.0:
                out[name] = found
        if not out:
            raise InputError(
                f"write-scene: no camera has {FEWEST_READINGS} readings in pixels of a target in plain view whose "
                "place is known; record more, or give the truth at more times"
            )
        return out


def scene_with(scene: Scene, noise: Mapping[str, MeasuredNoise]) -> Scene:
    """The scene with the measured noise, and without errors of poses, of the cameras that have one."""
    cameras = [
        replace(c, sigma_read_px=noise[c.name].sigma, sigma_position=0.0, sigma_yaw=0.0) if c.name in noise else c
        for c in scene.cameras
    ]
    return replace(scene, cameras=tuple(cameras))


def notes_of(scene: Scene, noise: Mapping[str, MeasuredNoise]) -> tuple[str, ...]:
    """What a user must know: cameras that keep the noise that was stated, and cameras whose readings are biased."""
    kept = [c.name for c in scene.cameras if c.name not in noise]
    lines = []
    if kept:
        lines.append(
            f"{', '.join(kept)}: fewer than {FEWEST_READINGS} readings at known places; the noise stays as it is stated"
        )
    for name, m in noise.items():
        if abs(m.bias) > max(BIASED * m.bias_error, 0.5 * m.sigma):
            lines.append(
                f"warning: {name}: readings are {m.bias:+.2g} px off in the mean, of {m.sigma:.2g} px in all; its pose "
                "may be wrong, and no filter averages that out"
            )
    return tuple(lines)


def figures_of(noise: Mapping[str, MeasuredNoise]) -> dict[str, float]:
    """Figures by camera."""
    out: dict[str, float] = {}
    for name, m in noise.items():
        out |= {
            f"noise_at_known_places_sensor_{name}_px": m.sigma,
            f"noise_at_known_places_error_sensor_{name}_px": m.error,
            f"noise_at_known_places_readings_sensor_{name}": m.readings,
        }
    return out


def comment(noise: Mapping[str, MeasuredNoise]) -> str:
    """Lines of a scene file that say where its noise is from."""
    lines = ["# noise measured at known places (occlog evaluate), read_px +- standard error (readings):"]
    lines += [f"#   {name}: {m.sigma:.3g} +- {m.error:.2g} px ({m.readings})" for name, m in noise.items()]
    return "\n".join(lines) + "\n"
