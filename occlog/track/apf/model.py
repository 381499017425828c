"""Scene and settings of method `apf` in the form of the kernels, and the likelihood of places under them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.occlusion.priors import Priors
from occlog.core.plane.floor import Floor, make_floor, on_floor
from occlog.core.sight.view_prior import ViewPrior
from occlog.core.sight.visibility import Sensors
from occlog.filtering.likelihood import distances
from occlog.filtering.likelihood.among_occluders import EXACT, INDEPENDENT, RECURSION, Occlusion, log_likelihood_among
from occlog.filtering.likelihood.directions import Detection, Noise, PackedScan, log_likelihood
from occlog.filtering.likelihood.distances import Distances
from occlog.filtering.motion.waypoint import WaypointModel
from occlog.records.scene import Scene

from .config import FORMS, ApfConfig
from .first_places import wander
from .kernels import importance
from .sensing import pack_detection, pack_noise, pack_sensors, read_noise

FINE, ROUGH = 5.5, 3.5
"""Standard deviations at which a prior of an occluder counts as over; stage 1 only has to be near."""


class Model(NamedTuple):
    """Scene and settings in the form of the kernels; priors of moving occluders are those of one scan."""

    config: ApfConfig
    floor: Floor
    sensors: Sensors
    noise: Noise
    read_px: Floats
    motion: WaypointModel
    detection: Detection
    informed: Detection  # the same where there are priors of the moving occluders
    occlusion: Occlusion  # how priors of the moving occluders count
    views: ViewPrior | None = None  # where a target can be without a room; None: all over the floor
    wander: float = math.inf  # how far a new destination is, without a room
    priors: Priors | None = None  # those at the time of the scan
    measured: Distances | None = None  # ranges and their like at the time of the scan


def make_model(scene: Scene, config: ApfConfig) -> Model:
    """The model before the first scan."""
    return Model(
        config=config,
        floor=make_floor(scene.region, [o.polygon for o in scene.occluders]),
        sensors=pack_sensors(scene),
        noise=pack_noise(scene),
        read_px=read_noise(scene),
        motion=motion_of(config),
        detection=pack_detection(scene, config, informed=False),
        informed=pack_detection(scene, config, informed=True),
        occlusion=occlusion_of(config),
        views=scene.views,
        wander=math.inf if scene.views is None else wander(scene, config.speed),
    )


def motion_of(config: ApfConfig) -> WaypointModel:
    """The motion model's part of the settings."""
    return WaypointModel(
        reference_s=config.reference_s,
        sigma=config.sigma_v,
        phi=config.phi,
        towards=config.beta1,
        change=config.lambda1,
        towards_reached=config.beta2,
        change_reached=config.lambda2,
        sigma_velocity=config.sigma_a,
        sigma_waiting=config.sigma_w,
        wait_s=config.wait_s,
        sigma_creep=config.sigma_c,
    )


def occlusion_of(config: ApfConfig) -> Occlusion:
    """How priors of moving occluders count."""
    kind = {"independent": INDEPENDENT, "recursion": RECURSION, "exact": EXACT}[config.likelihood]
    return Occlusion(kind, FORMS.index(config.q), config.p_floor, far=0.0, temper=config.temper)


def likelihood(model: Model, xy: Floats, looks: PackedScan, far: float = FINE, *, anywhere: bool = False) -> Floats:
    """(L,) log f(Z|u) at (L, 2) places ([Ercan] Eq. 6).

    Args:
        model: scene and settings.
        xy: (L, 2) places.
        looks: the scan.
        far: standard deviations at which a prior of an occluder counts as over.
        anywhere: places that are not on the floor are possible, too.
    """
    free = np.ones(len(xy), dtype=np.bool_) if anywhere else on_floor(xy, *model.floor)
    packed = looks, model.sensors, model.noise, model.detection, free
    if model.priors is None:
        told = np.asarray(log_likelihood(xy, *packed))
    else:
        told = log_likelihood_among(xy, *packed, model.priors, model.occlusion._replace(far=far))
    # Radio and sound go past what hides targets
    return told if model.measured is None else told + distances.log_likelihood(model.measured, xy)


def evidence(model: Model, looks: PackedScan) -> tuple[Ints, Floats]:
    """Looks and measurements of a scan as the importance density takes them; see `kernels.importance.adapt`."""
    rows = importance.measurements(looks, model.sensors, model.noise, model.detection)
    if model.measured is None:
        return looks.first, rows
    return importance.with_distances(looks.first, rows, model.measured)
