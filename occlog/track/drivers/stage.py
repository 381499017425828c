"""Bearings to tracks, streaming: the driver for the kind of the method."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import cast

from occlog.consistency.bearings import BearingBuffer
from occlog.consistency.estimates import QualityFlags, SensorDisagreement
from occlog.consistency.labels import MotionCheck, flag_labels
from occlog.errors import UsageError, option
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Hulls, Occluders, Residuals
from occlog.scans.distance_measurements import DistanceMeasurementFeed
from occlog.scans.kernels.label_continuity import WalkingSpeed
from occlog.scans.label_continuity import LabelContinuity
from occlog.track.catalogue import tracker
from occlog.track.interface import AnyMethod, Batch, Config, Joint, JointMethod, Online
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.fix.config import FixConfig
from occlog.track.methods.imm.config import ImmConfig
from occlog.track.methods.kalman.config import EkfConfig, WalkConfig

from .batch import track_batch
from .joint import track_joint, track_joint_objects
from .online import track_online
from .rows import TrackChunk
from .tracking import TrackingTask

LABEL_TIME_CONSTANT_RATIO = 0.7
"""Time constant of the velocity with which labels are followed, over that of the Kalman filters."""


def track(
    bearings: Iterable[Bearings],
    scene: Scene,
    tracking: TrackingTask[Config],
    occluders: Iterable[Occluders] | Iterable[Hulls] | None = None,
    measured: DistanceMeasurementFeed | None = None,
) -> Iterator[TrackChunk]:
    """Generate tracks of all targets, chunk by chunk, in the order of time, with quality flags and residuals.

    Memory does not grow with the length of the input (except for batch methods without a lag). Each labelled target has
    its own filter with its own random numbers, which starts with the target's first row; its track does not depend on
    the others, unless their labels are exchanged (`occlog.scans.label_continuity`). Unlabelled candidates go to every
    filter, but not for a sensor that has a labelled row for that target. If there is no target yet, they start a track
    themselves, numbered by the first of `tracking.targets`, or 0. Methods with one state for all targets associate rows
    themselves.

    Args:
        bearings: chunks in the order of time; where they are cut does not matter.
        scene: the sensors, the room and static occluders.
        tracking: the method, its settings, and which rows to use.
        occluders: priors of moving occluders, in the order of time; None: unknown.
        measured: ranges, signal strengths and time differences; None: missing.  `bearings` may then be empty.

    Raises:
        InputError: bearings that do not fit the scene or each other.
        UsageError: a start (`config.start`) for several targets, or occluders or a selection that the
            method or the scene does not allow; measurements that the method does not take.
    """
    method = tracker(tracking.method)
    takes = isinstance(method, Online | Batch) and method.measured
    if measured is not None and not takes:
        raise UsageError(
            f"{option('measurements')}: method {tracking.method} takes no ranges, signal "
            "strengths or time differences; use apf, ekf, ukf, map or fix",
            id="not-applicable",
        )
    if measured is not None and tracking.selection is not None:
        raise UsageError(
            f"{option('select')}: cameras cannot be selected with ranges, signal strengths or "
            "time differences; leave select or the measurements out",
            id="not-applicable",
        )
    started = not isinstance(method, Joint) and method.started(tracking.config)
    doubts = QualityFlags(
        scene,
        online=not isinstance(method, Batch),
        started=started,
        distances=measured is not None,
        occluders=occluders is not None,
    )
    witness = BearingBuffer(scene, tracking.window_ns, unlabelled=tracking.unlabelled)
    disagreement = SensorDisagreement()
    labels = None
    if not isinstance(method, Joint):
        # Ranges carry the same labels, and cannot be exchanged here
        repair = tracking.repair_labels and measured is None
        labels = label_continuity(scene, tracking, repair=repair)
        bearings = labels.watch(bearings)
    watched = witness.watch(bearings)
    unprotected = isinstance(method, Online) and method.consistent
    if unprotected and labels is not None and tracking.reject_outliers:
        watched = labels.events.consistent(watched)
    motion = motion_check(scene, tracking.config)
    for part in _tracked(watched, scene, method, tracking, occluders, measured):
        tracks, diagnostics = doubts.judged(part.tracks, part.diagnostics)
        part = part._replace(tracks=tracks, diagnostics=diagnostics)
        compared = witness.compare(tracks, diagnostics)
        part = part._replace(stated=witness.stated)
        # A batch method judges its bearings itself
        if not isinstance(method, Batch):
            part = part._replace(diagnostics=disagreement.judged(diagnostics, compared.residuals))
            own = part.residuals
            if own is None:
                own = compared.residuals
            elif not (isinstance(method, Online) and method.judges):
                # The method checked its measurements other than directions
                own = Residuals.merge([compared.residuals, own])
            part = part._replace(residuals=own, frames=compared.frames)
        if labels is not None:
            part = part._replace(diagnostics=flag_labels(part.diagnostics, labels.events), labels=labels.events)
            part = part._replace(outliers_matter=unprotected, motion=motion)
        yield part


def label_continuity(scene: Scene, tracking: TrackingTask[Config], *, repair: bool) -> LabelContinuity:
    """Return the check of a scene whether labels jump from target to target, or two targets exchange them.

    Its motion model is that of the settings if they have one (`WalkConfig`), else that of the Kalman filters. `repair`:
    labels that two targets exchange are exchanged back.
    """
    own = tracking.config
    walk = own if isinstance(own, WalkConfig) else EkfConfig.in_unit(scene.length_unit)
    rate = 1.0 / (LABEL_TIME_CONSTANT_RATIO * walk.velocity_time_constant_s)
    motion = WalkingSpeed(0.5 * walk.rms_speed**2, rate, walk.process_noise_position**2)
    return LabelContinuity(scene, walk.rms_speed, motion, tracking.rows(scene).sensors, repair=repair)


def motion_check(scene: Scene, config: object) -> MotionCheck | None:
    """Return how the noise of a method's motion model compares with that of the label check; None: no comparison.

    `config` are the method's settings. There is no comparison for a method without a motion model of its own, or with
    one that it judges itself.
    """
    if isinstance(config, FixConfig):
        return None
    if isinstance(config, WalkConfig):
        return MotionCheck("rms_speed", 1.0, "warning")
    if isinstance(config, ApfConfig):
        usual = ApfConfig.in_unit(scene.length_unit).process_noise_velocity
        ratio = max(config.process_noise_velocity / usual, 1.0) ** 2 if usual > 0.0 else 1.0
        # Its filter allows for targets that turn at any time; trajectories through its particles less so
        return MotionCheck("process_noise_velocity", ratio, "warning" if config.smoothed else "note")
    return None


def _tracked(
    bearings: Iterable[Bearings],
    scene: Scene,
    method: AnyMethod,
    tracking: TrackingTask[Config],
    occluders: Iterable[Occluders] | Iterable[Hulls] | None,
    measured: DistanceMeasurementFeed | None,
) -> Iterator[TrackChunk]:
    """Generate tracks by the driver for the method's kind: online, batch, or one state for all targets.

    Args:
        bearings: chunks in the order of time.
        scene: scene with the sensors.
        method: the method that `tracking` names.
        tracking: settings of the method and choice of rows.
        occluders: priors of moving occluders; None: unknown.
        measured: ranges, signal strengths and time differences; None: missing.

    Raises:
        UsageError: a selection or occluders that this kind of method does not take.
    """
    if isinstance(method, Online):
        yield from track_online(bearings, scene, method, tracking, occluders, measured)
        return
    if isinstance(method, JointMethod):
        yield from track_joint_objects(bearings, scene, method, tracking, occluders)
        return
    why = "takes all that was recorded at once" if isinstance(method, Batch) else "asks cameras itself (cooperate)"
    if tracking.selection is not None:
        raise UsageError(f"select: method {tracking.method} {why}; leave select out", id="not-applicable")
    if isinstance(method, Batch):
        yield from track_batch(bearings, scene, method, tracking, occluders, measured)
        return
    if occluders is not None:
        raise UsageError(f"occluders: method {tracking.method} {why}; leave occluders out", id="not-applicable")
    # Method imm alone has one state for all targets
    yield from track_joint(bearings, scene, method, cast("TrackingTask[ImmConfig]", tracking))
