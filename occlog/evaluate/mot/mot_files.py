"""Truth and tracks of each view as boxes with the numbers of their frames, for files of other programs."""

from __future__ import annotations

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.metrics.frame_pairs import Objects
from occlog.records.tables import Boxes, TruthBoxes

from .figures import of_view
from .truth_and_tracks import TruthAndTracks


def view_boxes(compared: TruthAndTracks, view: int) -> tuple[TruthBoxes, Boxes]:
    """True boxes and tracks of one view, in the frames that are compared."""
    t_ns, number, name = compared.t_ns[view], compared.number[view], compared.views[view]
    return (
        TruthBoxes.of(**_columns(of_view(compared.truth, view), t_ns, number, name)),
        Boxes.of(**_columns(of_view(compared.tracks, view), t_ns, number, name)),
    )


def _columns(side: Objects, t_ns: Ints, number: Ints, name: str) -> dict[str, object]:
    order = np.lexsort((side.label, side.frame))
    frame, place, n = side.frame[order], side.place[order], len(order)
    return {
        "t_ns": t_ns[frame],
        "sensor": np.full(n, name),
        "frame": number[frame],
        "box": np.arange(n, dtype=np.int32),
        "target_id": side.label[order].astype(np.int32),
        "left_px": place[:, 0],
        "top_px": place[:, 1],
        "width_px": place[:, 2],
        "height_px": place[:, 3],
        "confidence": np.full(n, np.nan),
    }


def frame_rate(compared: TruthAndTracks, view: int) -> float:
    """Frames a second of a view, from the median of its intervals; 1 where it has a single frame."""
    steps = np.diff(compared.t_ns[view]) / np.maximum(np.diff(compared.number[view]), 1)
    return float(NS / np.median(steps)) if len(steps) and np.median(steps) > 0 else 1.0


def image_size(compared: TruthAndTracks, view: int) -> tuple[int, int]:
    """Width and height that hold the true boxes of a view; at least 1 x 1."""
    place: Floats = of_view(compared.truth, view).place
    if not len(place):
        return 1, 1
    far = np.ceil(np.max(place[:, :2] + place[:, 2:], axis=0))
    return max(int(far[0]), 1), max(int(far[1]), 1)
