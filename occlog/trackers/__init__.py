"""Tracking methods, one module each, built from the kernels of `occlog.core`; TRACKERS names them."""

from __future__ import annotations

from ..errors import UsageError
from . import apf
from .apf_config import ApfConfig, apf_defaults
from .method import Online

TRACKERS: dict[str, Online] = {
    "apf": Online(
        summary="auxiliary particle filter with random waypoints (Ercan, El Gamal, Guibas 2013)",
        config=ApfConfig,
        defaults=apf_defaults,
        init=apf.init,
        step=apf.step,
        predict=apf.predict,
    ),
}
"""Every method by the name that `--method` takes."""


def tracker(name: str) -> Online:
    """The method of that name; UsageError names the ones there are."""
    if name not in TRACKERS:
        raise UsageError(f"no tracking method {name!r}; there are: {', '.join(TRACKERS)}")
    return TRACKERS[name]
