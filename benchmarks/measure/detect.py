"""Detection of a 640 x 480 rendered recording against the bare OpenCV loop, processor time per frame."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import cv2
import numpy as np

from occlog.core.geometry.camera import rotation_from_angles
from occlog.measure.clusters.stage import find_clusters
from occlog.measure.detect.by_background.one_camera import CameraState, Target, set_up
from occlog.measure.detect.by_background.stage import Learned, detect
from occlog.measure.detect.config import CLEAN_PX, DetectConfig
from occlog.measure.regions.background import foreground
from occlog.measure.regions.regions import cluster_regions, gather
from occlog.records.frames import Frame, Image
from occlog.records.scene import Camera, Scene
from occlog.simulate.config import RenderConfig, WorldConfig
from occlog.simulate.render.people import reference_appearances, render
from occlog.simulate.stage import simulate_truth

NAME = "detect"
SUMMARY = "640x480 video, about 5 % foreground: detection to decode + MOG2 + connected components, per frame and core"
LIMIT = 1.5
FRAMES = 60
STEP_NS = 100_000_000
SEED = 3
PEOPLE = 4


def room() -> Scene:
    """One camera that looks down into a room of 8 x 6 m."""
    camera = Camera(
        "cam",
        np.array([0.2, 0.2, 2.4]),
        rotation_from_angles(0.64, -0.2, 0.0),
        np.array([380.0, 380.0]),
        np.array([319.5, 239.5]),
        (640, 480),
    )
    return Scene(cameras=(camera,), room=np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]]))


def film(scene: Scene, people: int) -> list[Image]:
    """Images of the camera while so many people walk about."""
    world = WorldConfig(
        steps=FRAMES,
        step_s=0.1,
        targets=1,
        occluders=people - 1,
        diameter=0.6,
        speed=1.0,
        process_noise_position=0.1,
        wall_clearance=0.3,
    )
    return [shot.image for shot in render(scene, simulate_truth(scene, world, SEED), RenderConfig(), SEED)]


def empty_room(scene: Scene, images: list[Image]) -> Image:
    """The room without people: the median over two films in which they walk elsewhere."""
    other = WorldConfig(steps=FRAMES, step_s=1.5, targets=1, diameter=0.6, wall_clearance=0.3)
    more = [shot.image for shot in render(scene, simulate_truth(scene, other, SEED + 1), RenderConfig(), SEED)]
    return np.median(np.stack([*images[::6], *more[::2]]), axis=0).astype(np.uint8)


def bare(pngs: list[Any], empty: Image) -> None:
    """Run OpenCV alone: decode, MOG2, connected components."""
    model = cv2.createBackgroundSubtractorMOG2()
    model.apply(empty, learningRate=1.0)
    for png in pngs:
        mask = model.apply(cv2.imdecode(png, cv2.IMREAD_COLOR))
        _, mask = cv2.threshold(mask, 254, 255, cv2.THRESH_BINARY)
        cv2.connectedComponentsWithStats(mask)


def ours(pngs: list[Any], scene: Scene, target: Target, empty: Image) -> None:
    """All of the detect stage, on one thread."""
    frames = [Frame(k * STEP_NS, "cam", k, partial(cv2.imdecode, png, cv2.IMREAD_COLOR)) for k, png in enumerate(pngs)]
    for _ in detect(frames, scene, DetectConfig(), 1, Learned(empty={"cam": empty}), (target,)):
        pass


def cost_ms(work: Callable[[], object]) -> float:
    """Processor time [ms] of a frame."""
    start = time.process_time()
    work()
    return (time.process_time() - start) / FRAMES * 1e3


def steps_ms(images: list[Image], pngs: list[Any], state: CameraState) -> dict[str, float]:
    """Processor time [ms] a frame of each step of ours, measured one after the other."""
    setup = set_up(state, images[0])
    masks: list[Image] = []
    parts = {
        "decode": cost_ms(lambda: [cv2.imdecode(png, cv2.IMREAD_COLOR) for png in pngs]),
        "background": cost_ms(
            lambda: masks.extend(foreground(setup.subtractor, image, k, CLEAN_PX) for k, image in enumerate(images))
        ),
    }
    parts["cells"] = cost_ms(lambda: [gather(mask, setup.side) for mask in masks])
    cells = [gather(mask, setup.side) for mask in masks]
    parts["clusters (EM)"] = cost_ms(
        lambda: [find_clusters(c, corners, setup.side, setup.prior) for c, corners in cells]
    )
    whole = cost_ms(
        lambda: [cluster_regions(i, m, setup.side, setup.prior) for i, m in zip(images, masks, strict=True)]
    )
    parts["boxes and appearance"] = max(whole - parts["cells"] - parts["clusters (EM)"], 0.0)
    parts["foreground [%]"] = 100.0 * float(np.mean([np.count_nonzero(m) / m.size for m in masks]))
    return parts


def run(repeats: int) -> dict[str, Any]:
    """Ratio of the medians of alternating repeats; parts in ms a frame."""
    scene = room()
    images = film(scene, PEOPLE)
    empty = empty_room(scene, images)
    pngs = [cv2.imencode(".png", image)[1] for image in images]
    references = reference_appearances(scene, [0], RenderConfig(), SEED)
    target = Target(0, np.array([r["appearance"] for r in references]))
    cv2.setNumThreads(1)
    ours(pngs[:4], scene, target, empty)  # compile
    baseline, whole, shares = [], [], []
    for _ in range(repeats):
        baseline.append(cost_ms(lambda: bare(pngs, empty)))
        whole.append(cost_ms(lambda: ours(pngs, scene, target, empty)))
        shares.append(steps_ms(images, pngs, CameraState(scene.cameras[0], scene, DetectConfig(), empty)))
    parts = {name: median(s[name] for s in shares) for name in shares[0]}
    steps = sum(v for name, v in parts.items() if "%" not in name)
    total, base = median(whole), median(baseline)
    parts = {"OpenCV alone": base, "detect": total, **parts, "bearings, tables, rest": max(total - steps, 0.0)}
    shown = {name if "[" in name else f"{name} [ms]": value for name, value in parts.items()}
    return {"ratio": total / base, "limit": LIMIT, "parts": shown}
