"""Tracking methods, one module each, built from the kernels of `occlog.core`; TRACKERS names them."""

from __future__ import annotations

from occlog.errors import UsageError
from occlog.track.apf.config import ApfConfig, apf_defaults
from occlog.track.fix.config import FixConfig, fix_defaults
from occlog.track.imm.config import ImmConfig, imm_defaults
from occlog.track.in_space.config import Direct3dConfig, PpsConfig, direct3d_defaults, pps_defaults
from occlog.track.map.config import MapConfig, map_defaults

from .apf import filter as apf
from .fix import method as fix
from .imm import filter as imm
from .imm import filter as imm_filter
from .in_space import direct3d, projected_planes
from .interface import Batch, Joint, Online
from .map import method as batch_map

TRACKERS: dict[str, Online | Batch | Joint] = {
    "apf": Online(
        summary="auxiliary particle filter with random waypoints (Ercan, El Gamal, Guibas 2013)",
        config=ApfConfig,
        defaults=apf_defaults,
        init=apf.init,
        step=apf.step,
        predict=apf.predict,
    ),
    "map": Batch(
        summary="most probable trajectory from all bearings at once (Rahimi, Dunagan, Darrell 2004)",
        config=MapConfig,
        defaults=map_defaults,
        begin=batch_map.begin,
        advance=batch_map.advance,
    ),
    "direct3d": Online(
        summary="particle filter in space from azimuths and elevations (Lee 2009)",
        config=Direct3dConfig,
        defaults=direct3d_defaults,
        init=direct3d.init,
        step=direct3d.step,
        predict=direct3d.predict,
    ),
    "pps": Online(
        summary="projected planes selection: particle filters in the planes xy, yz and zx (Lee 2009)",
        config=PpsConfig,
        defaults=pps_defaults,
        init=projected_planes.init,
        step=projected_planes.step,
        predict=projected_planes.predict,
    ),
    "imm": Joint(
        summary="several motion models for several targets that microphone arrays hear, unlabelled (Lee 2009)",
        config=ImmConfig,
        defaults=imm_defaults,
        init=imm_filter.init,
        step=imm_filter.step,
        estimates=imm.estimates,
    ),
    "fix": Online(
        summary="each moment's position from its bearings alone (Lenth 1981)",
        config=FixConfig,
        defaults=fix_defaults,
        init=fix.init,
        step=fix.step,
    ),
}
"""Every method by the name that `--method` takes."""


def tracker(name: str) -> Online | Batch | Joint:
    """The method of that name; UsageError names the ones there are."""
    if name not in TRACKERS:
        raise UsageError(f"no tracking method {name!r}; there are: {', '.join(TRACKERS)}")
    return TRACKERS[name]
