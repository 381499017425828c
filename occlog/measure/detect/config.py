"""Options of detection, who is looked for, and what detection returns."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, UsageError
from occlog.records.tables import APPEARANCE_BINS

METHODS = ("em", "components")
BACKGROUNDS = ("mog2", "knn")


@dataclass(frozen=True, eq=False)
class Target:
    """Somebody to look for, known by appearance."""

    target_id: int
    appearances: Floats  # (n, 72) histograms of one person, in several views or lights

    def __post_init__(self) -> None:
        a = self.appearances
        ok = a.ndim == 2 and a.shape[1:] == (APPEARANCE_BINS,) and len(a) > 0 and np.isfinite(a).all()
        if not (ok and (a >= 0).all() and np.allclose(a.sum(axis=1), 1.0, atol=1e-3)):
            raise InputError(
                f"target {self.target_id}: an appearance must be {APPEARANCE_BINS} numbers of at least 0 "
                f"that sum to 1; got an array of shape {a.shape}"
            )


@dataclass(frozen=True)
class DetectConfig:
    """Options of detection; lengths in the scene's unit unless their name says px."""

    method: str = "em"  # foreground to regions: `em` or `components`
    background: str = "mog2"  # background model: `mog2` or `knn`
    history: int = 500  # frames that the background model remembers; who stands for a tenth of it vanishes
    threshold: float | None = None  # of foreground, see `make_subtractor`; None: the model's default
    shadows: bool = True  # tell shadows from foreground
    clean_px: int = 5  # side of the median filter on the foreground; 0: none
    warmup: int = 50  # frames without result at the start of a camera without an image of the empty scene
    max_foreground: float = 0.6  # share of the image above which a frame cannot be used
    bits: int | None = None  # significant bits of 16-bit images
    shrink: int | None = None  # images are shrunk by this factor; None: as far as people stay wide enough
    person_height: float | None = None  # None: PERSON_HEIGHT of the scene's unit
    person_height_px: float | None = None  # the same everywhere in every image, instead of the camera's pose
    strength: float = 2.0  # of the prior on a cluster's shape, in persons' pixels
    penalty: float = 0.1  # cost of one more cluster, in persons' pixels
    least: float = 0.2  # smallest cluster, in pixels of a person in full view
    most: float = 5.0  # largest cluster that can be a target, in the same
    targets: tuple[Target, ...] = field(default=())
    lone_target_id: int = 0  # id of the one target when no appearance is known
    likeness: float = 0.65  # least likeness (Bhattacharyya coefficient) to a target
    margin: float = 0.05  # likeness that closeness to where the target was last seen is worth
    memory_s: float = 1.0  # how long that counts
    min_confidence: float = 0.3  # of a detector's box
    batch: int = 32  # frames read ahead at a time, of all cameras together

    def __post_init__(self) -> None:
        _check_choices(self)
        _check_numbers(self)
        ids = [t.target_id for t in self.targets]
        if len(set(ids)) < len(ids):
            raise UsageError(f"detect: target ids {ids} repeat; give each target its own")


def _check_choices(c: DetectConfig) -> None:
    for name, valid in (("method", METHODS), ("background", BACKGROUNDS)):
        if getattr(c, name) not in valid:
            raise UsageError(f"detect: {name} {getattr(c, name)!r} is not one of: {', '.join(valid)}")
    if c.clean_px not in (0, 1, 3, 5):
        raise UsageError(f"detect: clean_px {c.clean_px} is not one of: 0, 3, 5")
    if c.shrink is not None and not 1 <= c.shrink <= 16:
        raise UsageError(f"detect: shrink {c.shrink} must be from 1 to 16")
    if c.bits is not None and not 8 <= c.bits <= 16:
        raise UsageError(f"detect: bits {c.bits} must be from 8 to 16")


def _check_numbers(c: DetectConfig) -> None:
    for name in ("history", "batch"):
        if getattr(c, name) < 1:
            raise UsageError(f"detect: {name} {getattr(c, name)} must be at least 1")
    for name in ("strength", "person_height", "person_height_px", "threshold", "least", "most"):
        value = getattr(c, name)
        if value is not None and not (math.isfinite(value) and value > 0):
            raise UsageError(f"detect: {name} {value} must be above 0")
    for name in ("warmup", "penalty", "memory_s", "margin"):
        if not (math.isfinite(getattr(c, name)) and getattr(c, name) >= 0):
            raise UsageError(f"detect: {name} {getattr(c, name)} must be at least 0")
    for name in ("max_foreground", "likeness", "min_confidence"):
        if not 0 <= getattr(c, name) <= 1:
            raise UsageError(f"detect: {name} {getattr(c, name)} must be from 0 to 1")
