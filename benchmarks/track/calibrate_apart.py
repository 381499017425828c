"""Calibration of cameras that share no view, by walkers who pass from one view to the next, against the true cameras.

    python -m benchmarks.track.calibrate_apart [--halls N] [--seed N] [--hall NAME] [--unknown-levels]

Eight cameras in two rows, 8 m apart, 2.8 to 3.4 m high, turned at random; each sees a square of 5.5 m, and what is
beyond is hidden.  Ten people walk one after the other for a minute each: straight to a random position in the next view
at about 1.2 m/s, with a random walk of 0.05 m per root second.  Bodies are those of `benchmarks.setups`, boxes have
errors of 3 px and 10 % are missed.  Nothing is known of yaw and position; height, pitch and roll are stated with errors
of 2 cm and 0.2 degrees, or with --unknown-levels not at all.  Errors are after a rigid motion of all cameras in the
plane, with --unknown-levels after a similarity.  The normalised squared error (NSE) of a parameter is 1 in the mean if
standard deviations are right.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.setups import _rigs
from benchmarks.track.calibrate import frames_of
from occlog.array_types import Floats
from occlog.calibrate.config import CalibrateConfig
from occlog.calibrate.kernels import expected_boxes
from occlog.calibrate.stage import Calibrated, calibrate
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles, wrap_angle
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import simulate_truth
from occlog.track.methods.jipda.kernels.body_box import pack_views
from occlog.track.people.frame_detections import FrameDetectionsWithIds

NAME = "calibrate-apart"
SUMMARY = "8 cameras without a common view, ten walks of a minute: 95 % of the errors of yaw, against the limit [deg]"
LIMIT_YAW_DEG, LIMIT_POSITION, SIGMA_TILT, SIGMA_HEIGHT = 1.0, 0.3, 0.2, 0.02
ROWS, COLUMNS, WALK_S, PAUSE_S, AHEAD, BAY = 2, 4, 60.0, 20.0, 4.5, 5.5
FPS, SPEED, JITTER, TURN_RATE = 5.0, 1.2, 0.05, np.radians(120.0)


@dataclass(frozen=True)
class Hall:
    """A hall with walkers.

    Attributes:
        spacing: of the cameras [m].
        walks: number of walks, one after the other.
        together: number of people who walk at the same time.
        detours: share of the ways from view to view with a right angle half way.
        waypoints: people walk to random positions of the hall, and turn where they arrive.
        tall: mean height of the walkers [m].
        avoided: number of cameras that no person crosses.
        edge_px: standard deviation of the edges of boxes [px].
        miss: probability of a missed box.
        rings: bodies are those of `benchmarks.setups`; else the ellipsoids of the estimator.
    """

    spacing: float = 8.0
    walks: int = 10
    together: int = 1
    detours: float = 0.0
    waypoints: bool = False
    tall: float = 1.7
    avoided: int = 0
    edge_px: float = 3.0
    miss: float = 0.1
    rings: bool = True


HALLS = {
    "base": Hall(),
    "ellipsoids": Hall(rings=False),
    "gaps of 6 s": Hall(spacing=12.0),
    "gaps of 10 s": Hall(spacing=17.0),
    "a fifth turns": Hall(detours=0.2),
    "half turns": Hall(detours=0.5),
    "all turn": Hall(detours=1.0),
    "random destinations": Hall(waypoints=True),
    "people 5 % shorter": Hall(tall=1.615),
    "two at once": Hall(together=2),
    "one camera avoided": Hall(avoided=1),
    "three walks": Hall(walks=3),
}


def cameras_of(hall: Hall, rng: np.random.Generator) -> list[Camera]:
    """Cameras above the middles of the squares of a grid, turned at random."""
    out = []
    size = (1280, 720)
    for k in range(ROWS * COLUMNS):
        middle = hall.spacing * (0.5 + np.array([k % COLUMNS, k // COLUMNS])) + rng.uniform(-0.3, 0.3, 2)
        yaw, height = rng.uniform(-np.pi, np.pi), rng.uniform(2.8, 3.4)
        pitch = np.radians(rng.uniform(-24.0, -18.0))
        ground = middle - AHEAD * np.array([np.cos(yaw), np.sin(yaw)])
        rotation = camera_rotation(yaw, pitch, float(np.radians(rng.normal(0.0, 1.0))))
        focal, principal = np.full(2, 700.0), np.array([639.5, 359.5])
        out.append(Camera(f"cam{k + 1}", np.array([*ground, height]), rotation, focal, principal, size))
    return out


def middle_of_view(camera: Camera) -> Floats:
    """(2,) middle of the ground that a camera sees."""
    return np.asarray(camera.position[:2] + AHEAD * np.array([np.cos(camera.yaw), np.sin(camera.yaw)]))


def walked(hall: Hall, cameras: list[Camera], rng: np.random.Generator) -> Floats:
    """(T, 2) positions of a person who walks from view to view, or by `occlog simulate`, for a minute."""
    steps, room = round(WALK_S * FPS), hall.spacing * np.array([COLUMNS, ROWS])
    if hall.waypoints:
        config = WorldConfig(
            steps=steps,
            step_s=1.0 / FPS,
            targets=1,
            speed=SPEED,
            diameter=0.5,
            process_noise_position=JITTER,
            redirect_probability=0.0,
            wall_clearance=0.25,
            object_height=0.9,
        )
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * room
        truth = simulate_truth(Scene((), room=corners), config, int(rng.integers(1 << 30)))
        return np.concatenate([np.column_stack([t.x, t.y]) for t in truth])
    middles = np.array([middle_of_view(c) for c in cameras])
    view = int(rng.integers(hall.avoided, len(middles)))
    at, speed, ways = middles[view] + rng.uniform(-1.0, 1.0, 2), rng.normal(SPEED, 0.1), []
    heading, out = float(rng.uniform(-np.pi, np.pi)), np.empty((steps, 2))
    for k in range(steps):
        out[k] = at
        if not ways:
            far = np.linalg.norm(middles - middles[view], axis=1)
            near = np.flatnonzero((far > 0.0) & (far < 1.7 * hall.spacing))
            view = int(rng.choice(near[near >= hall.avoided]))
            ways = [middles[view] + rng.uniform(-1.0, 1.0, 2)]
            if rng.random() < hall.detours:
                half = 0.5 * (ways[0] - at)
                ways.insert(0, at + half + rng.choice([-1.0, 1.0]) * np.array([-half[1], half[0]]))
        aim = np.arctan2(*(ways[0] - at)[::-1])
        heading += float(np.clip(wrap_angle(np.array(aim - heading)), -TURN_RATE / FPS, TURN_RATE / FPS))
        at = at + speed / FPS * np.array([np.cos(heading), np.sin(heading)]) + rng.normal(0.0, JITTER / FPS**0.5, 2)
        if np.linalg.norm(ways[0] - at) < 0.5:
            ways.pop(0)
    return out


def boxes_of_ellipsoids(
    camera: Camera, numbers: Floats, places: Floats, bodies: Floats, detector: _rigs.Detector, rng: np.random.Generator
) -> Floats:
    """(N, 5) frame and box of the estimator's bodies at places (T, n, 2), none hidden by another."""
    T, n = places.shape[:2]
    state = np.zeros((T * n, 6))
    state[:, :2], state[:, 4:] = places.reshape(-1, 2), np.tile(bodies, (T, 1))
    box = np.full((T * n, 4), np.nan)
    expected_boxes(pack_views([camera]).lens, np.zeros(T * n, dtype=np.int64), state, np.zeros(T * n), box)
    box += rng.normal(0.0, detector.edge_px, box.shape)
    size = np.array(camera.image_size, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (box[:, :2] + box[:, 2:])
        seen = ((middle > 0.0) & (middle < size - 1.0)).all(axis=1) & (rng.random(T * n) >= detector.miss)
    box = np.clip(box, 0.0, np.tile(size, 2))
    seen &= (box[:, 2] - box[:, 0] > 4.0) & (box[:, 3] - box[:, 1] > 8.0)
    return np.asarray(np.column_stack([np.repeat(numbers, n), box])[seen])


def rig(seed: int, hall: Hall) -> _rigs.Rig:
    """Cameras, walkers and boxes, drawn from a seed."""
    rng = np.random.default_rng((seed, 4711))
    cameras = cameras_of(hall, rng)
    per, detector = round((WALK_S + PAUSE_S) * FPS), _rigs.Detector(hall.edge_px, 0.0, hall.miss, 0.0)
    boxes: dict[str, list[Floats]] = {c.name: [] for c in cameras}
    bodies = np.zeros((0, 2))
    for k in range(hall.walks):
        at = np.stack([walked(hall, cameras, rng) for _ in range(hall.together)], axis=1)
        bodies = np.column_stack([rng.normal(hall.tall, 0.07, hall.together), rng.normal(0.52, 0.05, hall.together)])
        for c in cameras:
            # What is beyond the bay of a camera is hidden
            inside = (np.abs(at - middle_of_view(c)) < 0.5 * BAY).all(axis=-1, keepdims=True)
            shown = np.where(inside, at, np.nan)
            make = _rigs._boxes if hall.rings else boxes_of_ellipsoids
            boxes[c.name].append(make(c, k * per + np.arange(len(at)), shown, bodies, detector, rng))
    return _rigs.Rig(
        seed, (COLUMNS * hall.spacing, ROWS * hall.spacing), FPS, detector, np.zeros((0, 0, 2)), bodies,
        {c.name: c for c in cameras}, boxes={name: np.concatenate(parts) for name, parts in boxes.items()},
        seconds=hall.walks * per / FPS,
    )  # fmt: skip


def stated(cameras: Iterable[Camera], rng: np.random.Generator, *, levels: bool) -> list[Camera]:
    """Cameras of which the lens is known, and with `levels` height, pitch and roll to 2 cm and 0.2 degrees."""
    out = []
    for camera in cameras:
        _, pitch, roll = np.array(angles_from_rotation(camera.rotation)) + rng.normal(0.0, np.radians(SIGMA_TILT), 3)
        at = np.array([0.0, 0.0, camera.position[2] + rng.normal(0.0, SIGMA_HEIGHT)])
        rotation = rotation_from_angles(0.0, float(pitch), float(roll))
        bare = replace(camera, position=at if levels else np.zeros(3), rotation=rotation if levels else np.eye(3))
        out.append(replace(bare, placed=False))
    return out


def errors(found: Calibrated, true: list[Camera], *, scaled: bool) -> Floats:
    """(n, 6) of each calibrated camera: errors of x and y [m] and yaw [deg], and their normalised squares.

    Errors are in the frame of the result, after a rigid motion, or without `scaled` a similarity of the truth.
    """
    own = [c for c, each in enumerate(found.cameras) if each.estimated]
    ours = np.array([complex(*found.cameras[c].camera.position[:2].tolist()) for c in own])
    real = np.array([complex(*true[c].position[:2].tolist()) for c in own])
    m = ((ours - ours.mean()) * np.conj(real - real.mean())).sum()
    m = m / abs(m) if scaled else m / (np.abs(real - real.mean()) ** 2).sum()
    off = (ours - ours.mean()) - m * (real - real.mean())
    yaw = np.array([found.cameras[c].camera.yaw - true[c].yaw for c in own]) - np.angle(m)
    yaw = np.angle(np.exp(1j * yaw))
    sigma = np.array([found.cameras[c].sigma for c in own])
    sigma_yaw = np.array(
        [np.linalg.norm(found.cameras[c].camera.rotation[2] * found.cameras[c].sigma[:3]) for c in own]
    )
    square = [(off.real / sigma[:, 3]) ** 2, (off.imag / sigma[:, 4]) ** 2, (yaw / sigma_yaw) ** 2]
    return np.column_stack([off.real, off.imag, np.degrees(yaw), *square])


def recorded(made: _rigs.Rig) -> list[FrameDetectionsWithIds]:
    """Frames of cameras that record within a second of a box."""
    near = {
        (c, k + d)
        for c, name in enumerate(made.names)
        for k in made.boxes[name][:, 0].astype(int).tolist()
        for d in range(-round(FPS), round(FPS) + 1)
    }
    every = frames_of(made, np.zeros(len(made.names)))
    return [each for each in every if (each.detections.camera, each.frame) in near]


def measured(seeds: Iterable[int], hall: Hall, *, levels: bool) -> dict[str, Any]:
    """Errors over halls; each is printed."""
    config = CalibrateConfig(sigma_tilt=SIGMA_TILT, sigma_height=SIGMA_HEIGHT) if levels else CalibrateConfig()
    rows, refused, left, scales = [], 0, 0, []
    for seed in seeds:
        made = rig(seed, hall)
        true = [made.cameras[name] for name in made.names]
        frames = recorded(made)
        start = stated(true, np.random.default_rng((seed, 5)), levels=levels)
        try:
            found = calibrate(frames, Scene(tuple(start)), start, config, seed=seed)
        except InputError as error:
            refused += 1
            print(f"{seed}: refused: {error}", flush=True)
            continue
        part = errors(found, true, scaled=levels)
        own = [c for c, each in enumerate(found.cameras) if each.estimated]
        away = np.array([[found.cameras[c].camera.position[:2], true[c].position[:2]] for c in own])
        scales.append(float(np.sqrt(np.divide(*away.var(axis=0).sum(axis=1)))))
        left += len(true) - len(own)
        rows.append(np.column_stack([part, np.hypot(*errors(found, true, scaled=False)[:, :2].T)]))
        print(
            f"{seed}: cameras {len(own)}, position {np.hypot(*part[:, :2].T).max():.2f} m, "
            f"yaw {np.abs(part[:, 2]).max():.2f} deg, NSE {np.round(part[:, 3:].mean(axis=0), 2).tolist()}, "
            f"scale {scales[-1]:.3f}, handovers {found.handovers}", flush=True,
        )  # fmt: skip
    every = np.concatenate([np.zeros((0, 7)), *rows])
    far, yaw = np.hypot(*every[:, :2].T), np.abs(every[:, 2])
    return {
        "halls": len(rows) + refused, "refused": refused, "cameras left": left,
        "position [m], median": float(np.median(far)), "position, 95 %": float(np.percentile(far, 95)),
        "position, within 0.3 m": float((far <= LIMIT_POSITION).mean()),
        "position after a similarity, median": float(np.median(every[:, 6])),
        "position after a similarity, 95 %": float(np.percentile(every[:, 6], 95)),
        "yaw [deg], median": float(np.median(yaw)), "yaw, 95 %": float(np.percentile(yaw, 95)),
        "yaw, within 1 deg": float((yaw <= LIMIT_YAW_DEG).mean()),
        "NSE of x, y, yaw": [round(float(v), 2) for v in every[:, 3:6].mean(axis=0)],
        "scale": round(float(np.mean(scales)), 3),
    }  # fmt: skip


def run(repeats: int = 5) -> dict[str, Any]:
    """95 % of the errors of yaw; `repeats` halls."""
    found = measured(range(500, 500 + repeats), HALLS["base"], levels=True)
    return {"ratio": found["yaw, 95 %"], "limit": LIMIT_YAW_DEG, "parts": found}


def main() -> None:
    """Calibrate, and print the errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--halls", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hall", default="base", choices=sorted(HALLS))
    parser.add_argument("--unknown-levels", action="store_true", help="heights, pitch and roll are estimated, too")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.halls)
    found = measured(seeds, HALLS[options.hall], levels=not options.unknown_levels)
    for name, value in found.items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
