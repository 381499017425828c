"""Settings of method `sort`; lengths in heights of the box, so that one set fits every image size and distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class SortConfig(Settings):
    """Settings of method `sort`; lengths in box heights, times in seconds."""

    OWNER: ClassVar[str] = "sort"

    smooth: bool = setting(
        True,
        "Link tracks across gaps and encounters, smooth and interpolate them, with all of the recording (offline). "
        "Without it each row uses earlier boxes only: more identity switches, and less memory.",
        option="--smooth/--no-smooth",
    )

    # Measurements
    sigma_position: float = setting(
        0.055,
        "Standard deviation of the centre of a box, in box heights. Larger values smooth more and associate more "
        "loosely.",
        above=0,
        at_most=1,
    )
    sigma_size: float = setting(
        0.07,
        "Standard deviation of the logarithm of a box's height, and of its ratio of width to height. Larger values "
        "smooth sizes more.",
        above=0,
        at_most=1,
    )

    # Motion
    process_noise_density: float = setting(
        0.04,
        "Process noise: spectral density of white acceleration per axis, in squared box heights per s^3. Larger values "
        "follow turns faster; smaller values coast straighter through occlusions.",
        unit="1/s^3",
        above=0,
    )
    sigma_speed: float = setting(
        0.5,
        "Standard deviation of the speed of a new track per axis, in box heights per second. Raise it for vehicles and "
        "for moving cameras.",
        unit="1/s",
        above=0,
    )

    # Detection
    birth_score: float = option_setting(
        0.4,
        "Minimum confidence of a box that begins a track; boxes of less confidence only continue tracks, as in "
        "ByteTrack. Boxes without a confidence begin tracks. Lower values find more people and more false ones.",
        at_least=0,
        at_most=1,
    )
    detection_probability: float = setting(
        0.92,
        "Prior probability of detection of a person in plain view; it is estimated online, for each visible share of "
        "the person. Larger values end tracks earlier.",
        above=0,
        below=1,
    )
    miss_duration_s: float = setting(
        0.7,
        "Mean duration of a run of misses in plain view. Longer ones keep undetected people longer.",
        unit="s",
        above=0,
    )

    # Existence
    mean_dwell_s: float = setting(
        20.0, "Mean time for which a person stays in view. Shorter times end tracks earlier.", unit="s", above=0
    )
    confirmation_threshold: float = setting(
        0.95,
        "Existence probability from which a track is reported. Larger values give fewer false tracks, and later ones.",
        above=0,
        below=1,
    )
    max_coasting_s: float = setting(
        4.0,
        "Maximum time without a box, after which a track ends. Longer times keep identities through longer occlusions.",
        unit="s",
        above=0,
    )
    min_match_probability: float = setting(
        0.7,
        "A row without a box is written where the person is there, within a third of the width, with this probability. "
        "Larger values write fewer predicted rows.",
        above=0,
        below=1,
    )

    # Smoothing
    max_gap_s: float = setting(
        8.0, "Longest gap that smoothing links across. Longer gaps join more and err more often.", unit="s", above=0
    )
    min_boxes: int = setting(
        3, "With smoothing: minimum number of boxes of a track. Larger values give fewer false tracks.", at_least=1
    )
