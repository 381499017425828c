"""Figures of merit of tracks in images, the same for every tracker: boxes in, numbers out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.metrics.mot import clear_mot, hota
from occlog.core.metrics.mot import hota as idf1
from occlog.core.metrics.mot.failure_rates import failures
from occlog.core.metrics.mot.frame_pairs import Objects, of_boxes
from occlog.evaluate.mot.stage import assigned_targets

FIGURES = ("fr_p", "fr_l", "fr_l joint", "idf1", "hota", "mota", "recall", "precision", "switches")


class LabelledBoxes(NamedTuple):
    """Labelled boxes of all views, one row each."""

    view: Ints
    frame: Ints
    label: Ints
    box: Floats  # (n, 4) left, top, width, height

    def objects(self) -> Objects:
        """The same for the figures of `occlog.core.metrics`."""
        return Objects(self.frame, self.label, self.box, self.view)

    def centres(self) -> Objects:
        """Their centres."""
        return Objects(self.frame, self.label, self.box[:, :2] + 0.5 * self.box[:, 2:], self.view)


def around(ellipses: Floats) -> Floats:
    """(n, 4) boxes around ellipses (n, 5)."""
    x, y, a, b, rho = ellipses.T
    half = np.column_stack([np.hypot(a * np.cos(rho), b * np.sin(rho)), np.hypot(a * np.sin(rho), b * np.cos(rho))])
    return np.column_stack([x - half[:, 0], y - half[:, 1], 2.0 * half])


def inside(boxes: LabelledBoxes, size: Ints) -> LabelledBoxes:
    """Boxes of which a part is in the image, which has size (n, 2); a tracker's box may have lost its own."""
    low, high = boxes.box[:, :2], boxes.box[:, :2] + boxes.box[:, 2:]
    keep = ((high > 0) & (low < size) & (boxes.box[:, 2:] > 0)).all(axis=1)
    return LabelledBoxes._make(column[keep] for column in boxes)


def figures(truth: LabelledBoxes, tracks: LabelledBoxes) -> dict[str, float]:
    """FR_p, FR_l of each view alone and with one identity in all views, IDF1, HOTA, MOTA and what it is made of."""
    frames = of_boxes(truth.objects(), tracks.objects())
    clear = clear_mot.clear_mot(frames, clear_mot.CHALLENGE)
    lost, wrong = failure_rates(truth, tracks, joint=False)
    return {
        "fr_p": lost,
        "fr_l": wrong,
        "fr_l joint": failure_rates(truth, tracks, joint=True)[1],
        "idf1": idf1.identity(frames).idf1,
        "hota": hota.hota(frames).means()["hota"],
        "mota": clear.mota,
        "recall": clear.recall,
        "precision": clear.precision,
        "switches": float(clear.switches),
    }


def failure_rates(truth: LabelledBoxes, tracks: LabelledBoxes, *, joint: bool) -> tuple[float, float]:
    """FR_p and FR_l, [Qu] Eq. 9, with the rules of `occlog evaluate --assigned-target start`.

    Args:
        truth: the targets.
        tracks: the estimates.
        joint: a label is one target in all views; false: each view has labels of its own.
    """
    tau = 0.5 * np.sqrt(truth.box[:, 2] * truth.box[:, 3])
    if not joint:
        tracks = tracks._replace(label=tracks.label * (1 + tracks.view.max(initial=0)) + tracks.view)
    targets, centres = truth.centres(), tracks.centres()
    own = assigned_targets(targets, centres, tau, tracks.frame, "start")
    found = failures(targets, centres, tau, own)
    return found.fr_p, found.fr_l
