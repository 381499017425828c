"""Bearings to tracks by a method with one state for all targets, with cameras that are asked when it matters.

Bearings to tracks by a method with one state for all labelled objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError, UsageError, option
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Cooperation, Hulls, Occluders
from occlog.scans.grouping import scans_of, sensor_names
from occlog.track.backward_smoother import BackwardSmoother, backward_smoother
from occlog.track.interface import Config, Joint, JointMethod, State
from occlog.track.methods.imm import camera_requests as when_to_ask
from occlog.track.methods.imm.camera_requests import CameraRequest, CameraRequests
from occlog.track.methods.imm.config import ImmConfig
from occlog.track.methods.imm.filter import ArrayScans, ImmState, ImmStepResult

from .rows import ROWS_PER_CHUNK, EstimateRow, TrackChunk, tables
from .tracking import TrackingTask


def track_joint(
    bearings: Iterable[Bearings],
    scene: Scene,
    method: Joint[ImmState, ImmConfig, ImmStepResult],
    tracking: TrackingTask[ImmConfig],
) -> Iterator[TrackChunk]:
    """Generate the tracks of all targets that microphone arrays hear, by method `imm`, chunk by chunk.

    Rows of cameras are used only when the method requests them (cooperation).  There is a row for each confirmed target
    and time at which an array listened, whether or not it heard something.

    Args:
        bearings: chunks in the order of time.
        scene: scene with the sensors.
        method: the method, with one state for all targets.
        tracking: settings of the method and choice of rows.

    Raises:
        InputError: no rows of arrays.
        UsageError: cooperation in a scene, or with sensors, without two cameras that have a pose.
    """
    config, use, names = tracking.config, tracking.rows(scene), sensor_names(scene)
    asking = config.policies - {"none"}
    seeing = [c for c in scene.cameras if c.placed and c.name in use.sensors]
    if asking and len(seeing) < 2:
        raise UsageError(
            f"{option('cooperate')} {','.join(sorted(asking))} requires two cameras with a pose; "
            f"{len(seeing)} in use have one: calibrate or add cameras, or leave it out",
            id="too-few-sensors",
        )
    rng, helping = generator(tracking.seed, RandomStream.TRACK, 0), generator(tracking.seed, RandomStream.COOPERATE, 0)
    state, memory = method.init(scene, config, rng), when_to_ask.RequestMemory()
    listener, cameras = ArrayScans(scene, config.max_coasting_s), CameraRequests(scene, config)
    later: BackwardSmoother[tuple[ImmState, int], ImmConfig, EstimateRow] | None
    later = backward_smoother(method.smoothing, config, tracking.seed)
    rows: list[EstimateRow] = []
    requests: list[tuple[int, CameraRequest]] = []
    heard, reported, offered = False, 0, 0  # frames offered up to the last chunk, and up to the last row
    for scan in scans_of(bearings, scene, use, tracking.window_ns):
        cameras.put(scan)
        heard = heard or bool((scan.sensor >= len(scene.cameras)).any())
        for sounds in listener.scans(scan):
            # Step: take in what arrays heard, or that they heard nothing
            state, report = method.step(state, sounds, rng)
            # Cooperate: ask cameras where targets are, and take in their answers ([Lee] Sec. 3.3)
            if asking:
                asked, memory = when_to_ask.requests_after_scan(state, report, memory, helping)
                answered = cameras.ask(asked, when_to_ask.other_targets(state, report, asked), sounds.t_ns)
                requests += [(sounds.t_ns, r) for r in answered]
                answers = [r.answer for r in answered]
                state, report, memory = when_to_ask.apply_answer(state, report, answers, memory, helping)
            # Estimate
            for target, estimate in method.estimates(report, scene):
                row = EstimateRow(target, sounds.t_ns, estimate, cameras.offered - offered + estimate.n_observing)
                if later is None:
                    rows.append(row)
                else:
                    later.add(row, (state, target))
            offered = cameras.offered
            # Smooth: rows that have seen enough of what comes after them
            if later is not None:
                rows += later.settled(sounds.t_ns)
        if len(rows) + len(requests) >= ROWS_PER_CHUNK:
            yield _tracked(rows, requests, cameras.offered - reported, names)
            rows, requests, reported = [], [], cameras.offered
    if not heard:
        raise InputError(
            "bearings: no row is of a microphone array of the scene, which this method needs; give directions of "
            "arrival (doa), or use method apf for bearings of cameras",
            id="too-few-sensors",
        )
    if later is not None:
        rows += later.rest()
    yield _tracked(rows, requests, cameras.offered - reported, names)


def _tracked(
    rows: list[EstimateRow], requests: list[tuple[int, CameraRequest]], offered: int, names: tuple[str, ...]
) -> TrackChunk:
    """Return estimates and camera requests as output tables.

    `requests` are (time [ns], request), `offered` is the number of camera frames that could have been requested,
    `names` are the sensors' names by index.
    """
    return tables(rows, names)._replace(cooperation=cooperation_of(requests), offered=offered)


def cooperation_of(requests: list[tuple[int, CameraRequest]]) -> Cooperation:
    """Return table `cooperation` of camera requests, given as (time [ns], request), sorted by time and target."""
    ordered = sorted(requests, key=lambda r: (r[0], r[1].answer.ask.number))
    if not ordered:
        return Cooperation.empty()
    nothing = np.full(2, np.nan)
    xy = np.array([nothing if r.answer.position is None else r.answer.position for _, r in ordered])
    none = np.full((2, 2), np.nan)
    cov = np.array([none if r.answer.covariance is None else r.answer.covariance for _, r in ordered])
    return Cooperation.of(
        t_ns=np.array([t for t, _ in ordered], dtype=np.int64),
        target_id=np.array([r.answer.ask.number for _, r in ordered], dtype=np.int32),
        cause=np.array([",".join(r.answer.ask.causes) for _, r in ordered], dtype=np.str_),
        cameras=np.array([",".join(r.cameras) for _, r in ordered], dtype=np.str_),
        frames=np.array([r.frames for _, r in ordered], dtype=np.int32),
        answered=np.array([r.answer.position is not None for _, r in ordered], dtype=np.bool_),
        x=xy[:, 0],
        y=xy[:, 1],
        cov_xx=cov[:, 0, 0],
        cov_xy=cov[:, 0, 1],
        cov_yy=cov[:, 1, 1],
    )


def track_joint_objects(
    bearings: Iterable[Bearings],
    scene: Scene,
    method: JointMethod[State, Config],
    tracking: TrackingTask[Config],
    occluders: Iterable[Occluders] | Iterable[Hulls] | None,
) -> Iterator[TrackChunk]:
    """Generate the tracks of all labelled objects by a method with one state for all of them, chunk by chunk.

    Candidates without a label are omitted.

    Args:
        bearings: chunks in the order of time.
        scene: scene with the sensors.
        method: the method that `tracking` names.
        tracking: settings of the method and choice of rows.
        occluders: must be None.

    Raises:
        UsageError: priors of occluders, or a selection of cameras.
    """
    if occluders is not None:
        raise UsageError(
            f"{option('occluders')}: method {tracking.method} tracks the people who hide others "
            "itself; leave occluders out",
            id="not-applicable",
        )
    if tracking.selection is not None:
        raise UsageError(
            f"{option('select')}: method {tracking.method} cannot predict where one target will be; leave select out",
            id="not-applicable",
        )
    names, rng = sensor_names(scene), generator(tracking.seed, RandomStream.TRACK, 0)
    state, rows = method.init(scene, tracking.config, rng), list[EstimateRow]()
    later: BackwardSmoother[tuple[State, int], Config, EstimateRow] | None
    later = backward_smoother(method.smoothing, tracking.config, tracking.seed)
    for scan in scans_of(bearings, scene, tracking.rows(scene), tracking.window_ns):
        offered = len(np.unique(scan.sensor))
        state, estimates = method.step(state, scan.take(scan.labelled), rng)
        for target, estimate in estimates:
            row = EstimateRow(target, scan.t_ns, estimate, offered)
            if later is None:
                rows.append(row)
            else:
                later.add(row, (state, target))
        # Smooth: rows that have seen enough of what comes after them
        if later is not None:
            rows += later.settled(scan.t_ns)
        if len(rows) >= ROWS_PER_CHUNK:
            yield tables(rows, names)
            rows = []
    if later is not None:
        rows += later.rest()
    if rows:
        yield tables(rows, names)
