"""What is added to the times of sensors whose clocks are known to be off."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from occlog.errors import UsageError, did_you_mean, option

if TYPE_CHECKING:
    from occlog.records.scene import Scene

UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "": 1.0}
MOST_S = 1e9
"""Largest offset [s]."""
_OFFSET = re.compile(r"([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*(s|ms|us|)")


def offsets_of(texts: Iterable[str]) -> dict[str, float]:
    """Offsets [s] by sensor, of `SENSOR=SECONDS`, or with a unit: `cam2=-0.4s`, `mic=250ms`.

    Raises:
        UsageError: a text is no such pair, or a sensor is named twice.
    """
    out: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        found = _OFFSET.fullmatch(value.strip())
        seconds = float(found[1]) * UNITS[found[2]] if found else math.inf
        if not name or not abs(seconds) <= MOST_S:
            raise UsageError(
                f"{option('offset')} {text}: want SENSOR=SECONDS, at most {MOST_S:g} s either way, as in cam2=-0.4s"
            )
        if name in out:
            raise UsageError(f"{option('offset')}: sensor {name} is given twice; give every sensor one offset")
        out[name] = seconds
    return out


def with_offsets(scene: Scene, offsets: Mapping[str, float]) -> Scene:
    """The scene with clocks that are off by what is to be added to the times [s]; drifts stay as they are.

    The clocks of the scene stay, also those that an earlier offset has made (`cam2-offset`): the new ones have names of
    their own.

    Raises:
        UsageError: the scene lacks a sensor.
    """
    from occlog.array_types import NS
    from occlog.records.scene import Clock

    names = [s.name for s in scene.sensors]
    for name in offsets:
        if name not in names:
            raise UsageError(f"{option('offset')}: no sensor {name!r}; {did_you_mean(name, names)}")
    clocks = {clock.name: clock for clock in scene.clocks}
    own, taken = {}, set(clocks)
    for sensor in scene.sensors:
        if sensor.name in offsets:
            before = clocks.get(sensor.clock or "", Clock(""))
            offset_ns = before.offset_ns - round(offsets[sensor.name] * NS)
            name = _free_name(f"{sensor.name}-offset", taken)
            taken.add(name)
            own[sensor.name] = replace(before, name=name, offset_ns=offset_ns)
    return replace(
        scene,
        cameras=tuple(replace(c, clock=own[c.name].name) if c.name in own else c for c in scene.cameras),
        arrays=tuple(replace(a, clock=own[a.name].name) if a.name in own else a for a in scene.arrays),
        readers=tuple(replace(r, clock=own[r.name].name) if r.name in own else r for r in scene.readers),
        clocks=(*scene.clocks, *own.values()),
    )


def _free_name(name: str, taken: Collection[str]) -> str:
    """The name, or with the first number from 2 behind it that nobody has."""
    return next(each for each in (name, *(f"{name}-{n}" for n in range(2, len(taken) + 3))) if each not in taken)
