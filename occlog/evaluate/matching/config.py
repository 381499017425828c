"""Settings of `occlog evaluate`, and the kinds of input that they are for."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import METRES, Settings, setting

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
    """Settings of `evaluate`; lengths in the scene's unit.

    The motion of the bound: `waypoint` is a walk with noise `sigma_v` with known drift
    ([Ercan] Eq. 5 with known destination and speed); `cv` is a constant velocity
    disturbed by white acceleration, not known in advance.
    """

    OWNER: ClassVar[str] = "evaluate"

    max_gap_s: float | None = setting(
        None,
        "Interpolate between samples at most this far apart; nothing is extrapolated.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--max-gap",
        metavar="SECONDS",
        nothing="1.5 times the usual time between a target's true rows, 0.2 s at least and 1 s at most; for tracks 1 s",
        kinds=(AZIMUTHS, *WORLD),
    )
    match: str = setting(
        "id",
        "Tracks to true targets: by equal numbers, or so that the overall RMSE is least.",
        choices=("id", "optimal"),
        option="--match",
        shown="id; optimal for tracks whose numbers are the tracker's own",
        kinds=(GROUND,),
    )
    skip_s: float = setting(
        0.0,
        "Give `settled_` figures too, without this much after each target's first estimate.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--skip-seconds",
        metavar="SECONDS",
        kinds=(GROUND,),
    )
    from_ns: int | None = setting(
        None,
        "Give `settled_` figures too, from this time on [ns since 1970].",
        option="--from",
        metavar="T_NS",
        nothing="the first estimate",
        kinds=(GROUND,),
    )
    gate_sigma: float = setting(
        4.0,
        "A bearing this many standard deviations from the truth is still of the target.",
        above=0,
        option="--gate-sigma",
        kinds=WORLD,
    )
    gate_px: float | None = setting(
        None,
        "The same in pixels, for cameras, instead of --gate-sigma.",
        above=0,
        option="--gate-px",
        metavar="PX",
        kinds=WORLD,
    )
    occluder_diameter: float | None = setting(
        None,
        "Moving objects of the truth hide what is behind them.",
        above=0,
        option="--occluder-diameter",
        metavar="LENGTH",
        nothing="that of `simulate` if it made the truth, else they hide nothing",
        kinds=WORLD,
    )
    motion: str = setting(
        "waypoint",
        "Motion of the bound: a walk whose drift is known, or constant velocity with noise.",
        choices=("waypoint", "cv"),
        option="--motion",
        kinds=WORLD,
    )
    sigma_v: float | None = setting(
        None,
        "Noise of the walk, per axis, after 1 s.",
        unit="length",
        at_least=0,
        people={unit: 0.05 / metres for unit, metres in METRES.items()},
        own=0.33,
        option="--sigma-v",
        metavar="LENGTH",
        shown="that of `simulate` if it made the truth, else 0.05 m, or 0.33 in units of its own",
        kinds=WORLD,
    )
    acceleration_density: float = setting(
        1.0,
        "Of --motion cv.",
        unit="length^2/s^3",
        at_least=0,
        option="--acceleration-density",
        kinds=WORLD,
    )
    sigma_speed: float = setting(
        1.5,
        "Prior of each velocity component, --motion cv.",
        unit="length/s",
        above=0,
        option="--sigma-speed",
        kinds=WORLD,
    )
    prior_cov: tuple[float, float, float] | None = setting(
        None,
        "Covariance of the position at the first look.",
        counts=(3,),
        apart=True,
        option="--prior",
        metavar="XX XY YY",
        nothing="anywhere in the room",
        kinds=WORLD,
    )
    prior_z: float | None = setting(
        None,
        "Variance of the height at the first look, for a bound in space.",
        above=0,
        option="--prior-z",
        metavar="ZZ",
        nothing="anywhere below the room's ceiling",
        kinds=WORLD,
    )
    bound_in: str = setting(
        "auto",
        "Bound of (x, y) from azimuths, or of (x, y, z) from elevations too; auto: in space for "
        "targets whose track and truth have heights.",
        choices=("auto", "ground", "space"),
        option="--bound-in",
        kinds=WORLD,
    )
    held_out: tuple[str, ...] = setting(
        (),
        "Predict this sensor (its bearings, or everybody's boxes of --views) from tracks made without it; may be "
        "repeated.",
        repeat=True,
        option="--held-out",
        metavar="SENSOR",
        shown="none",
        kinds=WORLD,
    )
    held_out_gate: float = setting(
        0.05,
        "A bearing this near to the prediction counts as predicted.",
        above=0,
        scale=1e-3,
        option="--held-out-gate-mrad",
        kinds=WORLD,
    )
    held_out_gate_px: float = setting(
        100.0,
        "A box this near to where a track is expected counts as predicted, everybody's.",
        unit="px",
        above=0,
        option="--held-out-gate-px",
        metavar="PX",
        kinds=WORLD,
    )
    lines_min_sensors: int = setting(
        2,
        "Sight lines that must meet for a scan to be compared with the track.",
        at_least=2,
        option="--lines-min-sensors",
        kinds=WORLD,
    )
    lines_window_s: float = setting(
        0.0,
        "Looks this close together in time make one scan.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--lines-window",
        metavar="SECONDS",
        shown="equal times",
        kinds=WORLD,
    )
    lines_loss: str = setting(
        "huber",
        "How lines that miss the others count.",
        choices=("gauss", "huber", "cauchy"),
        option="--lines-loss",
        kinds=WORLD,
    )
    lines_limit: float | None = setting(
        None,
        "Give the share of scans in which the track is this near to the meeting point.",
        above=0,
        option="--lines-limit",
        metavar="LENGTH",
        kinds=WORLD,
    )
    lines_min_crossing: float = setting(
        math.radians(5.0),
        "Refuse scans whose lines cross at smaller angles.",
        at_least=0,
        scale=math.radians(1.0),
        option="--lines-crossing-deg",
        metavar="DEGREES",
        kinds=WORLD,
    )
    box_overlap: float = setting(
        0.5,
        "Intersection over union from which a view or a track is of a true box.",
        above=0,
        at_most=1,
        option="--box-overlap",
        kinds=(IMAGES, *WORLD),
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """The prior must be a covariance."""
        if self.prior_cov is not None:
            xx, xy, yy = self.prior_cov
            yield "prior_cov", xx > 0 and xx * yy > xy**2, "xx, xy, yy of a positive covariance"

    @property
    def limit_ns(self) -> int | None:
        """Widest gap of the truth that is bridged [ns]; None: by the usual time between its rows."""
        return None if self.max_gap_s is None else round(self.max_gap_s * 1e9)

    @property
    def bridge_s(self) -> float:
        """Widest gap of tracks, and of true directions, that is bridged [s]."""
        return BRIDGE_S if self.max_gap_s is None else self.max_gap_s

    @property
    def bridge_ns(self) -> int:
        """Largest gap to interpolate [ns]."""
        return round(self.bridge_s * 1e9)
