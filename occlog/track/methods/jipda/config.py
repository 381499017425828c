"""Settings of method `jipda`; one set of defaults for all scenes, frame rates and numbers of cameras."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import setting
from occlog.track.smoothing_and_lag import LagConfig


@dataclass(frozen=True)
class JipdaConfig(LagConfig):
    """Settings of method `jipda`; lengths in the scene's unit, times in seconds.

    They concern body sizes, motion, box noise, detection and existence probabilities; each field has its help and
    range.
    """

    OWNER: ClassVar[str] = "jipda"

    # Bodies
    person_height: float = setting(
        1.7,
        "Mean height of people; sets the expected box height. A wrong value shifts positions along the line of "
        "sight. Typical 1.7 m for adults, 1.2 m for children.",
        unit="length",
        above=0,
    )
    sigma_person_height: float = setting(
        0.12,
        "Standard deviation of the height among people. Larger values rely less on box heights for the distance; "
        "raise it where adults and children mix.",
        unit="length",
        above=0,
    )
    person_width: float = setting(
        0.55,
        "Mean diameter of the vertical cylinder that models a person; sets the expected box width.",
        unit="length",
        above=0,
    )
    sigma_person_width: float = setting(
        0.12,
        "Standard deviation of the diameter among people and poses. Larger values accept wider boxes (bags, spread "
        "arms).",
        unit="length",
        above=0,
    )

    exclusion_radius: float = setting(
        0.22,
        "Exclusion radius s: the density of two people at distance d is multiplied by 1 - exp(-d^2 / (2 s^2)). "
        "Larger values keep close tracks distinct and increase their distance; 0: no exclusion.",
        unit="length",
        at_least=0,
    )

    # Motion
    process_noise_density: float = setting(
        0.06,
        "Process noise while walking straight: spectral density of white acceleration per axis. Larger values "
        "follow turns faster; smaller values coast straighter through occlusions.",
        unit="length^2/s^3",
        at_least=0,
    )
    manoeuvre_noise_density: float = setting(
        1.0,
        "Process noise during a manoeuvre (turning, stopping, starting): spectral density per axis. Larger values "
        "follow abrupt motion and widen the gate.",
        unit="length^2/s^3",
        at_least=0,
    )
    manoeuvre_interval_s: float = setting(
        20.0,
        "Initial mean time between manoeuvres of a person; adapted online. Smaller values switch to the manoeuvre "
        "model more readily.",
        unit="s",
        above=0,
    )
    manoeuvre_duration_s: float = setting(
        1.0, "Mean duration of a manoeuvre. Longer values keep the large process noise for longer.", unit="s", above=0
    )
    posture_change_interval_s: float = setting(
        6000.0,
        "Initial mean time between posture changes (bending, falling, lying down, getting up); adapted online. "
        "Lower it where people sit down or exercise.",
        unit="s",
        above=0,
    )
    posture_change_duration_s: float = setting(2.0, "Mean duration of a posture change.", unit="s", above=0)
    sigma_initial_velocity: float = setting(
        0.9,
        "Standard deviation of the velocity of a new track, per axis. Too small a value loses fast arrivals in the "
        "second frame. Typical 0.9 m/s walking, 3 m/s running.",
        unit="length/s",
        above=0,
    )

    # Boxes
    edge_noise_px: float = setting(
        3.0,
        "Measurement noise: standard deviation of a box edge (initial value, adapted online). Larger values trust "
        "boxes less and smooth more. Typical 2 to 5 px.",
        unit="px",
        above=0,
    )
    relative_edge_noise: float = setting(
        0.04,
        "Measurement noise in proportion to the box: standard deviation of its position and size as a share of its "
        "size. Raise it for detectors with loose boxes.",
        at_least=0,
    )

    # Positions on the ground
    position_sigma: float = setting(
        0.1,
        "Initial standard deviation, per axis, of positions on the ground that state none; adapted online. Larger "
        "values trust positions less at first. Typical 0.1 m for ground-plane networks and lidar, 0.3 m for radar.",
        unit="length",
        above=0,
    )

    # Detection
    detection_probability: float = setting(
        0.8,
        "Initial detection probability of an unoccluded person per camera and frame; adapted online. Too high a "
        "value terminates tracks after few missed detections.",
        above=0,
        below=1,
    )
    clutter_rate: float = setting(
        0.5,
        "Initial clutter rate: false detections (false alarms) expected per camera and frame; adapted online. "
        "Larger values make track initiation more cautious.",
        above=0,
    )
    use_visibility: bool = setting(
        True,
        "Use the expected visibility as a factor of the detection probability. Off: occlusions count as missed "
        "detections and end the tracks of occluded people.",
    )

    # Existence
    mean_dwell_s: float = setting(
        60.0,
        "Initial mean time that a person stays in view of the cameras; adapted online. Larger values keep unseen "
        "tracks longer and risk identity switches.",
        unit="s",
        above=0,
    )
    confirmation_threshold: float = setting(
        0.8,
        "Existence probability above which a track is confirmed and reported. Higher values suppress false tracks "
        "and delay true ones.",
        above=0,
        below=1,
    )
    termination_threshold: float = setting(
        0.01,
        "Existence probability below which a track is terminated. Lower values keep tracks through longer "
        "occlusions and risk identity switches.",
        above=0,
        below=1,
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate the checks that involve two settings: (name, is fulfilled, requirement as text).

        There is one: `termination_threshold` must be below `confirmation_threshold`.
        """
        yield (
            "termination_threshold",
            self.termination_threshold < self.confirmation_threshold,
            "below confirmation_threshold",
        )
