"""Random people, and boxes that random detectors make of them, for the kernels and for their independent form."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from crowds import cameras_around
from jipda_reference import Detector, body_box

from occlog.array_types import Floats
from occlog.records.scene import Camera
from occlog.track.methods.jipda.kernels.body_box import PackedCameras, pack_views
from occlog.track.methods.jipda.kernels.detections import DetectorModel, PackedDetections

BORDER_PX = 3.0


class Scene(NamedTuple):
    """One time step; N people, C cameras, M boxes."""

    cameras: tuple[Camera, ...]
    views: PackedCameras
    detectors: list[Detector]
    rates: DetectorModel
    mean: Floats
    covariance: Floats
    existence: Floats
    boxes: PackedDetections
    features: Floats

    def frames(self) -> list[tuple[int, float, Any, Any, Any, Any]]:
        """The boxes for the independent form."""
        b, out = self.boxes, []
        for k in range(len(b.camera)):
            here = slice(b.first[k], b.first[k + 1])
            out.append(
                (
                    int(b.camera[k]),
                    float(b.delay[k]),
                    b.box[here],
                    b.usable[here],
                    b.clutter[here],
                    self.features[:, here],
                )
            )
        return out


def plain(kernel: Any) -> Any:
    """The Python function of a part of a kernel, which calls compiled ones; it is not compiled by itself."""
    return getattr(kernel, "py_func", kernel)


def random_scene(seed: int, people: int = 5, cameras: int = 3) -> Scene:
    """Neighbours who hide and touch each other, in rooms of 7 x 6 m; boxes are missed, merged, cut and false."""
    rng = np.random.default_rng(seed)
    made = cameras_around(cameras, 7.0, 6.0, seed=seed)
    curve = np.array([0.02, 0.1, 0.4, 0.8, 0.95, 1.0])
    noise = rng.uniform(0.5, 2.0, (4, 1)) * np.array([[8.0, 1e-4], [20.0, 4e-4], [6.0, 1e-4], [15.0, 2e-4]])
    cut, wrong, sway, slow = (
        rng.uniform(0.1, 0.6),
        rng.uniform(0.02, 0.1),
        rng.uniform(0.0, 3e-4),
        rng.uniform(1.0, 4.0),
    )
    detectors = [
        Detector(rng.uniform(0.7, 0.95), curve, cut, wrong, rng.normal(0.0, 0.02, 4), noise, sway,
                 rng.uniform(1.0, 5.0), rng.uniform(0.05, 0.4), slow)
        for _ in made
    ]  # fmt: skip
    rates = DetectorModel(
        detection=np.array([d.detection for d in detectors]), curve=curve, cut=cut, wrong=wrong,
        bias=np.array([d.bias for d in detectors]), noise=noise, gait_variance=sway,
        lasting=np.array([d.lasting for d in detectors]), merge=np.array([d.merge for d in detectors]),
        common_miss=0.0, slow=slow,
    )  # fmt: skip
    where = rng.uniform([1.5, 1.5], [5.5, 4.5], (people, 2))
    where[1] = where[0] + rng.normal(0.0, 0.4, 2)
    truth = np.column_stack([where, rng.normal(0.0, 0.8, (people, 2)), rng.normal(1.72, 0.08, people),
                             rng.normal(0.52, 0.05, people)])  # fmt: skip
    half = rng.normal(0.0, 1.0, (people, 6, 6)) * np.array([0.06, 0.06, 0.2, 0.2, 0.03, 0.03])[:, None]
    covariance = half @ half.transpose(0, 2, 1) + np.diag([1e-3, 1e-3, 1e-2, 1e-2, 1e-3, 1e-3])
    mean = np.array([rng.multivariate_normal(t, P) for t, P in zip(truth, covariance, strict=True)])
    box, first, delay = [], [0], rng.uniform(-0.1, 0.0, cameras)
    for c, (camera, detector) in enumerate(zip(made, detectors, strict=True)):
        drawn = [body_box(camera, *(t[:2] + delay[c] * t[2:4]), t[4], t[5]) + rng.normal(0.0, 4.0, 4) for t in truth]
        if rng.random() < 0.5:
            drawn[0] = np.concatenate([np.minimum(drawn[0], drawn[1])[:2], np.maximum(drawn[0], drawn[1])[2:]])
            del drawn[1]
        for b in drawn:
            if rng.random() < 0.25:
                b[3] -= rng.uniform(0.2, 0.5) * (b[3] - b[1])
            elif rng.random() < 0.2:
                b[rng.integers(4)] += rng.normal(0.0, 60.0)
        kept = [b for b in drawn if rng.random() < detector.detection]
        corner = rng.uniform([0.0, 0.0], [1000.0, 500.0])
        kept.append(np.concatenate([corner, corner + rng.uniform(20.0, 200.0, 2)]))
        box += [] if seed % 4 == 3 and c == 0 else kept
        first.append(len(box))
    edges = np.clip(np.array(box), 0.0, [1279.0, 719.0, 1279.0, 719.0])
    believed = np.abs(edges - [0.0, 0.0, 1279.0, 719.0]) > BORDER_PX
    boxes = PackedDetections(
        np.arange(cameras), delay, np.array(first), edges, believed, np.log(rng.uniform(0.2, 2.0, len(box)))
    )
    features = rng.normal(0.0, 0.5, (people, len(box)))
    views = pack_views(made)
    return Scene(made, views, detectors, rates, mean, covariance, rng.uniform(0.3, 0.99, people), boxes, features)
