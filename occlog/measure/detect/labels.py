"""Targets that the identities of boxes stand for, and the frames in which they should have been seen."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from occlog.array_types import Bools, Ints, Ints32
from occlog.errors import InputError
from occlog.records.tables import UNLABELLED, Boxes

from .config import GLOBAL, DetectConfig


@dataclass
class Labels:
    """Identities of boxes and the targets that they stand for.

    Attributes:
        scope: `GLOBAL` or `CAMERA`, see `config`.
        number: target of each camera and identity; the camera is empty where identities are global.
        span: first and last time at which a target has a box that counts.
    """

    scope: str
    number: dict[tuple[str, int], int] = field(default_factory=dict)
    span: dict[int, tuple[int, int]] = field(default_factory=dict)

    def of(self, sensor: str, ids: Ints32) -> Ints32:
        """(n,) targets of (n,) identities in a camera; `UNLABELLED` where there is none."""
        known = {i: self.number.get(self.key(sensor, i), UNLABELLED) for i in np.unique(ids).tolist()}
        return np.array([known[i] for i in ids.tolist()], dtype=np.int32)

    def missed(self, sensor: str, frames: Ints, t_ns: Ints, target: Ints32) -> tuple[Ints, Ints32]:
        """Times and targets of frames of a camera in which a target that is there then has no box, by time and target.

        Args:
            sensor: the camera.
            frames: (F,) times of its frames.
            t_ns: (n,) times of its boxes.
            target: (n,) their targets.
        """
        times, missing = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int32)]
        for (owner, _), k in self.number.items():
            if owner not in ("", sensor):
                continue
            first, last = self.span[k]
            there = frames[(frames >= first) & (frames <= last)]
            empty = np.setdiff1d(there, t_ns[target == k])
            times.append(empty)
            missing.append(np.full(len(empty), k, dtype=np.int32))
        found, targets = np.concatenate(times), np.concatenate(missing)
        order = np.lexsort((targets, found))
        return found[order], targets[order]

    def key(self, sensor: str, identity: int) -> tuple[str, int]:
        """Key of an identity in `number`."""
        return ("" if self.scope == GLOBAL else sensor, identity)


def counted(boxes: Boxes, config: DetectConfig) -> Bools:
    """(R,) rows that are boxes with enough confidence; those whose confidence is not given count."""
    with np.errstate(invalid="ignore"):
        return (boxes.box >= 0) & ~(boxes.confidence < config.min_confidence)


def survey_labels(chunks: Iterable[Boxes], scope: str, config: DetectConfig) -> Labels:
    """Look through all boxes for the targets, and when each is there.

    With global identities a target has the identity's own number.  Identities of cameras are numbered from 0,
    in the order of the times, the cameras and the identities.

    Raises:
        InputError: no box has an identity, or two boxes of a frame have the same one.
    """
    labels = Labels(scope)
    for chunk in chunks:
        rows = chunk.take(counted(chunk, config) & (chunk.target_id != UNLABELLED)).sorted()
        order = np.lexsort((rows.target_id, rows.sensor, rows.t_ns))
        keys = [
            (int(rows.t_ns[k]), str(rows.sensor[k]), int(rows.target_id[k]), int(rows.frame[k])) for k in order.tolist()
        ]
        for before, after in pairwise(keys):
            if before[:3] == after[:3]:
                raise InputError(
                    f"camera {after[1]}: frame {after[3]}: two boxes have the identity {after[2]}; one target has one "
                    "box in a frame: correct the identities, or detect without labels"
                )
        for t_ns, sensor, identity, _ in keys:
            key = labels.key(sensor, identity)
            target = labels.number.setdefault(key, identity if scope == GLOBAL else len(labels.number))
            labels.span[target] = (labels.span.get(target, (t_ns, t_ns))[0], t_ns)
    if not labels.number:
        raise InputError("no box has an identity that could be a target's; detect without labels")
    return labels
