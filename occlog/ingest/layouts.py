"""Folders of data sets as they ship: which of their parts are what.

WILDTRACK has `calibrations`, `annotations_positions` and `Image_subsets/C1` to `C7`; the numbers of its frames (0, 5,
10, ...) count tenths of a second.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from occlog.errors import UsageError

CALIBRATIONS, ANNOTATIONS, IMAGES = "calibrations", "annotations_positions", "Image_subsets"
RATE = "10"
"""Numbers of frames in a second: one in five is there, 2 a second."""


def laid_out(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of the options, with a folder of WILDTRACK taken apart into the options that say the same.

    What is given beside the folder counts before its parts; with boxes its images are left out.

    Raises:
        UsageError: the folder has no images, and there are no boxes.
    """
    found = [path for path in values["bags"] if is_wildtrack(path)]
    if not found:
        return dict(values)
    if len(found) > 1:
        raise UsageError(f"{found[1]}: a second data set; make a recording of each")
    folder, out = found[0], dict(values)
    out["bags"] = tuple(path for path in values["bags"] if path != folder)
    if not values["calibration"] and not values["scene"]:
        out["calibration"] = (folder / CALIBRATIONS,)
    if not values["truth"] and (folder / ANNOTATIONS).is_dir():
        out["truth"] = (str(folder / ANNOTATIONS),)
    if not (values["boxes"] or values["images"] or values["video"] or values["mot"]):
        views = sorted(p for p in (folder / IMAGES).glob("C*") if p.is_dir()) if (folder / IMAGES).is_dir() else []
        if not views:
            raise UsageError(
                f"{folder}: has no images ({IMAGES}/C1, ...); give the boxes of a detector, or the annotated ones "
                f"({folder / ANNOTATIONS})"
            )
        out["images"] = tuple(f"{view.name}={view}" for view in views)
    if not values["fps"] and not values["timestamps"]:
        out["fps"] = (RATE,)
    if values.get("first_number") is None:
        out["first_number"] = 0
    return out


def is_wildtrack(path: Path) -> bool:
    """Whether a folder is laid out as WILDTRACK's is."""
    return (path / CALIBRATIONS).is_dir() and any((path / part).is_dir() for part in (ANNOTATIONS, IMAGES))
