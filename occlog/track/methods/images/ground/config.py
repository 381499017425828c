"""Settings of `occlog ground`, the way from tracks in images to tracks in the world."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from occlog.settings import METRES, Settings, setting

if TYPE_CHECKING:
    from occlog.records.scene import Scene

HEIGHT_M, HEIGHT_SIGMA_M = 0.9, 0.1
"""Height of the middle of a person, and its standard deviation [m]."""

STARTS = {"detections": 0.2, "both": 0.2}
"""`initial_switch_probability` by where trackers came from, else 0: which detections are of one target was guessed."""


@dataclass(frozen=True)
class GroundConfig(Settings):
    """Settings of `occlog ground`, which triangulates image tracks to world positions; lengths in the scene's unit."""

    OWNER: ClassVar[str] = "ground"

    target_height: float | None = setting(
        None,
        "Height of the centre of a target, to locate one that a single view shows; 0: no row at such times.",
        unit="length",
        at_least=0,
        shown="0.9 m, or 0",
    )
    sigma_target_height: float | None = setting(
        None,
        "Standard deviation of that height. Larger values widen the covariance of positions from a single view.",
        unit="length",
        above=0,
        shown="0.1 m",
    )
    centre_error_share: float = setting(
        0.25,
        "Model error: standard deviation of an ellipse centre from the image of the target's centre, as a share of its "
        "half axes. Larger values widen the covariances.",
        at_least=0,
    )
    false_rejection_probability: float = setting(
        1e-3,
        "Probability of rejecting a view at a time when all views are right (level of the outlier test). Larger "
        "values reject more views.",
        above=0,
        below=1,
    )
    min_triangulation_angle_deg: float = setting(
        5.0,
        "Minimum triangulation angle: lines of sight at smaller angles give no position.",
        unit="deg",
        above=0,
        below=90,
    )
    view_inlier_probability: float = setting(
        0.5,
        "Prior probability that a view is on its target; 1: covariances as if all used views were right.",
        above=0,
        at_most=1,
    )
    common_error_share: float = setting(
        0.1,
        "Model error in the test whether views agree, as a share of the half axes; smaller than "
        "centre_error_share, because trackers slide on a target equally in all views.",
        above=0,
    )
    identity_switch_rate: float = setting(
        0.5,
        "Rate of identity switches where views contradict each other; 0: never.",
        unit="1/s",
        at_least=0,
    )
    single_view_switch_factor: float = setting(
        0.3,
        "Share of that rate where a single view shows a target that several views have shown before.",
        at_least=0,
    )
    initial_switch_probability: float = setting(
        0.0,
        "Probability that the trackers of a target start on different targets.",
        at_least=0,
        below=1,
        shown="0; 0.2 where trackers began from detections",
    )
    window_s: float = setting(
        0.0,
        "Frames closer together in time are one time step.",
        unit="s",
        at_least=0,
        option="--window",
        shown="as when they were tracked",
    )


def in_scene(config: GroundConfig, scene: Scene) -> GroundConfig:
    """Return the settings with the height prior filled in where it is None, in the scene's length unit.

    The target height defaults to 0.9 m and its standard deviation to 0.1 m, converted to that unit. In an unknown unit
    the height is 0 (no positions from single views) and the deviation 1, or a tenth of a height that was given.
    """
    metre = 1.0 / METRES[scene.length_unit] if scene.length_unit in METRES else None
    height, sigma = config.target_height, config.sigma_target_height
    if height is None:
        height = 0.0 if metre is None else HEIGHT_M * metre
    if sigma is None:
        sigma = (0.1 * height or 1.0) if metre is None else HEIGHT_SIGMA_M * metre
    return replace(config, target_height=height, sigma_target_height=sigma)
