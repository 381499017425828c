"""A reader, a metric and an exporter of one's own for occlog."""

from dataclasses import dataclass

import numpy as np

from occlog.plugins.interface import Settings, setting


@dataclass(frozen=True)
class CompassSettings(Settings):
    OWNER = "compass"
    sigma_deg: float = setting(2.0, "Error of the compass.", unit="deg", above=0.0)


class CompassLog:
    summary = "log of a hand compass: lines of time [s], station, degrees clockwise from +y"
    settings, endings, table = CompassSettings, (".compass",), "bearings"

    def __init__(self, settings):
        self.sigma = settings.sigma_deg

    def read(self, path):
        rows = []
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            try:
                time, station, angle = line.split()
                rows.append((float(time), station, 90.0 - float(angle)))
            except ValueError:
                raise ValueError(f"line {number}: {line[:30]!r}; want a time, a station and an angle") from None
        time, station, angle = zip(*rows, strict=True) if rows else ((), (), ())
        rest = {"sigma_deg": np.full(len(rows), self.sigma), "id": np.zeros(len(rows), int)}
        return {"time_s": time, "sensor": station, "bearing_deg": angle, **rest}


class Gaps:
    summary = "times without an estimate of a track"
    settings, units = Settings, {"longest": "s", "tracks": "1"}

    def __init__(self, settings):
        pass

    def figures(self, compared):
        tracks, longest = compared.tracks, np.nan
        for target in np.unique(tracks.target_id):
            longest = np.fmax(longest, np.diff(tracks.t_ns[tracks.target_id == target]).max(initial=0) * 1e-9)
        return {"longest": longest, "tracks": len(np.unique(tracks.target_id))}


class Gnuplot:
    summary = "gnuplot's blocks of t x y, one a target"
    settings, tables = Settings, ("tracks", "truth")

    def __init__(self, settings):
        pass

    def write(self, rows, world, file):
        for target in np.unique(rows.target_id):
            own = rows.take(rows.target_id == target)
            file.write(f"# target {target}, t [s] x y [{world.length_unit}]\n".encode())
            for t, x, y in zip(own.t_ns, own.x, own.y, strict=True):
                file.write(f"{t // 10**9}.{t % 10**9:09} {x:.6f} {y:.6f}\n".encode())
            file.write(b"\n\n")
