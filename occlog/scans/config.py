"""Settings of measurements other than directions: ranges, signal strengths, time differences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.core.geometry.radio_defaults import EXPONENT, NLOS_BIAS_SIGMAS, NOISE_DB, POWER_DBM, SHADOW_DB, SHADOW_S
from occlog.settings import Settings, option_setting

SPEEDS = {"sound": 343.0, "light": 299_792_458.0}
"""Speeds of propagation [m/s]; of sound in air of 20 degrees Celsius."""


@dataclass(frozen=True)
class DistanceMeasurementConfig(Settings):
    """Settings of ranges, signal strengths and time differences: what the table of measurements does not state."""

    OWNER: ClassVar[str] = "measurements"

    propagation_speed: str | None = option_setting(
        None,
        "Speed of propagation, to convert time differences to lengths: sound (343 m/s), light, or metres per second.",
        metavar="sound|light|SPEED",
        nothing="time differences are refused",
    )
    tag_height: float | None = option_setting(
        None,
        "Height of the tags or targets that stations measure, above z = 0.",
        unit="length",
        nothing="that of the path loss model; else stations must have z = 0",
    )
    sigma_range: float | None = option_setting(
        None,
        "Measurement noise of ranges that do not state their own (standard deviation).",
        unit="length",
        above=0,
        nothing="each range must state its own",
    )
    sigma_range_difference: float | None = option_setting(
        None,
        "Measurement noise of range differences and time differences that do not state their own (standard deviation "
        "as a length).",
        unit="length",
        above=0,
        nothing="each must state its own",
    )
    sigma_rssi: float | None = option_setting(
        None,
        "Measurement noise of signal strengths that do not state their own, shadowing included (standard deviation "
        "[dB]).",
        above=0,
        nothing=f"from noise and shadowing of --path-loss, or {NOISE_DB:g} and {SHADOW_DB:g} dB with a correlation "
        f"time of {SHADOW_S:g} s: larger, the sooner reads of a station follow each other",
    )
    rssi_power: float = option_setting(
        POWER_DBM, "Received power at 1 m [dBm] of stations for which the scene states none."
    )
    rssi_exponent: float = option_setting(EXPONENT, "Path loss exponent: 2 in free space, 2.5 to 4 indoors.", above=0)
    measured_loss_threshold: float = option_setting(
        3.7,
        "Residual, in standard deviations, at which a range, signal strength or difference is as likely an outlier as "
        "not. Smaller values reject more.",
        above=0,
    )
    nlos_probability: float = option_setting(
        0.05,
        "Share of non-line-of-sight (NLOS) signals, which make a range too long; 0: none. It does not apply to signal "
        "strengths.",
        at_least=0,
        below=1,
    )
    nlos_bias: float | None = option_setting(
        None,
        "Mean NLOS bias: by how much ranges without line of sight are too long.",
        unit="length",
        above=0,
        nothing=f"{NLOS_BIAS_SIGMAS:g} standard deviations of each measurement",
    )

    range_bias: float = option_setting(
        0.0,
        "Prior standard deviation of a constant error of the ranges of each station, which is estimated with the "
        "trajectory (map). Use when a warning says that ranges are too long or too short; 0: none is estimated.",
        unit="length",
        at_least=0,
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text): the speed is a known name or a positive number."""
        yield (
            "propagation_speed",
            self.propagation_speed is None or self.speed is not None,
            "sound, light, or a number above 0",
        )

    @property
    def speed(self) -> float | None:
        """Return the speed of propagation [m/s]; None if not stated or not valid."""
        if self.propagation_speed is None:
            return None
        if self.propagation_speed in SPEEDS:
            return SPEEDS[self.propagation_speed]
        try:
            value = float(self.propagation_speed)
        except ValueError:
            return None
        return value if 0.0 < value < 1e9 else None
