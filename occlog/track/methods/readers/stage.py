"""Windows of reads to tracks of tags, by virtual sensors or by strength of the signal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.filtering.gaussian import PosteriorRecord
from occlog.records.tables import TagTracks, VirtualSensors
from occlog.track.backward_smoother import BackwardSmoother, backward_smoother
from occlog.track.interface import SmoothedState, Smoothing
from occlog.track.smoothing_and_lag import LagConfig

from .inputs import Windows
from .rssi import MIN_EFFECTIVE_SAMPLE_SIZE, TagFilterModel, TagParticles, begin, smoothed_states, step, trace_of
from .virtual_sensors import ReaderRegions as Regions
from .virtual_sensors import locate

NO_MATCHING_REGION, RESTART, DEPLETED = "no_matching_region", "restart", "depleted"


def track_virtual(
    windows: Iterable[Windows],
    regions: Regions,
    names: Sequence[str],
    thresholds: Floats,
    detection: float,
    stray: float,
) -> Iterator[TagTracks]:
    """Generate tracks of tags by virtual sensors: a position for each window by the readers that detect the tag.

    Windows in which no reader detects the tag have no row.

    Args:
        windows: windows of R readers' reads, in the order of time.
        regions: the virtual sensors.
        names: (R,) names of the readers.
        thresholds: (R,) mean strength [dBm] from which a reader counts as one that detects the tag; -inf: every read.
        detection: probability that a reader in range detects a tag.
        stray: probability that a reader out of range does.
    """
    for part in windows:
        detected = (part.count > 0) & (np.where(np.isnan(part.rssi), np.inf, part.rssi) >= thresholds)
        # No reader detects it, so there is no virtual sensor
        kept = np.asarray(detected.any(axis=1))
        rows, seen = part.take(kept), detected[kept]
        found = locate(regions, seen, detection, stray)
        unknown = np.full((len(rows), 2), np.nan)
        doubt = np.where(found.matched, "", NO_MATCHING_REGION)
        yield _tracks(rows.t_ns, rows.target_id, found.xy, unknown, found.covariance, _names(seen, names), doubt)


class TagRow(NamedTuple):
    """Estimate of one tag in one window of reads, and the readers that read it."""

    target: int
    t_ns: int
    state: SmoothedState  # covariance (4, 4); of the filter until it is smoothed
    read: Bools  # (R,) readers that read the tag
    doubt: str

    def smoothed(self, past: SmoothedState) -> TagRow:
        """Return this row with the smoothed state `past`."""
        return self._replace(state=past)


def track_rssi(
    windows: Iterable[Windows], tag_model: TagFilterModel, names: Sequence[str], seed: int, lag: LagConfig
) -> Iterator[TagTracks]:
    """Generate tracks of tags by particle filters on signal strengths, one for each tag with its own random numbers.

    Args:
        windows: windows of R readers' reads, in the order of time.
        tag_model: constants of the filter.
        names: (R,) names of the readers.
        seed: seed of all random numbers.
        lag: settings of smoothing: whether estimates use later reads.
    """
    clouds: dict[int, TagParticles] = {}
    draws: dict[int, np.random.Generator] = {}
    smoothing: Smoothing[PosteriorRecord, TagFilterModel] = Smoothing(
        wanted=lambda _: lag,
        trace=lambda trace: trace,
        back=lambda traces, own, rng: smoothed_states(own, traces),  # noqa: ARG005
    )
    later: BackwardSmoother[PosteriorRecord, TagFilterModel, TagRow] | None
    later = backward_smoother(smoothing, tag_model, seed)
    for part in windows:
        rows: list[TagRow] = []
        for row in range(len(part)):
            target, t_ns = int(part.target_id[row]), int(part.t_ns[row])
            if target not in clouds:
                draws[target] = generator(seed, RandomStream.TRACK, target)
                clouds[target] = begin(tag_model, t_ns, draws[target])
            before_ns = clouds[target].t_ns
            clouds[target], found = step(
                tag_model, clouds[target], t_ns, part.count[row], part.rssi[row], rng=draws[target]
            )
            reasons = {RESTART: found.restarted, DEPLETED: found.effective < MIN_EFFECTIVE_SAMPLE_SIZE}
            doubt = ",".join(name for name, holds in reasons.items() if holds)
            state = SmoothedState(found.xy, found.velocity, found.covariance)
            own = TagRow(target, t_ns, state, part.count[row] > 0, doubt)
            if later is None:
                rows.append(own)
            else:
                later.add(own, trace_of(tag_model, found, before_ns))
                rows += later.settled(t_ns)
        yield _tag_table(rows, names)
    if later is not None:
        yield _tag_table(later.rest(), names)


def _tag_table(rows: Sequence[TagRow], names: Sequence[str]) -> TagTracks:
    """Return the table of the rows, in their order; `names` (R,) are the readers."""
    return _tracks(
        np.array([row.t_ns for row in rows], dtype=np.int64),
        np.array([row.target for row in rows], dtype=np.int64),
        np.array([row.state.xy for row in rows]).reshape(-1, 2),
        np.array([row.state.velocity for row in rows]).reshape(-1, 2),
        np.array([row.state.covariance for row in rows]).reshape(-1, 4, 4),
        _names(np.array([row.read for row in rows], dtype=np.bool_).reshape(-1, len(names)), names),
        np.array([row.doubt for row in rows], dtype=np.str_),
    )


def region_table(regions: Regions, names: Sequence[str], t_ns: int) -> VirtualSensors:
    """Return the table of virtual sensors.

    Args:
        regions: regions covered by sets of the R readers.
        names: (R,) names of the readers.
        t_ns: time from which they hold [ns].
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
    """Return (n,) comma-separated names of the readers that are True in each row of `members` (n, R).

    `names` (R,) are the readers.
    """
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
    """Return the table of n estimates.

    Args:
        t_ns: (n,) times.
        target_id: (n,) identities of the tags.
        xy: (n, 2) estimated positions.
        velocity: (n, 2); NaN: unknown.
        covariance: (n, 2, 2) of positions, or (n, 4, 4) of positions and velocities.
        read_by: (n,) names of the readers, comma-separated.
        doubt: (n,) quality flags, comma-separated.
    """
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
