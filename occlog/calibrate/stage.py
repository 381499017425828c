"""Calibration by walking people: from boxes of cameras to poses, focal lengths and clock offsets.

1. People are tracked in the images of each camera (method `sort`), and their boxes determine the ground plane.

2. Paths on the ground determine relative poses and clock offsets of the cameras.

3. Tracks of one person are joined across cameras, and a bundle adjustment estimates all parameters jointly.

4. Boxes are associated again with the estimated cameras (method `jipda`), and adjusted again.

5. The result, determined up to a common similarity transform of all cameras, is fitted to the stated poses and the mean
   height of people.

Cameras that share no view are calibrated by people who pass from one view to the next, in place of steps 2 to 4.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.sort.config import SortConfig
from occlog.track.people.camera_checks.pair_overlap import MAX_DISTANCE_HEIGHTS
from occlog.track.people.frame_detections import FrameDetectionsWithIds, group_time_steps
from occlog.track.people.image_tracks import CameraTracks
from occlog.track.people.inputs import default_window
from occlog.track.people.stage import JIPDA, track_people

from .adjustment import (
    DRIFT,
    FOCAL,
    LATE,
    PARAMETERS,
    RADIAL,
    SHIFT,
    TURN,
    Adjusted,
    Adjustment,
    BodyPrior,
    Clocks,
    NoiseModel,
    Observations,
    PathPrior,
)
from .config import CalibrateConfig
from .microphones.arrays import Path
from .people import MAX_GAP_S as MAX_UNSEEN_S
from .people import MAX_KNOTS, Tracklet, observations, on_grid, persons
from .starts.alignment import Complexes, PairAlignment, PlanarPose, align_pair, joined
from .starts.ground_plane import GroundPlane, ground_plane
from .starts.handovers import handovers, poses_of_handovers, walkers

GRID_S = 0.25
"""Least step of the grid on which paths are compared [s]."""
MAX_GRID = 1200
"""Steps of that grid, at most: a longer recording is used from its beginning."""
MAX_GAP_S = 1.6
"""Longest gap of a track that is interpolated on the grid [s]."""
TOLERANCE = 4.0
"""Poses of pairs of cameras are searched within this many standard deviations of the stated ones."""
MIN_ASSOCIATION = 0.9
"""Probability of an association of a box from which it is an observation."""
SIGMA_LOG_FOCAL, SIGMA_RADIAL, SIGMA_LATE_S, SIGMA_DRIFT = 0.1, 0.3, 0.5, 1e-4
"""Prior standard deviations of what is estimated of a lens and a clock."""
MIN_DRIFT_S = 60.0
"""Shortest recording from which drift is estimated [s]: less makes as much of it as errors of offsets do."""
MIN_LATE_S = 0.005
"""Least offset of a clock that is stated."""
DETERMINED = 0.5
"""A parameter with a prior is determined if its standard deviation is this much smaller than the prior's."""
NAMES = {FOCAL: "focal length", RADIAL: "radial coefficient", LATE: "clock"}
"""Parameters that may be undetermined."""
NOISE = NoiseModel(3.0, 0.04)
"""Errors of the edges of boxes to start from."""
SIGMA_ANYWHERE = 100.0
"""Standard deviation of the ground positions of cameras where only their scale is determined [m]."""
HELD_HEIGHT = 1e-3
"""Standard deviation of the mean height of people that holds the scale of single cameras [m]."""
SIGMA_LEVEL = 0.3
"""Standard deviation of the inclination of a camera alone [rad], and of its height in heights of people."""
BODY_WIDTH, SIGMA_BODY_WIDTH, SIGMA_LOOSE_HEIGHT = 0.55, 0.15, 0.5
"""Mean width of people and its standard deviation, and that of the mean height while the scale is held [m]."""


class CameraResult(NamedTuple):
    """Calibration result of one camera.

    Attributes:
        camera: camera with its pose.
        estimated: whether it was estimated; otherwise it is left as stated.
        sigma: (13,) standard deviations relative to all cameras together, NaN if not estimated: rotation vector (3)
            [rad], position (3), log of the focal length, first radial coefficient, delay of the clock [s], its drift,
            biases of the upper and lower edges of boxes [heights of the box], height of the widest part of people
            above their middle [heights of a person].
        late_s: delay of its clock at the beginning of the recording [s].
        drift_ppm: by how much its clock is fast against that of one of the cameras [ppm]; 0 where undetermined.
        boxes: number of boxes that determine it.
        rms_px: robust root mean square of their residuals [px].
        undetermined: names of parameters that were to be estimated and that the boxes do not determine.
    """

    camera: Camera
    estimated: bool
    sigma: Floats
    late_s: float
    drift_ppm: float
    boxes: int
    rms_px: float
    undetermined: tuple[str, ...] = ()

    @property
    def is_late(self) -> bool:
        """Whether the clock's offset is above 3 standard deviations and `MIN_LATE_S`, or its drift is significant."""
        return self.estimated and (
            abs(self.late_s) > max(3.0 * float(self.sigma[LATE]), MIN_LATE_S) or self.is_drifting
        )

    @property
    def is_drifting(self) -> bool:
        """Whether the drift of the clock is significant."""
        return self.estimated and abs(self.drift_ppm) > 3e6 * float(self.sigma[DRIFT]) > 0.0


class Calibrated(NamedTuple):
    """Calibration result of all cameras.

    Attributes:
        cameras: in the order of the input.
        people: number of people who determine it.
        mean_height: of people.
        sigma_frame: standard deviations of all cameras together: x, y (scene's unit), yaw [rad], scale [1].
        center: position x + i y about which yaw and scale are those of all cameras.
        covariance: (C 13, C 13) of the parameters, relative to all cameras together.
        correlation: factor by which the correlation of the boxes' errors in time widens variances.
        converged: the adjustment ended by itself.
        seen: boxes that determine it.
        residual: (N, 4) of them, observed minus expected edges [px]; NaN: not used.
        paths: of the people, by the common clock.
        handovers: of people from view to view, by which cameras that share no view are calibrated; 0: views are shared.
        ambiguous: handovers that were omitted, as more than one person can be meant.
    """

    cameras: list[CameraResult]
    people: int
    mean_height: float
    sigma_frame: Floats
    center: complex
    covariance: Floats
    correlation: float
    converged: bool
    seen: Observations
    residual: Floats
    paths: list[Path]
    handovers: int = 0
    ambiguous: int = 0


class _Estimate(NamedTuple):
    """Cameras and clocks of all C cameras, as estimated so far between the rounds of association and adjustment."""

    cameras: list[Camera]
    clocks: Clocks


Rows = list[tuple[int, int, float, Floats, complex]]
WALKING = PathPrior(0.005, 0.002, 4.0)
"""Prior of paths that pass from view to view: people may turn where no camera sees them."""
MAX_SIGMA_YAW, MAX_SIGMA_POSITION = np.radians(5.0), 1.0
"""Standard deviations [rad, m] from which a camera without a common view is left as it was."""


def calibrate(
    frames: Sequence[FrameDetectionsWithIds],
    scene: Scene,
    cameras: Sequence[Camera],
    config: CalibrateConfig,
    metre: float = 1.0,
    estimate: Collection[str] = (),
    seed: int = 0,
    step: Callable[[str], None] = lambda _: None,
    sigma_log_focal: Floats | None = None,
) -> Calibrated:
    """Calibrate cameras and clocks from boxes of walking people.

    Args:
        frames: boxes of all cameras, in the order of time.
        scene: gives room and occluders to the tracker.
        cameras: C cameras with intrinsics; poses of those that have one are where the search begins.
        config: settings.
        metre: length of a metre in scene units.
        estimate: parameters to estimate in addition to poses and clocks: `focal`, `radial`.
        seed: seed of the tracker's random numbers.
        step: function that is called with the name of each step.
        sigma_log_focal: (C,) standard deviations of the logarithms of focal lengths that are rough estimates, of which
            the first radial coefficient is estimated, too; 0: `estimate` applies; None: 0 for all.

    Raises:
        InputError: no two cameras see the same people, or no person is tracked.
    """
    C, height = len(cameras), config.person_height * metre
    step("track")
    boxes = [tracks_in_images(frames, c, camera) for c, camera in enumerate(cameras)]
    planes = [
        ground_plane(camera, np.concatenate([np.zeros((0, 4)), *(b for _, b in own)]), height)
        for camera, own in zip(cameras, boxes, strict=True)
    ]
    planes = [_as_stated(camera, plane, config) for camera, plane in zip(cameras, planes, strict=True)]
    step("align")
    times = _grid(boxes)
    tracklets = [_tracklets(c, cameras[c], planes[c], boxes[c], height) for c in range(C)]
    poses = _aligned(cameras, tracklets, times, config, metre)
    used = np.array([pose is not None for pose in poses])
    body = BodyPrior(
        height, config.sigma_person_height * metre, BODY_WIDTH * metre, SIGMA_BODY_WIDTH * metre,
        SIGMA_LOOSE_HEIGHT * metre, metre,
    )  # fmt: skip
    window_s = default_window(list(frames)) / NS
    clocks = config.max_clock_offset > 0.0
    sigma = _prior_sigmas(C, estimate, clocks=clocks, drift=clocks and times[-1] - times[0] >= MIN_DRIFT_S)
    estimates = np.zeros(C) if sigma_log_focal is None else sigma_log_focal
    rough = estimates > 0.0
    sigma[rough, FOCAL], sigma[rough, RADIAL] = estimates[rough], SIGMA_RADIAL
    if np.count_nonzero(used) < 2:
        step("handovers")
        return _calibrated_apart(cameras, planes, tracklets, body, config, metre, window_s, seed)
    now = _initial(cameras, planes, poses, times)
    placed = [_in_common_frame(t, poses) for own in tracklets for t in own if poses[t.camera] is not None]
    group = persons(placed, now.clocks, times, MAX_GAP_S, height)
    rows = _rows(placed, group)
    step("adjust")
    done, seen = _adjusted(rows, now, used, body, sigma, window_s)
    for _ in range(config.rounds):
        now = _scaled_to(_Estimate(done.cameras, _after(now, done)), height / done.mean_height)
        step("associate")
        rows = _associated(frames, scene, now, used, config, metre, seed)
        step("adjust")
        done, seen = _adjusted(rows, now, used, body, sigma, window_s)
    loose = _undetermined(done, sigma)
    # Lenses that are estimates are made better, or left
    loose[rough, FOCAL] = loose[rough, RADIAL] = False
    if loose.any():
        # What the boxes do not determine is as it was stated
        now = _Estimate(
            [
                _with_lens(c, s) if k[FOCAL] or k[RADIAL] else c
                for c, s, k in zip(now.cameras, cameras, loose, strict=True)
            ],
            now.clocks._replace(drift=np.where(loose[:, DRIFT], 0.0, now.clocks.drift)),
        )
        done, seen = _adjusted(rows, now, used, body, np.where(loose, 0.0, sigma), window_s)
    return _placed(cameras, done, seen, _after(now, done), used, config, metre, loose)


def _calibrated_apart(
    cameras: Sequence[Camera],
    planes: Sequence[GroundPlane | None],
    tracklets: Sequence[Sequence[Tracklet]],
    body: BodyPrior,
    config: CalibrateConfig,
    metre: float,
    window_s: float,
    seed: int,
) -> Calibrated:
    """Calibrate cameras that share no view by people who pass from one view to the next.

    Rahimi, Dunagan and Darrell (CVPR 2004): poses and paths at once, with a prior of the paths where no camera sees
    them. Clocks are taken to agree.

    Args:
        cameras: as stated.
        planes: of the cameras; None: unknown.
        tracklets: of each camera, in its level frame.
        body: prior of people's size.
        config: settings.
        metre: a metre in scene units.
        window_s: width of a time step [s].
        seed: of the search.

    Raises:
        InputError: fewer than two cameras are connected by people who pass.
    """
    C, every = len(cameras), _thinned([t for own in tracklets for t in own])
    clocks = Clocks(np.zeros(C), np.zeros(C), 0.0)
    level = (
        np.inf if config.sigma_tilt is None else float(np.radians(config.sigma_tilt)),
        np.inf if config.sigma_height is None else config.sigma_height * metre,
    )
    known = np.array([plane is not None for plane in planes])
    # Each camera alone: inclination and height by the bodies of people, and smooth paths
    none = PlanarPose(0.0, 0.0j, 0.0)
    now = _Estimate(_posed(cameras, planes, [none if k else None for k in known]), clocks)
    sigma = np.where(np.isin(np.arange(PARAMETERS), [3, 4]), 0.0, _prior_sigmas(C, (), clocks=False, drift=False))
    sigma[:, TURN], sigma[:, 5] = SIGMA_LEVEL, SIGMA_LEVEL * body.height
    stated = bool(np.isfinite(level[1]))
    held = body if stated else body._replace(sigma_mean=HELD_HEIGHT * metre)
    alone = _rows(every, np.arange(len(every)))
    done, seen = _adjusted(alone, now, known, held, sigma, window_s, WALKING, level=level)
    chains, velocities = _chains(seen, done)
    # What is stated of a level is where the adjustment starts from
    flat = done.cameras if np.isinf(level).all() else now.cameras
    person, ambiguous = walkers(chains, config.max_gap)
    passed = handovers(chains, velocities, person)
    poses = poses_of_handovers(passed, C, metre, np.random.default_rng(seed))
    while True:
        used = np.array([pose is not None for pose in poses])
        if np.count_nonzero(used) < 2:
            raise InputError(
                f"no two cameras see the same people, and {len(passed.seconds)} passages from view to view within "
                f"{config.max_gap:g} s do not determine their poses; record more walks, by one person at a time",
                id="insufficient-data",
            )
        own = [k for k, t in enumerate(chains) if used[t.camera]]
        moved = [_in_common_frame(chains[k], poses) for k in own]
        now = _Estimate([_turned(c, pose) for c, pose in zip(flat, poses, strict=True)], clocks)
        rows = _rows(moved, person[own])
        sigma = _prior_sigmas(C, (), clocks=False, drift=False)
        final, seen = _adjusted(rows, now, used, body, sigma, window_s, WALKING, config.max_gap, level)
        loose = np.zeros((C, PARAMETERS), dtype=np.bool_)
        found = _placed(cameras, final, seen, clocks, used, config, metre, loose, scaled=stated)
        weak = np.array([each.estimated and _is_weak(each, metre) for each in found.cameras])
        if not weak.any():
            return found._replace(handovers=len(passed.seconds), ambiguous=ambiguous)
        poses = [None if bad else pose for bad, pose in zip(weak, poses, strict=True)]


def _rows(tracklets: Sequence[Tracklet], group: Ints) -> Rows:
    """Boxes of n tracklets, each as (person, camera, stamped time [s], box (4,), ground position x + i y).

    `group` (n,) has the person of each tracklet.
    """
    return [
        (int(person), t.camera, float(when), box, complex(at))
        for person, t in zip(group, tracklets, strict=True)
        for when, box, at in zip(t.t_s, t.boxes, t.xy, strict=True)
    ]


def _loose_names(loose: Bools) -> tuple[str, ...]:
    return tuple(name for k, name in NAMES.items() if loose[k])


def _after(now: _Estimate, done: Adjusted) -> Clocks:
    """Clocks of the estimate `now`, with the corrections of offset and drift in `done` added."""
    return now.clocks._replace(
        late=now.clocks.late + done.values[:, LATE], drift=now.clocks.drift + done.values[:, DRIFT]
    )


def tracks_in_images(frames: Sequence[FrameDetectionsWithIds], c: int, camera: Camera) -> list[tuple[Floats, Floats]]:
    """Track people in the images of camera `c` (SORT); return stamped times (n,) [s] and boxes (n, 4) of each track.

    Boxes are left, top, right, bottom [px].
    """
    tracks = CameraTracks(camera, SortConfig())
    for each in frames:
        if each.detections.camera == c:
            tracks.keep(each)
    found, _ = tracks.smoothed()
    times = np.array(tracks.t_ns, dtype=np.float64) / NS
    return [(times[boxes.frame], boxes.boxes) for boxes, _ in found]


def _grid(boxes: Sequence[Sequence[tuple[Floats, Floats]]]) -> Floats:
    """(T,) time grid [s] on which paths are compared, at most `MAX_GRID` steps; InputError if no person is tracked.

    `boxes` are, for each camera, times [s] and boxes of its image tracks.
    """
    every = [t for own in boxes for t, _ in own if len(t) > 1]
    if not every:
        raise InputError(
            "no person is tracked in the images of any camera; give boxes of people who walk", id="insufficient-data"
        )
    step = max(GRID_S, float(np.median([np.median(np.diff(t)) for t in every])))
    first, last = min(t[0] for t in every), max(t[-1] for t in every)
    return np.asarray(first + step * np.arange(min(int((last - first) / step) + 2, MAX_GRID)))


def _tracklets(
    c: int, camera: Camera, plane: GroundPlane | None, boxes: Sequence[tuple[Floats, Floats]], height: float
) -> list[Tracklet]:
    """Image tracks of camera `c` with ground positions in its level frame, which has its origin below the camera.

    Args:
        c: index of the camera.
        camera: camera with its intrinsics.
        plane: its height and tilt; None: unknown, so that there are no tracklets.
        boxes: times (n,) [s] and boxes (n, 4) of each image track.
        height: height of a person, in scene units; positions many heights away are omitted.
    """
    out = []
    for t, own in boxes if plane is not None else ():
        xy = plane.positions(camera, own)  # type: ignore[union-attr]
        path = xy[:, 0] + 1j * xy[:, 1]
        good = np.isfinite(path) & (np.abs(path) < MAX_DISTANCE_HEIGHTS * height)
        if np.count_nonzero(good) >= 2:
            out.append(Tracklet(c, t[good], own[good], path[good]))
    return out


def _aligned(
    cameras: Sequence[Camera],
    tracklets: Sequence[Sequence[Tracklet]],
    times: Floats,
    config: CalibrateConfig,
    metre: float,
) -> list[PlanarPose | None]:
    """Planar poses of the C cameras in a common frame; None for a camera that shares no people with the others.

    Args:
        cameras: stated cameras; stated poses of a pair limit the search.
        tracklets: tracklets of each camera, on the ground in its level frame.
        times: (T,) grid of times [s].
        config: height of people and uncertainty of stated poses.
        metre: length of a metre in scene units.
    """
    step, C = float(times[1] - times[0]), len(cameras)
    height = config.person_height * metre
    paths: list[Complexes] = [
        np.array([on_grid(t.t_s, t.xy, times, MAX_GAP_S) for t in own]).reshape(-1, len(times)) for own in tracklets
    ]
    late = int(np.ceil(config.max_clock_offset / step))
    tolerance = TOLERANCE * np.sqrt(2.0) * np.array([np.radians(config.sigma_yaw), config.sigma_position * metre])
    pairs = []
    for a, b in combinations(range(C), 2):
        if not (len(paths[a]) and len(paths[b])):
            continue
        rough = _relative(cameras[a], cameras[b]) if cameras[a].placed and cameras[b].placed else None
        found = align_pair(paths[a], paths[b], step, height, late, rough, (float(tolerance[0]), float(tolerance[1])))
        if found is not None:
            pairs.append(PairAlignment(a, b, *found))
    return joined(C, pairs)


def _relative(a: Camera, b: Camera) -> PlanarPose:
    """Stated planar pose of camera b in the level frame of camera a, with a clock offset of 0."""
    turned = angles_from_rotation(a.rotation)[0]
    away = complex(*(b.position - a.position)[:2].tolist())
    return PlanarPose(angles_from_rotation(b.rotation)[0] - turned, complex(np.exp(-1j * turned) * away), 0.0)


def _is_weak(each: CameraResult, metre: float) -> bool:
    """Whether the yaw or the position of a camera is hardly determined."""
    sigma_yaw = float(np.linalg.norm(each.camera.rotation[2] * each.sigma[TURN]))
    return sigma_yaw > MAX_SIGMA_YAW or float(np.hypot(*each.sigma[3:5])) > MAX_SIGMA_POSITION * metre


def _as_stated(camera: Camera, plane: GroundPlane | None, config: CalibrateConfig) -> GroundPlane | None:
    """A ground plane with the inclination and the height that are stated with a standard deviation.

    InputError for a camera that states no height.
    """
    if plane is None:
        return None
    if config.sigma_height is not None:
        if not camera.above_floor:
            raise InputError(
                f"camera {camera.name} states no height, which sigma_height needs; state its position in the scene",
                id="insufficient-data",
            )
        plane = plane._replace(height=float(camera.position[2]))
    if config.sigma_tilt is not None:
        _, pitch, roll = angles_from_rotation(camera.rotation)
        plane = plane._replace(pitch=pitch, roll=roll)
    return plane


def _thinned(tracklets: Sequence[Tracklet]) -> list[Tracklet]:
    """Tracks with every n-th box, so that there are at most `MAX_KNOTS` boxes."""
    step = -(-sum(len(t.t_s) for t in tracklets) // MAX_KNOTS)
    return [Tracklet(t.camera, t.t_s[::step], t.boxes[::step], t.xy[::step]) for t in tracklets]


def _chains(seen: Observations, done: Adjusted) -> tuple[list[Tracklet], list[Complexes]]:
    """Paths of an adjustment in which each person is seen by one camera, as tracks with complex velocities."""
    at, speed = (done.states[:, k] + 1j * done.states[:, k + 1] for k in (0, 2))
    order = np.argsort(seen.knot, kind="stable")
    camera, box = seen.camera[order], seen.box[order]
    spans = [slice(a, b) for a, b in zip(seen.first[:-1].tolist(), seen.first[1:].tolist(), strict=True)]
    return [Tracklet(int(camera[s.start]), seen.time[s], box[s], at[s]) for s in spans], [speed[s] for s in spans]


def _in_common_frame(track: Tracklet, poses: Sequence[PlanarPose | None]) -> Tracklet:
    """A track in the level frame of its camera, moved to the frame of the cameras' poses; its camera has one."""
    pose = poses[track.camera]
    assert pose is not None
    return track._replace(xy=pose.position + np.exp(1j * pose.yaw) * track.xy)


def _turned(camera: Camera, pose: PlanarPose | None) -> Camera:
    """A camera of a level frame in the frame in which that has a pose; None: the camera as it is."""
    if pose is None:
        return camera
    turn = cv2.Rodrigues(np.array([0.0, 0.0, pose.yaw]))[0]
    return replace(
        camera, position=turn @ camera.position + [pose.position.real, pose.position.imag, 0.0],
        rotation=turn @ camera.rotation,
    )  # fmt: skip


def _initial(
    cameras: Sequence[Camera], planes: Sequence[GroundPlane | None], poses: Sequence[PlanarPose | None], times: Floats
) -> _Estimate:
    """Initial cameras and clocks in the common frame of the alignment; cameras without plane or pose are unchanged.

    `times` (T,) is the grid of times [s] in steps of which the clock offsets of `poses` are.
    """
    late = np.zeros(len(cameras))
    used = np.array([pose is not None for pose in poses])
    late[used] = [pose.late * (times[1] - times[0]) for pose in poses if pose is not None]
    late[used] -= _middle(late[used])
    clocks = Clocks(late, np.zeros(len(cameras)), float(0.5 * (times[0] + times[-1])))
    return _Estimate(_posed(cameras, planes, poses), clocks)


def _posed(
    cameras: Sequence[Camera], planes: Sequence[GroundPlane | None], poses: Sequence[PlanarPose | None]
) -> list[Camera]:
    """Cameras with the inclinations and heights of their planes, at planar poses; as they were without either."""
    out = []
    for camera, plane, pose in zip(cameras, planes, poses, strict=True):
        if plane is None or pose is None:
            out.append(camera)
            continue
        position = np.array([pose.position.real, pose.position.imag, plane.height])
        rotation = rotation_from_angles(pose.yaw, plane.pitch, plane.roll)
        out.append(replace(camera, position=position, rotation=rotation, placed=True))
    return out


def _middle(values: Floats) -> float:
    """Lower median of the values."""
    return float(np.sort(values)[(len(values) - 1) // 2])


def _prior_sigmas(count: int, estimate: Collection[str], *, clocks: bool, drift: bool) -> Floats:
    """(C, 13) prior standard deviations of the parameters of C = `count` cameras; 0: fixed, inf: free.

    The parameters are in the order of `CameraResult.sigma`.

    Args:
        count: number of cameras.
        estimate: parameters of lenses that are estimated: `focal`, `radial`.
        clocks: whether offsets of clocks are estimated.
        drift: whether their drifts are estimated, too.
    """
    sigma = np.zeros((count, PARAMETERS))
    sigma[:, TURN] = sigma[:, SHIFT] = np.inf
    sigma[:, FOCAL] = SIGMA_LOG_FOCAL if "focal" in estimate else 0.0
    sigma[:, RADIAL] = SIGMA_RADIAL if "radial" in estimate else 0.0
    sigma[:, LATE] = SIGMA_LATE_S if clocks else 0.0
    sigma[:, DRIFT] = SIGMA_DRIFT if drift else 0.0
    return sigma


def _undetermined(done: Adjusted, sigma: Floats) -> Bools:
    """(C, 13) mask of the cameras' parameters that the data hardly narrow, in the order of `CameraResult.sigma`.

    These have a finite prior, and a standard deviation above the share `DETERMINED` of the prior's.

    Args:
        done: adjustment, with the covariance of the parameters.
        sigma: (C, 13) prior standard deviations; 0: fixed; inf: free.
    """
    found = np.sqrt(np.maximum(np.diag(done.covariance), 0.0)).reshape(sigma.shape)
    return np.asarray(np.isfinite(sigma) & (sigma > 0.0) & (found > DETERMINED * sigma))


def _with_lens(camera: Camera, stated: Camera) -> Camera:
    """Return the camera with the focal length and distortion of the camera `stated`."""
    return replace(camera, focal_px=stated.focal_px, distortion=stated.distortion)


def _adjusted(
    rows: Rows,
    now: _Estimate,
    used: Bools,
    body: BodyPrior,
    sigma: Floats,
    window_s: float,
    paths: PathPrior = PathPrior(),  # noqa: B008
    max_gap_s: float = MAX_UNSEEN_S,
    level: tuple[float, float] = (np.inf, np.inf),
) -> tuple[Adjusted, Observations]:
    """Run a bundle adjustment; return its result and the observations. InputError without people seen by two cameras.

    The gauge is fixed by holding x and y of two distant cameras, and one clock.

    Args:
        rows: boxes with their persons.
        now: cameras and clocks to start from.
        used: (C,) cameras that are adjusted.
        body: prior of people's size.
        sigma: (C, 13) prior standard deviations; 0: fixed, inf: free.
        window_s: width of a time step [s].
        paths: prior of the paths; with a t distribution people need not be seen by two cameras at one time.
        max_gap_s: a person who is not seen for longer begins again [s].
        level: standard deviations of the stated inclinations [rad] and heights; inf: not stated. Heights determine the
            scale.
    """
    sizes, shared = [c.image_size for c in now.cameras], bool(np.isinf(paths.degrees))
    seen, states = observations(rows, now.clocks, window_s, sizes, body, max_gap_s, shared=shared)
    if not len(seen.time):
        raise InputError(
            "no person is seen by two cameras for 5 time steps in a row; record people who walk where views overlap",
            id="insufficient-data",
        )
    count = np.bincount(seen.camera, minlength=len(used))
    own = np.flatnonzero(used & (count > 0))
    free = np.where((used & (count > 0))[:, None], sigma, 0.0)
    if np.isinf(level[1]):
        ground = np.array([now.cameras[c].position[:2] for c in own])
        apart = np.linalg.norm(ground[:, None] - ground[None], axis=-1)
        for k in np.unravel_index(int(np.argmax(apart)), apart.shape):
            free[own[k], 3:5] = 0.0
    else:
        free[own, 3:5] = np.minimum(free[own, 3:5], SIGMA_ANYWHERE * body.metre)
    free[own[int(np.argmax(count[own]))], [LATE, DRIFT]] = 0.0
    return Adjustment(now.cameras, seen, states, body, free, now.clocks, NOISE, paths, level).run(), seen


def _scaled_to(now: _Estimate, scale: float) -> _Estimate:
    """Multiply the positions of the cameras by a scale; clocks are unchanged."""
    return _Estimate([replace(c, position=c.position * scale) for c in now.cameras], now.clocks)


def _associated(
    frames: Sequence[FrameDetectionsWithIds],
    scene: Scene,
    now: _Estimate,
    used: Bools,
    config: CalibrateConfig,
    metre: float,
    seed: int,
) -> Rows:
    """Associate boxes with people by the multi-camera tracker, with the current cameras and clocks.

    Returns the boxes that are with probability `MIN_ASSOCIATION` or more of one person alone, each as (person, camera,
    stamped time [s], box (4,), ground position x + i y).

    Args:
        frames: boxes of all cameras.
        scene: scene, of which only what is independent of the world frame is used.
        now: current cameras and clocks.
        used: (C,) mask of cameras that are used.
        config: height of people.
        metre: length of a metre in scene units.
        seed: seed of the tracker.
    """
    number = np.cumsum(used) - 1
    shifted = []
    box_of: dict[tuple[int, int], tuple[float, Floats]] = {}
    for each in frames:
        c = each.detections.camera
        if not used[c]:
            continue
        for row, box in zip(each.detections.row.tolist(), each.detections.boxes, strict=True):
            box_of[c, row] = each.detections.t_ns / NS, box
        t_ns = each.detections.t_ns - round(float(now.clocks.errors(c, np.array(each.detections.t_ns / NS))) * NS)
        shifted.append(each._replace(detections=each.detections._replace(t_ns=t_ns, camera=int(number[c]))))
    shifted.sort(key=lambda each: each.detections.t_ns)
    cameras = [c for c, own in zip(now.cameras, used, strict=True) if own]
    # Where the room and the occluders stand in the frame of the alignment is not known
    empty = replace(scene, cameras=tuple(cameras), room=None, occluders=(), arrays=(), readers=())
    jipda = replace(
        _jipda(metre), person_height=config.person_height * metre,
        sigma_person_height=config.sigma_person_height * metre,
    )  # fmt: skip
    steps = group_time_steps(iter(shifted), default_window(shifted))
    indices = np.flatnonzero(used)
    rows: Rows = []
    for part in track_people(steps, empty, cameras, jipda, JIPDA, seed):
        for snapshot in (each.snapshot for each in part):
            support = snapshot.support
            alone = support.probability - support.joint
            for k in np.flatnonzero(alone >= MIN_ASSOCIATION).tolist():
                c, person = int(indices[support.camera[k]]), int(support.person[k])
                when, box = box_of[c, int(support.row[k])]
                at = complex(*snapshot.mean[person, :2].tolist())
                rows.append((int(snapshot.ids[person]), c, when, box, at))
    return rows


def _jipda(metre: float) -> JipdaConfig:
    from occlog.track.people.inputs import in_units_of

    return in_units_of(JipdaConfig(), metre)


def _placed(
    stated: Sequence[Camera],
    done: Adjusted,
    seen: Observations,
    clocks: Clocks,
    used: Bools,
    config: CalibrateConfig,
    metre: float,
    loose: Bools,
    *,
    scaled: bool = False,
) -> Calibrated:
    """Transform the result to world coordinates, by the stated poses and the mean height of people.

    Args:
        stated: C cameras as stated.
        done: adjustment.
        seen: its observations.
        clocks: of the cameras.
        used: (C,) cameras that were adjusted.
        config: height of people and uncertainty of stated poses.
        metre: a metre in scene units.
        loose: (C, 13) parameters that the data hardly narrow.
        scaled: the adjustment has the scale of the world already.
    """
    own = np.flatnonzero(used)
    known = [c for c in own.tolist() if stated[c].placed and stated[c].position[2] > 0.0]
    log_scale = people = 0.0 if scaled else float(np.log(config.person_height * metre / done.mean_height))
    # Mean height of people in general, and of those who are seen, by boxes that are biased
    precision = 1.0 / (
        (config.sigma_mean_height / config.person_height) ** 2 + (done.sigma_mean_height / done.mean_height) ** 2
    )
    yaw, shift, information = 0.0, 0.0j, np.zeros(4)
    here = np.array([complex(*c.position[:2].tolist()) for c in done.cameras])
    there = np.array([complex(*c.position[:2].tolist()) for c in stated])
    angle = np.array(
        [
            angles_from_rotation(s.rotation)[0] - angles_from_rotation(d.rotation)[0]
            for s, d in zip(stated, done.cameras, strict=True)
        ]
    )
    sp, sy = config.sigma_position * metre, np.radians(config.sigma_yaw)
    if known:
        z, w = here[known] - here[known].mean(), there[known] - there[known].mean()
        spread = float((np.abs(z) ** 2).sum())
        for _ in range(20):
            scale = np.exp(log_scale)
            pull = (w * np.conj(z)).sum() * scale / sp**2 + np.exp(1j * angle[known]).sum() / sy**2
            yaw = float(np.angle(pull))
            # Scale: heights of people, and distances between the cameras
            along = float(((np.exp(-1j * yaw) * w) * np.conj(z)).sum().real)
            weight = 0.0 if scaled else spread * scale**2 / sp**2
            target = np.log(max(along / max(spread, 1e-12), 1e-6)) if spread > 0 else log_scale
            log_scale = (precision * people + weight * target) / (precision + weight)
        scale = np.exp(log_scale)
        shift = complex(there[known].mean() - scale * np.exp(1j * yaw) * here[known].mean())
        information = np.array(
            [len(known) / sp**2] * 2
            + [spread * scale**2 / sp**2 + len(known) / sy**2, precision + spread * scale**2 / sp**2]
        )
    else:
        information[3] = precision
    scale = float(np.exp(log_scale))
    turned = cv2.Rodrigues(np.array([0.0, 0.0, yaw]))[0]
    offset = np.array([shift.real, shift.imag, 0.0])
    cameras = [
        replace(c, position=scale * turned @ c.position + offset, rotation=turned @ c.rotation) for c in done.cameras
    ]
    if scaled:
        information[3] = 0.0
    covariance = _inner(done.covariance, cameras, own, scale, turned, scaled=scaled)
    with np.errstate(divide="ignore"):
        frame = 1.0 / np.sqrt(information)
    names = [_loose_names(each) for each in loose]
    center = complex(np.mean([complex(*cameras[c].position[:2].tolist()) for c in known or own.tolist()]))
    found = _result(
        stated, cameras, done, seen, clocks, used, covariance, frame, center, done.mean_height * scale, names
    )
    at = shift + scale * np.exp(1j * yaw) * (done.states[:, 0] + 1j * done.states[:, 1])
    return found._replace(paths=_paths(seen, seen.time + _middle(clocks.late[own]), at))


def _paths(seen: Observations, times: Floats, at: Complexes) -> list[Path]:
    """Paths of the people from the times (K,) [s] and positions (K,), x + i y, of all knots."""
    ends = zip(seen.first[:-1].tolist(), seen.first[1:].tolist(), strict=True)
    return [Path(times[a:b], at[a:b]) for a, b in ends]


def _result(
    stated: Sequence[Camera],
    cameras: Sequence[Camera],
    done: Adjusted,
    seen: Observations,
    clocks: Clocks,
    used: Bools,
    covariance: Floats,
    frame: Floats,
    center: complex,
    mean_height: float,
    undetermined: Sequence[tuple[str, ...]],
) -> Calibrated:
    """Assemble the result of an adjustment, with cameras in world coordinates; without paths.

    Args:
        stated: C cameras as stated; those that were not adjusted are returned so.
        cameras: C calibrated cameras.
        done: result of the adjustment.
        seen: its observations.
        clocks: clocks of the cameras.
        used: (C,) mask of cameras that were adjusted.
        covariance: (C 13, C 13) of the parameters of all cameras, each in the order of `CameraResult.sigma`.
        frame: (4,) standard deviations common to all cameras: x, y, yaw [rad], scale [1].
        center: position x + i y about which these are.
        mean_height: mean height of people.
        undetermined: for each camera, names of parameters that the data hardly narrow.
    """
    own = np.flatnonzero(used)
    # Offsets at the begin, as a scene states them
    since = clocks.origin - float(seen.stamps.min())
    late = clocks.late - _middle(clocks.late[own]) - clocks.drift * since
    results = []
    size = np.abs(done.residual)
    for c in range(len(stated)):
        mine = seen.camera == c
        count = int(np.count_nonzero(mine))
        if not used[c] or not count:
            results.append(CameraResult(stated[c], False, np.full(PARAMETERS, np.nan), 0.0, 0.0, 0, float("nan")))
            continue
        part = covariance[c * PARAMETERS : (c + 1) * PARAMETERS, c * PARAMETERS : (c + 1) * PARAMETERS]
        variance = np.diag(part).copy()
        variance[LATE] += since**2 * part[DRIFT, DRIFT] - 2.0 * since * part[LATE, DRIFT]
        sigma = np.sqrt(np.maximum(variance, 0.0))
        rms = float(1.4826 * np.nanmedian(size[mine]))
        results.append(
            CameraResult(
                cameras[c], True, sigma, float(late[c]), float(1e6 * clocks.drift[c]), count, rms, undetermined[c]
            )
        )
    return Calibrated(
        results, len(seen.first) - 1, mean_height, frame, center, covariance, done.correlation, done.converged, seen,
        done.residual, [],
    )  # fmt: skip


def _inner(
    covariance: Floats, cameras: Sequence[Camera], own: Ints, scale: float, turned: Floats, *, scaled: bool
) -> Floats:
    """(C 13, C 13) covariance relative to the common similarity transform of all cameras.

    S-transformation (Baarda 1973): mean x, y, yaw and scale of the camera positions are held fixed.

    Args:
        covariance: (C 13, C 13) in the frame of the adjustment.
        cameras: C cameras in the world.
        own: indices of those that were adjusted.
        scale: of the world over that of the adjustment.
        turned: (3, 3) rotation to the world.
        scaled: the scale is determined, and is not common to all.
    """
    C = len(cameras)
    J = np.zeros((C * PARAMETERS, C * PARAMETERS))
    G, D = np.zeros((C * PARAMETERS, 4)), np.zeros(C * PARAMETERS)
    mean = np.mean([cameras[c].position for c in own], axis=0) * [1.0, 1.0, 0.0]
    for c in own.tolist():
        k = c * PARAMETERS
        J[k : k + PARAMETERS, k : k + PARAMETERS] = np.eye(PARAMETERS)
        J[k + 3 : k + 6, k + 3 : k + 6] = scale * turned
        away = cameras[c].position - mean
        G[k + 3, 0] = G[k + 4, 1] = 1.0
        G[k : k + 3, 2] = cameras[c].rotation.T @ [0.0, 0.0, 1.0]
        G[k + 3 : k + 6, 2] = [-away[1], away[0], 0.0]
        G[k + 3 : k + 6, 3] = 0.0 if scaled else away
        D[k + 3 : k + 5] = 1.0
    world = J @ covariance @ J.T
    P = np.eye(len(D)) - G @ np.linalg.pinv(G.T @ (D[:, None] * G)) @ (G.T * D)
    return np.asarray(P @ world @ P.T)
