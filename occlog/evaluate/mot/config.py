"""What the evaluation of many targets is asked for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from occlog.array_types import NS
from occlog.core.metrics.clear_mot import CHALLENGE, CLASSIC, ClearRule
from occlog.errors import InputError
from occlog.evaluate.matching.config import METRES

OWN = ("label", "start", "best")
RULES = {"classic": CLASSIC, "challenge": CHALLENGE}


@dataclass(frozen=True)
class ManyConfig:
    """Options of the figures for many targets.

    Which target is a track's own ([Qu] Eq. 9): `label`, the one of its number; `start`, the first one that
    it is on; `best`, by the one-to-one assignment in which most estimates are on their own target.
    """

    tau: float = 1.0  # a tracker is on a target within this many radii of it, sqrt(half width * half height)
    tau_px: float | None = None  # the same in pixels, instead of tau
    own: str = "label"
    clear_rule: str = "classic"
    overlap: float = 0.5  # intersection over union from which a track meets a true box
    match_distance: float | None = None  # on the ground instead of overlap and tau; None: 1 m
    track_gap_s: float | None = None  # on the ground: tracks are interpolated over at most this; None: as the truth
    gospa_cutoff: float | None = None  # None: where a pair no longer meets
    gospa_p: float = 2.0
    gospa_alpha: float = 2.0
    gospa_px: float | None = None  # cutoff of a second GOSPA of the centres in the image; None: none
    cameras: tuple[str, ...] = ()  # only these; none named: all
    frames: tuple[int, int] | None = None  # first frame and the one after the last

    def __post_init__(self) -> None:
        for name in ("tau", "tau_px", "match_distance", "gospa_cutoff", "gospa_px"):
            _check(name, getattr(self, name), lambda x: x > 0, "above 0")
        _check("track_gap_s", self.track_gap_s, lambda x: x >= 0, "at least 0")
        _check("overlap", self.overlap, lambda x: 0 < x <= 1, "above 0 and at most 1")
        _check("gospa_p", self.gospa_p, lambda x: x >= 1, "at least 1")
        _check("gospa_alpha", self.gospa_alpha, lambda x: 0 < x <= 2, "above 0 and at most 2")
        _check("own", self.own, lambda x: x in OWN, " or ".join(OWN))
        _check("clear_rule", self.clear_rule, lambda x: x in RULES, " or ".join(RULES))
        if self.frames is not None and not 0 <= self.frames[0] < self.frames[1]:
            raise InputError(f"evaluate: frames {self.frames[0]}:{self.frames[1]} must be A:B with 0 <= A < B")

    @property
    def rule(self) -> ClearRule:
        """How CLEAR-MOT pairs boxes."""
        return RULES[self.clear_rule]._replace(threshold=self.overlap)

    def gap_ns(self, limit_ns: int) -> int:
        """Widest gap of tracks on the ground that is bridged [ns]; `limit_ns` is that of the truth."""
        return limit_ns if self.track_gap_s is None else round(self.track_gap_s * NS)


def _check(name: str, value: Any, good: Callable[[Any], bool], limit: str) -> None:
    if value is None:
        return
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"evaluate: {name} is {value}, must be a finite number")
    if not good(value):
        raise InputError(f"evaluate: {name} is {value}, must be {limit}")


def default_distance(length_unit: str) -> float | None:
    """1 m in the scene's unit; None where that is not known."""
    return 1.0 / METRES[length_unit] if length_unit in METRES else None
