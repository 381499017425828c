"""Settings of `occlog listen`."""

from __future__ import annotations

from dataclasses import dataclass

from occlog.errors import UsageError

ALGORITHMS = {
    "srp": "SRP",
    "music": "MUSIC",
    "normmusic": "NormMUSIC",
    "cssm": "CSSM",
    "waves": "WAVES",
    "tops": "TOPS",
}
"""By the name that --algorithm takes: classes of pyroomacoustics.doa."""
MOST_POINTS = 200_000


@dataclass(frozen=True)
class ListenConfig:
    """Settings; times in seconds, angles in degrees."""

    algorithm: str = "srp"
    low_hz: float = 300.0
    high_hz: float = 4000.0
    frame_s: float = 0.5  # sound that one set of directions is of
    hop_s: float | None = None  # from one frame to the next; None: the frame's length
    window_s: float = 0.04  # of one spectrum, at least; the next power of two samples is taken
    sources: int = 1  # directions a frame at most; 0: as many as there are peaks
    grid_deg: float | None = None  # step of the directions that are tried; None: from the array's size
    apart_deg: float = 20.0  # directions of one frame are at least this far apart
    peak: float = 0.6  # lower peaks, as a share of the way from the map's median to its highest, are none
    confidence: float = 0.15  # directions with less are left out
    level_db: float = -80.0  # spectra below this level are silence (a full-scale sine: 0 dB)
    above_db: float | None = None  # the same below this much above the quietest spectrum of the last half minute
    speed_of_sound: float | None = None  # lengths of the scene a second; None: 343 m

    def __post_init__(self) -> None:
        for name in ("low_hz", "high_hz", "frame_s", "hop_s", "window_s", "grid_deg", "speed_of_sound", "above_db"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < 1e9:
                raise UsageError(f"{name} {value:g}: must be above 0 and finite")
        limits = {
            "algorithm": (self.algorithm in ALGORITHMS, "one of " + ", ".join(ALGORITHMS)),
            "high_hz": (self.high_hz > self.low_hz, "above the lower end of the band"),
            "sources": (0 <= self.sources <= 100, "0 to 100"),
            "frame_s": (self.frame_s <= 60.0 and self.window_s <= self.frame_s, "at least the window, at most 60 s"),
            "hop_s": (self.hop_s is None or self.hop_s >= 1e-3, "at least 1 ms"),
            "grid_deg": (self.grid_deg is None or 0.2 <= self.grid_deg <= 30.0, "0.2 to 30"),
            "apart_deg": (0.0 <= self.apart_deg <= 180.0, "0 to 180"),
            "peak": (0.0 <= self.peak <= 1.0, "0 to 1"),
            "confidence": (0.0 <= self.confidence <= 1.0, "0 to 1"),
            "level_db": (-400.0 <= self.level_db <= 400.0, "-400 to 400"),
        }
        for name, (good, limit) in limits.items():
            if not good:
                raise UsageError(f"{name} {getattr(self, name)}: must be {limit}")
        if self.sources == 0 and self.algorithm != "srp":
            raise UsageError(f"--sources auto goes with --algorithm srp, not {self.algorithm}; give a number")
