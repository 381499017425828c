"""Tracking methods by their names; each is a `METHOD` of its own module."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from occlog.errors import UsageError
from occlog.track.apf.config import apf_defaults
from occlog.track.fix.config import fix_defaults
from occlog.track.imm.config import imm_defaults
from occlog.track.in_space.config import direct3d_defaults, pps_defaults
from occlog.track.map.config import map_defaults

from .apf import filter as apf
from .fix import method as fix
from .imm import filter as imm
from .in_space import direct3d, projected_planes
from .interface import AnyMethod
from .map import method as batch_map


class Entry(NamedTuple):
    """A line of the catalogue."""

    summary: str
    method: AnyMethod
    defaults: Callable[[str], Any]  # settings that suit a scene's length unit


METHODS: dict[str, Entry] = {
    "apf": Entry(
        "auxiliary particle filter with random waypoints (Ercan, El Gamal, Guibas 2013)", apf.METHOD, apf_defaults
    ),
    "map": Entry(
        "most probable trajectory from all bearings at once (Rahimi, Dunagan, Darrell 2004)",
        batch_map.METHOD,
        map_defaults,
    ),
    "direct3d": Entry(
        "particle filter in space from azimuths and elevations (Lee 2009)", direct3d.METHOD, direct3d_defaults
    ),
    "pps": Entry(
        "projected planes selection: particle filters in the planes xy, yz and zx (Lee 2009)",
        projected_planes.METHOD,
        pps_defaults,
    ),
    "imm": Entry(
        "several motion models for several targets that microphone arrays hear, unlabelled (Lee 2009)",
        imm.METHOD,
        imm_defaults,
    ),
    "fix": Entry("each moment's position from its bearings alone (Lenth 1981)", fix.METHOD, fix_defaults),
}
"""Every method by its name."""


def entry(name: str) -> Entry:
    """The method's line; UsageError names the ones there are."""
    if name not in METHODS:
        raise UsageError(f"no tracking method {name!r}; there are: {', '.join(METHODS)}")
    return METHODS[name]


def tracker(name: str) -> AnyMethod:
    """The method of that name; UsageError names the ones there are."""
    return entry(name).method
