"""Microphone arrays of a calibration: directions that are read, and arrays in the scene, the summary and the checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from occlog.array_types import NS
from occlog.consistency.clock_offsets import offset_words
from occlog.core.geometry.camera import wrap_angle
from occlog.io.open import Opened, check_unit, open_input
from occlog.records.scene import Clock, Scene
from occlog.records.tables import Doa
from occlog.records.verdicts import Check, finding, outcome
from occlog.track.people.inputs import ImageInput

from ..config import CalibrateConfig
from ..request import CalibrateRequest
from ..results.output import CLOCK
from .arrays import ArrayPrior, ArrayResult, Directions, Path, place_array

ARRAYS = "microphone arrays"
"""Name of a check."""


def opened_directions(request: CalibrateRequest, inputs: ImageInput) -> Opened | None:
    """Input with directions of arrival: the given file, or else that of the boxes.

    None if no file is given and the input of the boxes has no directions.

    Raises:
        InputError: the given file has no directions.
        UsageError: it is of a scene with another unit of length.
    """
    if request.doa is None:
        return inputs.opened if inputs.opened.has(Doa) else None
    opened = open_input(request.doa, Doa)
    opened.require(Doa)
    if opened.made_in_a_scene:
        check_unit(opened, inputs.scene.length_unit)
    return opened


def place_arrays(
    opened: Opened, scene: Scene, paths: Sequence[Path], config: CalibrateConfig, metre: float
) -> list[ArrayResult]:
    """Estimate the poses of those microphone arrays of a scene that have directions of arrival, by people who speak.

    The results, one for each such array, are in the order of the scene.

    Args:
        opened: input with directions of arrival.
        scene: scene with the arrays as stated.
        paths: paths of the people on the ground, in scene units, by the common clock.
        config: heights of mouths, and limit of clock offsets.
        metre: length of a metre in scene units.
    """
    heard = Doa.concat([Doa.empty(), *opened.rows(Doa)])
    recorded = {a.name: float(a.yaw) for a in (() if opened.scene is None else opened.scene.arrays)}
    out = []
    for array in scene.arrays:
        own = heard.take(np.flatnonzero(heard.sensor == array.name))
        upward = array.sigma if array.sigma_elevation is None else array.sigma_elevation
        directions = Directions(
            own.t_ns / NS, own.azimuth, own.elevation,
            np.where(np.isnan(own.sigma_azimuth), array.sigma, own.sigma_azimuth),
            np.where(np.isnan(own.sigma_elevation), upward, own.sigma_elevation),
        )  # fmt: skip
        prior = ArrayPrior(
            recorded.get(array.name, array.yaw), config.max_clock_offset, config.source_height * metre,
            config.sigma_source_height * metre, metre,
        )  # fmt: skip
        if len(own):
            out.append(place_array(array, directions, paths, prior))
    return out


def with_arrays(scene: Scene, stated: Scene, arrays: Sequence[ArrayResult]) -> Scene:
    """Return the scene with the microphone arrays at their estimated poses, and with clocks of those that are late.

    Args:
        scene: scene with calibrated cameras, and with the arrays that keep their stated poses.
        stated: scene as read, with all arrays; those that were neither estimated nor are in `scene` are omitted.
        arrays: results of the estimation.
    """
    clocks = {clock.name: clock for clock in scene.clocks}
    found = {}
    for each in arrays:
        array = each.array
        if each.is_late:
            before = clocks[array.clock] if array.clock is not None else Clock("")
            name = CLOCK.format(array.name)
            clocks[name] = replace(before, name=name, offset_ns=before.offset_ns + round(each.late_s * NS))
            array = replace(array, clock=name)
        if not each.reason:
            found[array.name] = array
    kept = {a.name for a in scene.arrays}
    own = [found.get(a.name, a) for a in stated.arrays if a.name in kept or a.name in found]
    return replace(scene, arrays=tuple(own), clocks=tuple(clocks.values()))


def array_figures(each: ArrayResult) -> dict[str, object]:
    """Figures of one microphone array for the summary, by name: pose, clock and directions; rounded.

    An array without an estimate has only the number of directions and the share of people's.
    """
    if each.reason:
        return {"estimated": False, "directions": each.directions, "of_people": round(each.share, 2)}
    return {
        "position": [round(float(v), 3) for v in each.array.position],
        "sigma_position": [round(float(v), 3) if np.isfinite(v) else None for v in each.sigma[:3]],
        "yaw_deg": round(float(np.degrees(each.array.yaw)), 2),
        "sigma_yaw_deg": round(float(np.degrees(each.sigma[3])), 2),
        "clock_offset_s": round(each.late_s, 3),
        "sigma_clock_s": round(float(each.sigma[4]), 3),
        "directions": each.directions,
        "of_people": round(each.share, 2),
        "noise_factor": round(each.scale, 2),
    }


def array_checks(arrays: Sequence[ArrayResult], scene: Scene, *, placed: bool) -> tuple[Check, ...]:
    """Checks of the microphone arrays: a finding on each that is not calibrated, or with a clock that is late.

    Args:
        arrays: results of the estimation.
        scene: has the arrays as stated.
        placed: the stated poses are in the world frame of the result; then a finding on each calibrated array states
            how far its pose is from that.
    """
    stated = {a.name: a for a in scene.arrays}
    out = []
    for each in arrays:
        name, before = [each.array.name], stated[each.array.name]
        if each.reason:
            out.append(finding(ARRAYS, "array-not-calibrated", sensors=name, reason=each.reason))
            continue
        if placed:
            away = float(np.linalg.norm(each.array.position - before.position))
            turned = float(np.degrees(wrap_angle(np.array(each.array.yaw - before.yaw))))
            out.append(finding(ARRAYS, "array-placed", sensors=name, distance=away, yaw_deg=turned))
        if each.is_late:
            late, sigma = each.late_s, float(each.sigma[4])
            words = offset_words(late)
            out.append(finding(ARRAYS, "clock-offset-found", sensors=name, late_s=late, sigma_s=sigma, **words))
    return outcome(ARRAYS, out, unless="" if arrays else "no directions of arrival")


def array_comment(arrays: Sequence[ArrayResult], unit: str) -> str:
    """Comment lines, for a scene file, with the standard deviations of arrays; lengths are in `unit`."""
    lines = []
    for each in arrays:
        if not each.reason:
            x, y, z, yaw, late = each.sigma.tolist()
            high = f", {z:.3f}" if np.isfinite(z) else ""
            lines.append(
                f"# {each.array.name}: position {x:.3f}, {y:.3f}{high} {unit}, yaw {np.degrees(yaw):.3f} deg, "
                f"clock {late:.4f} s\n"
            )
    return "".join(lines)
