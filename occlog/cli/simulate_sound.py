"""Options of `occlog simulate` about what microphone arrays hear."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..errors import UsageError
from ..scene import Scene
from ..stages.simulate import SoundConfig

ARRAYS_ONLY = ("silence", "false_doa", "label_doa")


def sound_config(scene: Scene, given: Mapping[str, Any], step_s: float, heights: bool) -> SoundConfig:
    """Configuration from the options that were given; UsageError where they do not fit.

    Args:
        scene: must have arrays if any of the options is given.
        given: their values.
        step_s: time between two steps [s].
        heights: whether targets have known heights.
    """
    for name in ARRAYS_ONLY:
        if name in given and not scene.arrays:
            raise UsageError(f"--{name.replace('_', '-')} is about microphone arrays, but the scene has none")
    silence = _means(given["silence"]) if "silence" in given else None
    label = bool(given.get("label_doa"))
    return SoundConfig(silence, float(given.get("false_doa", 0.0)), label, step_s, heights)


def _means(text: str) -> tuple[float, float]:
    try:
        sounding, silent = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--silence: want SOUND_S,SILENT_S, two numbers of seconds, got {text!r}") from None
    if not all(math.isfinite(mean) and mean > 0 for mean in (sounding, silent)):
        raise UsageError(f"--silence: both mean times must be above 0 s, got {text!r}")
    return sounding, silent
