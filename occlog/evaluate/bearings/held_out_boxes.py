"""Leave one camera out, everybody: which of its boxes do tracks made without it predict.

The tracks must have been made without the camera (`occlog track --without NAME`).  At each of its frames every track
is expected in its image, where the middle of the person and the feet project to; boxes and tracks are paired one to
one.  A box that no track predicts is a person who is missed, or a false box; a track in the image without a box is
false, or hidden.  Figures are given once more with the camera's frames paired with tracks of other times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import pair_within, quantile, ratio
from occlog.core.numerics.interpolate import interpolate_positions
from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.records.declared.people import PeopleTracks
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Boxes, Views
from occlog.settings import METRES

from .held_out import SHIFTS

Metrics = dict[str, float]
HEIGHT = 1.7
"""Height of people whose track has none [m]."""


class Looks(NamedTuple):
    """Boxes of one camera, frame by frame."""

    t_ns: Ints  # (F,) times of the frames, rising
    start: Ints  # (F + 1,) first box of each frame
    middle: Floats  # (n, 2) middle of each box [px]
    feet: Floats  # (n, 2) middle of its lower edge [px]


class Walker(NamedTuple):
    """A track: where its person stands and how tall they are."""

    t_ns: Ints
    state: Floats  # (M, 3) x, y, height


class Tally(NamedTuple):
    """Boxes of a camera, of them those predicted, tracks expected in the image, and distances [px] of the pairs."""

    boxes: int
    middles: Floats
    feet: Floats
    expected: int


def held_out_box_metrics(tracks: PeopleTracks, boxes: Boxes | Views, scene: Scene, config: EvaluateConfig) -> Metrics:
    """Figures for every camera held out, and over all of them; InputError for one without boxes or without a pose.

    `held_out_boxes_share` is the share of boxes whose middle is predicted within `held_out_gate_px`,
    `held_out_boxes_feet_share` the same of the feet, `..._precision` the share of the tracks expected in the image that
    predict a box, `..._median_px` the median distance of the pairs, `..._chance` the share at other times.
    """
    cameras = {camera.name: camera for camera in scene.cameras if camera.placed}
    height = HEIGHT / METRES.get(scene.length_unit, 1.0)
    walkers = _walkers(tracks, height)
    real: list[Tally] = []
    chance: list[Tally] = []
    out: Metrics = {}
    for name in config.held_out:
        if name not in cameras:
            raise InputError(
                f"held out: camera {name!r} is not in the scene, or has no pose; the scene has: {', '.join(cameras)}"
            )
        looks = looks_of(boxes, name)
        if not len(looks.t_ns):
            raise InputError(f"views: no row of the held-out camera {name!r}; give boxes that include it")
        own = tally(cameras[name], looks, walkers, config, 0)
        steps = np.unique(np.rint(np.linspace(0.1, 0.9, SHIFTS) * len(looks.t_ns)).astype(int)).tolist()
        other = [tally(cameras[name], looks, walkers, config, s) for s in steps if 0 < s < len(looks.t_ns)]
        out |= _figures([own], other, f"_sensor_{name}")
        real.append(own)
        chance += other
    return _figures(real, chance, "") | (out if len(config.held_out) > 1 else {})


def looks_of(boxes: Boxes | Views, camera: str) -> Looks:
    """Boxes of one camera; a frame without any is one with none."""
    rows = boxes.take(boxes.sensor == camera)
    times = np.unique(rows.t_ns)
    if isinstance(rows, Boxes):
        rows = rows.take(rows.box >= 0)
    rows = rows.take(np.argsort(rows.t_ns, kind="stable"))
    across = rows.left_px + 0.5 * rows.width_px
    low = rows.top_px + rows.height_px
    return Looks(
        t_ns=times,
        start=np.append(np.searchsorted(rows.t_ns, times), len(rows)),
        middle=np.column_stack([across, rows.top_px + 0.5 * rows.height_px]),
        feet=np.column_stack([across, low]),
    )


def _walkers(tracks: PeopleTracks, height: float) -> list[Walker]:
    """Every track, with a height for those that have none."""
    out = []
    for label in np.unique(tracks.target_id).tolist():
        own = tracks.take(tracks.target_id == label)
        tall = np.where(np.isfinite(own.height), own.height, height)
        out.append(Walker(own.t_ns, np.column_stack([own.x, own.y, tall])))
    return out


def tally(camera: Camera, looks: Looks, walkers: list[Walker], config: EvaluateConfig, shift: int) -> Tally:
    """Pair the boxes of each frame with the tracks of the frame that is `shift` frames later, one to one."""
    times = np.roll(looks.t_ns, -shift)
    states = [interpolate_positions(times, w.t_ns, w.state, config.bridge_ns)[0] for w in walkers]
    # (F, K, 3) where each track stands at each time, NaN where it is not
    state = np.stack(states, axis=1) if states else np.full((len(times), 0, 3), np.nan)
    middle = project(camera, state, 0.5)
    feet = project(camera, state, 0.0)
    middles: list[float] = []
    below: list[float] = []
    inside = 0
    for f in range(len(times)):
        rows = slice(int(looks.start[f]), int(looks.start[f + 1]))
        seen = _in_image(camera, middle[f])
        inside += int(np.count_nonzero(seen))
        for found, box, expected in ((middles, looks.middle[rows], middle[f]), (below, looks.feet[rows], feet[f])):
            away = np.hypot(*np.moveaxis(box[:, None] - expected[None, seen], 2, 0))
            found += [float(away[i, j]) for i, j in pair_within(away, config.held_out_gate_px)]
    return Tally(int(looks.start[-1]), np.array(middles), np.array(below), inside)


def project(camera: Camera, state: Floats, share: float) -> Floats:
    """(F, K, 2) pixels of the points at a share of the height of people (F, K, 3) x, y, height; NaN where not known."""
    flat = state.reshape(-1, 3)
    out = np.full((len(flat), 2), np.nan)
    known = np.isfinite(flat).all(axis=1)
    out[known] = camera.project(flat[known] * [1.0, 1.0, share])
    return out.reshape(*state.shape[:2], 2)


def _in_image(camera: Camera, pixels: Floats) -> Bools:
    """(K,) bool: pixels in the image; without a size of the image, those in front of the camera."""
    known: Bools = np.isfinite(pixels[:, 0]) & np.isfinite(pixels[:, 1])
    if camera.image_size is None:
        return known
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0.0) & (pixels < camera.image_size)
    return known & inside[:, 0] & inside[:, 1]


def _figures(real: list[Tally], chance: list[Tally], whose: str) -> Metrics:
    """Figures of some tallies together."""
    boxes, middles = sum(t.boxes for t in real), np.concatenate([np.zeros(0), *(t.middles for t in real)])
    feet = sum(len(t.feet) for t in real)
    other, met = sum(t.boxes for t in chance), sum(len(t.middles) for t in chance)
    return {
        f"held_out_boxes{whose}": boxes,
        f"held_out_boxes_share{whose}": ratio(len(middles), boxes),
        f"held_out_boxes_share_chance{whose}": ratio(met, other),
        f"held_out_boxes_feet_share{whose}": ratio(feet, boxes),
        f"held_out_boxes_precision{whose}": ratio(len(middles), sum(t.expected for t in real)),
        f"held_out_boxes_median{whose}_px": quantile(middles, 0.5),
    }
