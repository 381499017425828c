"""Windows of reads to tracks of tags, by virtual sensors or by strength of the signal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.tables import TagTracks, VirtualSensors

from .inputs import Windows
from .rssi import TagFilterModel, TagParticles, begin, step
from .virtual_sensors import ReaderRegions as Regions
from .virtual_sensors import locate

MIN_EFFECTIVE_SAMPLE_SIZE = 10.0
"""Fewer effective particles are too few for a covariance."""
NO_MATCHING_REGION, RESTART, DEPLETED = "no_matching_region", "restart", "depleted"


def track_virtual(
    windows: Iterable[Windows],
    regions: Regions,
    names: Sequence[str],
    thresholds: Floats,
    detection: float,
    stray: float,
) -> Iterator[TagTracks]:
    """Locate each tag in each window by the readers that detect it.

    Args:
        windows: of R readers, in the order of time.
        regions: the virtual sensors.
        names: (R,) of the readers.
        thresholds: (R,) mean strength [dBm] from which a reader counts as one that detects the tag; -inf: every read.
        detection: probability that a reader in range detects a tag.
        stray: probability that a reader out of range does.
    """
    for part in windows:
        detected = (part.count > 0) & (np.where(np.isnan(part.rssi), np.inf, part.rssi) >= thresholds)
        # Nobody detects it: there is no virtual sensor of no reader
        kept = np.asarray(detected.any(axis=1))
        rows, seen = part.take(kept), detected[kept]
        found = locate(regions, seen, detection, stray)
        unknown = np.full((len(rows), 2), np.nan)
        doubt = np.where(found.matched, "", NO_MATCHING_REGION)
        yield _tracks(rows.t_ns, rows.target_id, found.xy, unknown, found.covariance, _names(seen, names), doubt)


def track_rssi(
    windows: Iterable[Windows], rules: TagFilterModel, names: Sequence[str], seed: int
) -> Iterator[TagTracks]:
    """Filter each tag's reads; each tag has its own particles and random numbers.

    Args:
        windows: of R readers, in the order of time.
        rules: model and settings.
        names: (R,) of the readers.
        seed: of all random numbers.
    """
    clouds: dict[int, TagParticles] = {}
    draws: dict[int, np.random.Generator] = {}
    for part in windows:
        xy, velocity = np.zeros((len(part), 2)), np.zeros((len(part), 2))
        covariance, doubt = np.zeros((len(part), 4, 4)), []
        for row in range(len(part)):
            target, t_ns = int(part.target_id[row]), int(part.t_ns[row])
            if target not in clouds:
                draws[target] = generator(seed, RandomStream.TRACK, target)
                clouds[target] = begin(rules, t_ns, draws[target])
            clouds[target], found = step(
                rules, clouds[target], t_ns, part.count[row], part.rssi[row], rng=draws[target]
            )
            xy[row], velocity[row], covariance[row] = found.xy, found.velocity, found.covariance
            reasons = {RESTART: found.restarted, DEPLETED: found.effective < MIN_EFFECTIVE_SAMPLE_SIZE}
            doubt.append(",".join(name for name, holds in reasons.items() if holds))
        yield _tracks(
            part.t_ns, part.target_id, xy, velocity, covariance, _names(part.count > 0, names), np.array(doubt, np.str_)
        )


def region_table(regions: Regions, names: Sequence[str], t_ns: int) -> VirtualSensors:
    """Tabulate virtual sensors.

    Args:
        regions: of R readers.
        names: (R,) of the readers.
        t_ns: time from which they hold.
    """
    return VirtualSensors.of(
        t_ns=np.full(len(regions.area), t_ns, dtype=np.int64),
        readers=_names(regions.members, names),
        count=regions.members.sum(axis=1).astype(np.int32),
        area=regions.area,
        x=regions.centroid[:, 0],
        y=regions.centroid[:, 1],
        cov_xx=regions.covariance[:, 0, 0],
        cov_xy=regions.covariance[:, 0, 1],
        cov_yy=regions.covariance[:, 1, 1],
    ).sorted()


def _names(members: Bools, names: Sequence[str]) -> np.ndarray:
    """(n,) names of the readers of each row of (n, R), separated by commas."""
    known = np.asarray(names, dtype=np.str_)
    return np.array([",".join(known[row].tolist()) for row in members], dtype=np.str_)


def _tracks(
    t_ns: Ints,
    target_id: Ints,
    xy: Floats,
    velocity: Floats,
    covariance: Floats,
    read_by: np.ndarray,
    doubt: np.ndarray,
) -> TagTracks:
    """Tabulate n estimates with covariances (n, 2, 2) of positions, or (n, 4, 4) of positions and velocities."""
    pairs = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1)}
    columns = {f"cov_{name}": covariance[:, i, j] for name, (i, j) in pairs.items()}
    if covariance.shape[1] == 4:
        both = {"x_vx": (0, 2), "x_vy": (0, 3), "y_vx": (1, 2), "y_vy": (1, 3), "vx_vx": (2, 2), "vx_vy": (2, 3)}
        columns |= {f"cov_{name}": covariance[:, i, j] for name, (i, j) in (both | {"vy_vy": (3, 3)}).items()}
    return TagTracks.of(
        t_ns=t_ns,
        target_id=target_id.astype(np.int32),
        x=xy[:, 0],
        y=xy[:, 1],
        vx=velocity[:, 0],
        vy=velocity[:, 1],
        read_by=read_by,
        quality_flags=doubt,
        **columns,
    )
