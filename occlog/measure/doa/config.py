"""Settings of `occlog listen`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting

ALGORITHMS = {
    "srp": "SRP",
    "music": "MUSIC",
    "normmusic": "NormMUSIC",
    "cssm": "CSSM",
    "waves": "WAVES",
    "tops": "TOPS",
}
"""Algorithms by their names in the settings: classes of pyroomacoustics.doa."""


MAX_WINDOW_S = 1.0
"""Sound crosses 343 m in it, more than any array; the time that a frame takes rises with it: 3 s at 48 kHz."""


@dataclass(frozen=True)
class DoaConfig(Settings):
    """Settings of the estimation of directions of arrival; times in seconds, angles in degrees."""

    OWNER: ClassVar[str] = "listen"

    algorithm: str = option_setting(
        "srp",
        "Algorithm of pyroomacoustics that estimates directions; srp is SRP-PHAT.",
        choices=tuple(ALGORITHMS),
    )
    low_hz: float = setting(300.0, "Lower end of the frequency band.", unit="Hz", above=0, below=1e9)
    high_hz: float = setting(4000.0, "Upper end of the frequency band.", unit="Hz", above=0, below=1e9)
    frame_s: float = setting(
        0.5,
        "Length of sound for one set of directions. Longer frames are more accurate and smear moving sources.",
        unit="s",
        above=0,
        at_most=60,
        option="--frame",
    )
    hop_s: float | None = setting(
        None,
        "Time from one frame to the next.",
        unit="s",
        at_least=1e-3,
        below=1e9,
        option="--hop",
        nothing="the frame's length",
    )
    window_s: float = setting(
        0.04,
        "Minimum length of a window of the short-time spectrum; it is rounded up to a power of two samples.",
        unit="s",
        above=0,
        at_most=MAX_WINDOW_S,
        option="--window",
    )
    max_sources: int = setting(1, "Maximum number of directions per frame; 0: all peaks.", at_least=0, at_most=100)
    grid_deg: float | None = setting(
        None,
        "Step of the grid of directions that is searched first.",
        unit="deg",
        at_least=0.2,
        at_most=30,
        option="--grid",
        nothing="1 to 5 deg, from the array's size",
    )
    min_separation_deg: float = setting(
        20.0,
        "Minimum angle between directions of one frame.",
        unit="deg",
        at_least=0,
        at_most=180,
        option="--min-separation",
    )
    min_peak: float = option_setting(
        0.6,
        "Ignore peaks of the spatial spectrum lower than this share of the way from its "
        "median to its maximum. Lower values report more directions and more false alarms.",
        at_least=0,
        at_most=1,
    )
    min_confidence: float = option_setting(
        0.15,
        "Ignore directions with which phases agree less: 1 is one plane wave, 0 noise. Lower values report more "
        "directions and more false alarms.",
        at_least=0,
        at_most=1,
    )
    min_level_db: float = setting(
        -80.0,
        "Sound below this level is silence (a full-scale sine is 0).",
        unit="dB",
        at_least=-400,
        at_most=400,
        option="--min-level",
    )
    min_snr_db: float | None = setting(
        None,
        "Sound must also exceed the quietest level of the last 30 s by this [dB]; for speech in noise.",
        unit="dB",
        above=0,
        below=1e9,
        option="--min-snr",
        nothing="no such limit",
    )
    speed_of_sound: float | None = option_setting(
        None,
        "Speed of sound, in lengths of the scene per second.",
        unit="length/s",
        above=0,
        below=1e9,
        nothing="343 m/s",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Constraints, each as setting, whether it holds, and allowed values.

        On the ends of the band, the window against the frame, and algorithms that need the number of sources.
        """
        yield "high_hz", self.high_hz > self.low_hz, f"above the lower end of the band, {self.low_hz:g}"
        yield "frame_s", self.window_s <= self.frame_s, f"at least the window, {self.window_s:g}"
        found = self.max_sources > 0 or self.algorithm == "srp"
        yield "max_sources", found, f"at least 1 for {self.algorithm}: only srp finds how many there are"
