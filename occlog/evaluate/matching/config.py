"""Settings of `occlog evaluate`, and the kinds of input to which they apply."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import METRES, Settings, option_setting, setting

AZIMUTHS, IMAGES, GROUND, OTHERS = "azimuths", "images", "ground", "others"
KINDS = {
    AZIMUTHS: "directions against true ones (--truth-azimuths)",
    IMAGES: "tracks in images (view_tracks, boxes, MOTChallenge text)",
    GROUND: "TRACKS on the ground with --truth",
    OTHERS: "bearings, views, or TRACKS without --truth",
}
"""Kinds of input, in words; the first that fits the input is its kind."""
WORLD = (GROUND, OTHERS)
BRIDGE_S = 1.0
"""Widest gap of tracks that is bridged, and of any truth, unless a width is given [s]."""


@dataclass(frozen=True)
class EvaluateConfig(Settings):
    """Settings of `evaluate`; lengths are in the scene's unit.

    The motion of the bound: `waypoint` is a random walk with noise `process_noise_position` about a known drift
    ([Ercan] Eq. 5 with known destination and speed); `cv` is a constant velocity disturbed by white acceleration, which
    is not known in advance.
    """

    OWNER: ClassVar[str] = "evaluate"

    max_gap_s: float | None = setting(
        None,
        "Maximum gap of truth or tracks to interpolate; nothing is extrapolated.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--max-gap",
        nothing="1.5 times the usual period of the truth of a target, at least 0.2 s and at most 1 s; for tracks 1 s",
        kinds=(AZIMUTHS, *WORLD),
    )
    match: str = option_setting(
        "id",
        "Match tracks to targets over the whole run: by equal identities (`id`), or one-to-one with the least "
        "overall RMSE (`optimal`).",
        choices=("id", "optimal"),
        shown="id; optimal for tracks with the tracker's own numbers",
        kinds=(GROUND,),
    )
    settling_s: float = setting(
        0.0,
        "Settling time: also report `settled_` metrics, which omit this time after the first estimate of each target.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--settling-time",
        kinds=(GROUND,),
    )
    from_ns: int | None = setting(
        None,
        "Also report `settled_` metrics, of estimates from this time on [ns since 1970].",
        option="--from",
        metavar="T_NS",
        nothing="the first estimate",
        kinds=(GROUND,),
    )
    gate_sigma: float = option_setting(
        4.0,
        "Gate: a bearing within this many standard deviations of the truth is a detection of the target.",
        above=0,
        kinds=WORLD,
    )
    gate_px: float | None = option_setting(
        None,
        "Gate for cameras instead of --gate-sigma: largest horizontal distance in the image between a bearing and the "
        "truth [px].",
        above=0,
        metavar="PX",
        kinds=WORLD,
    )
    occluder_diameter: float | None = option_setting(
        None,
        "Diameter of moving objects of the truth, which occlude those behind them, in the scene's unit.",
        above=0,
        metavar="LENGTH",
        nothing="that of `simulate` if it made the truth, else no occlusion",
        kinds=WORLD,
    )
    motion: str = option_setting(
        "waypoint",
        "Motion model of the Cramer-Rao bound: `waypoint`, a walk to known destinations at known speed with position "
        "noise, or `cv`, constant velocity with noise.",
        choices=("waypoint", "cv"),
        kinds=WORLD,
    )
    process_noise_position: float | None = setting(
        None,
        "Process noise of the bound: position noise per axis, accumulated over 1 s (--motion waypoint).",
        unit="length",
        at_least=0,
        people={unit: 0.05 / metres for unit, metres in METRES.items()},
        own=0.33,
        option="--process-noise",
        shown="that of `simulate` if it made the truth, else 0.05 m, or 0.33 in a scene-specific unit",
        kinds=WORLD,
    )
    process_noise_density: float = option_setting(
        1.0,
        "Process noise of the bound: spectral density of white acceleration (--motion cv).",
        unit="length^2/s^3",
        at_least=0,
        kinds=WORLD,
    )
    sigma_initial_velocity: float = option_setting(
        1.5, "Prior standard deviation of each velocity component (--motion cv).", unit="length/s", above=0, kinds=WORLD
    )
    prior_covariance: tuple[float, float, float] | None = setting(
        None,
        "Prior covariance xx, xy, yy of the position at the first observation, for the bound [m^2, or scene unit^2].",
        counts=(3,),
        apart=True,
        option="--prior",
        metavar="XX XY YY",
        nothing="uniform over the room",
        kinds=WORLD,
    )
    prior_variance_z: float | None = setting(
        None,
        "Prior variance of the height at the first observation, for a bound in space [m^2, or scene unit^2].",
        above=0,
        option="--prior-z",
        metavar="ZZ",
        nothing="uniform up to the ceiling of the room",
        kinds=WORLD,
    )
    bound_dimension: str = option_setting(
        "auto",
        "Dimensions of the bound: `ground` (x, y from azimuths) or `space` (x, y, z, from elevations too); auto: "
        "space for targets with heights in track and truth.",
        choices=("auto", "ground", "space"),
        kinds=WORLD,
    )
    held_out: tuple[str, ...] = option_setting(
        (),
        "Predict the bearings of this sensor, or its boxes in --views, from tracks made without it; may be repeated.",
        repeat=True,
        metavar="SENSOR",
        shown="none",
        kinds=WORLD,
    )
    held_out_gate: float = setting(
        0.05,
        "Gate: a held-out bearing within this angle of its prediction from the tracks counts as predicted.",
        above=0,
        scale=1e-3,
        option="--held-out-gate-mrad",
        kinds=WORLD,
    )
    held_out_gate_px: float = option_setting(
        100.0,
        "Gate: a held-out box within this distance of a track projected into the image counts as predicted.",
        unit="px",
        above=0,
        kinds=WORLD,
    )
    triangulation_min_sensors: int = option_setting(
        2,
        "Minimum number of lines of sight in a scan for it to be triangulated and compared with the track.",
        at_least=2,
        kinds=WORLD,
    )
    triangulation_window_s: float = setting(
        0.0,
        "Observations closer together in time than this make one scan.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--triangulation-window",
        shown="equal times",
        kinds=WORLD,
    )
    triangulation_loss: str = option_setting(
        "huber", "Robust loss of the triangulation.", choices=("gauss", "huber", "cauchy"), kinds=WORLD
    )
    triangulation_tolerance: float | None = option_setting(
        None,
        "Also report the share of scans in which the track is within this distance of the triangulated point [m, or "
        "scene unit].",
        above=0,
        metavar="LENGTH",
        kinds=WORLD,
    )
    triangulation_min_angle: float = setting(
        math.radians(5.0),
        "Minimum triangulation angle: scans with lines of sight at smaller angles are refused as ill-conditioned.",
        at_least=0,
        scale=math.radians(1.0),
        option="--triangulation-min-angle-deg",
        metavar="DEGREES",
        kinds=WORLD,
    )
    iou_threshold: float = option_setting(
        0.5,
        "IoU (intersection over union) threshold for matching a view or a track to a true box.",
        above=0,
        at_most=1,
        kinds=(IMAGES, *WORLD),
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate the rule (setting, whether it holds, words) that the prior is a covariance matrix."""
        if self.prior_covariance is not None:
            xx, xy, yy = self.prior_covariance
            yield "prior_covariance", xx > 0 and xx * yy > xy**2, "xx, xy, yy of a positive covariance"

    @property
    def limit_ns(self) -> int | None:
        """Largest gap of the truth that is interpolated [ns]; None: it follows from the usual interval of its rows."""
        return None if self.max_gap_s is None else round(self.max_gap_s * 1e9)

    @property
    def bridge_s(self) -> float:
        """Largest gap of tracks, and of true directions, that is interpolated [s]; 1 s by default."""
        return BRIDGE_S if self.max_gap_s is None else self.max_gap_s

    @property
    def bridge_ns(self) -> int:
        """Largest gap of tracks, and of true directions, that is interpolated [ns]."""
        return round(self.bridge_s * 1e9)
