"""Method `imm`: a filter of several motion models for several targets that microphone arrays hear.

Every target has particles of its own ([Lee] Sec. 3.2.1, `occlog.track.methods.imm.kernel`).  What is not in the
thesis: bearings are associated jointly (`occlog.track.methods.imm.association`; `association=any` is the thesis'
form), several arrays are taken in one after the other by multiplying weights, and every target has a
probability that it exists and one that it sounds, from which births, deaths and silence follow.

Scans of arrays that listened in vain: a recording has rows only for what arrays hear.

An array that has had a row listens at its rate: the scene's `rate_hz`, or else the shortest of
the last intervals between its rows.  Where by its own clock it should have had a row and has
none, it listened in vain.  An array that has had no row yet, or too few to tell its rate, is not
taken to listen; nothing is known of the time after the last row of all.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.consistency.estimates import MIN_EFFECTIVE_SAMPLE_SIZE
from occlog.filtering.particles import effective_sample_size
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED
from occlog.scans.grouping import Scan, concat, empty_scan
from occlog.track.interface import Estimate, Joint, Smoothing

from . import kernel as imm
from .association import (
    BearingAssociation,
    BearingFit,
    Direction,
    bearing_fit,
    direction,
    in_range,
    joint_data_association,
    merged_bearing_density,
    reweigh,
)
from .config import ImmConfig
from .tracks import (
    TENTATIVE,
    UNLABELLED_TRACK,
    Genealogy,
    ImmWorld,
    Moved,
    Track,
    TrackTrace,
    initial_tracks,
    is_rejuvenated,
    make_world,
    move_track,
    new_genealogy,
    new_track,
    resampled,
    smooth_backwards,
    trace_of,
    track_on_bearing,
    update_existence,
)

MIN_UNASSIGNED_TO_INITIATE = 0.5
"""A bearing that is of no target with more than this probability may be a new target's."""


class ImmState(NamedTuple):
    """State of the filter at the time of the last scan: all tracks, confirmed and tentative.

    `t_ns` is None before the first scan.
    """

    world: ImmWorld
    tracks: tuple[Track, ...]  # of targets and candidates; confirmed ones first, by number
    t_ns: int | None
    free: int  # least number that no track has had


class Count(NamedTuple):
    """Number of bearings of an array in a scan, and of the confirmed tracks in its range before the scan.

    `array` is its number, cameras not counted; `free` are the indices of the bearings assigned to no target.
    """

    array: int
    bearings: int
    targets: int  # confirmed tracks in its range, before the scan
    free: Ints  # bearings of no target


class TrackPosterior(NamedTuple):
    """Posterior of one confirmed track after a scan."""

    number: int
    moved: Moved
    estimate: imm.ModelEstimates
    ess: float  # effective number of particles, or of the families that they come from


class ImmStepResult(NamedTuple):
    """Result of a scan: posteriors of confirmed tracks by number, counts of bearings by array, and the log evidence."""

    beliefs: tuple[TrackPosterior, ...]  # by number
    counts: tuple[Count, ...]
    scan: Scan
    log_evidence: float  # of all bearings


def init(scene: Scene, config: ImmConfig, rng: Generator) -> ImmState:
    """Return the state before the first scan: no tracks, or confirmed ones at the states in `config.start`."""
    tracks = initial_tracks(config, 0, rng)
    return ImmState(make_world(scene, config), tracks, None, len(tracks))


def step(state: ImmState, scan: Scan, rng: Generator) -> tuple[ImmState, ImmStepResult]:
    """Return the state after a scan of any arrays, and its result.

    Args:
        state: state before the scan.
        scan: rows of microphone arrays alone, not earlier than the last ones; an array that has rows but none that is
            seen listened without hearing anything.
        rng: generator of the random numbers drawn.
    """
    world, t_ns = state.world, scan.t_ns
    # Propose: move all particles under every motion model (Eq. 3.3)
    dt = 0.0 if state.t_ns is None else (t_ns - state.t_ns) / NS
    known = state.tracks if state.t_ns is not None else tuple(t._replace(met_ns=t_ns) for t in state.tracks)
    moved = [move_track(world, track, dt, rng) for track in known]
    counts, evidence = [], 0.0
    for sensor, heard in scan.by_sensor():
        array = sensor - world.cameras
        expected = sum(_in_range(world, m, array) for m in moved if m.track.number != TENTATIVE)
        # Associate and weigh (Eqs. 3.4-3.6)
        moved, free, fit = _update_by_array(world, moved, array, heard)
        evidence += fit
        counts.append(Count(array, len(heard.bearing), expected, free))
        # Births: tracks on the lines of sight of bearings of no target
        moved += _initiate_tracks(world, array, heard.take(free), {m.track.number for m in moved}, rng)
    # Deaths: end tracks that hardly exist, or were neither heard nor seen for long
    moved = [m._replace(track=_with_hit(m, t_ns)) for m in moved]
    moved = [m for m in moved if _is_kept(m.track, t_ns, world.config)]
    # Confirm tracks that were heard often enough
    moved, least = _confirmed(moved, state.free, world.config)
    # Resample: systematic, a model drawn for each row
    drawn = [resampled(m, world.config.particles, dt, rng) for m in moved]
    # Estimate: mean and covariance over particles and models
    beliefs, tracks = [], []
    for m, track in zip(moved, drawn, strict=True):
        if track.lineage is not None:
            estimate = imm.moments(m.predicted, m.weights)
            track, size = _rests_on(track, track.lineage, estimate, world.config)
            beliefs.append(
                TrackPosterior(track.number, m, estimate, min(size, effective_sample_size(m.weights.ravel())))
            )
        tracks.append(track)
    return ImmState(world, tuple(tracks), t_ns, least), ImmStepResult(tuple(beliefs), tuple(counts), scan, evidence)


def _rests_on(track: Track, lineage: Genealogy, estimate: imm.ModelEstimates, config: ImmConfig) -> tuple[Track, float]:
    """Return a track, and the effective number of ancestors of its particles; infinity if these are enough.

    Enough are `MIN_EFFECTIVE_SAMPLE_SIZE`, or fewer ones if process noise has restored the diversity since; then the
    count of ancestors begins again in the track that is returned.

    Args:
        track: the track.
        lineage: ancestry of its particles.
        estimate: mean and covariance of the particles.
        config: settings of the method.
    """
    families = lineage.effective()
    if families >= MIN_EFFECTIVE_SAMPLE_SIZE:
        return track, math.inf
    if is_rejuvenated(lineage, estimate.covariance[::2, ::2], config.process_noise_velocity):
        return track._replace(lineage=new_genealogy(len(lineage.families))), math.inf
    return track, families


def _in_range(world: ImmWorld, moved: Moved, array: int) -> bool:
    """Return whether the track's mean position is in the range of array number `array`."""
    if math.isinf(world.reach[array]):
        return True
    x, y = np.einsum("ml,mlc->c", moved.weights, moved.predicted)[::2] - world.positions[array]
    return math.hypot(x, y) <= float(world.reach[array])


def _update_by_array(world: ImmWorld, moved: list[Moved], array: int, heard: Scan) -> tuple[list[Moved], Ints, float]:
    """Update all tracks with the bearings of one array.

    Args:
        world: scene and settings.
        moved: tracks moved to the time of the scan.
        array: number of the array.
        heard: the array's rows of the scan.

    Returns:
        The tracks, the indices of the bearings that belong to no track, and the log density of all bearings.
    """
    if heard.labelled.any():
        moved = _labelled(world, moved, array, heard)
    take = _associate_any if world.config.association == "any" else _associate_jointly
    found, moved = take(world, moved, array, heard, _allowed(moved, heard))
    taken = found.alone.sum(axis=0) + 0.5 * found.shared.sum(axis=(0, 1))
    return moved, np.flatnonzero(taken < 1.0 - MIN_UNASSIGNED_TO_INITIATE), found.log_evidence


def _fits(world: ImmWorld, moved: list[Moved], array: int, heard: Scan) -> list[BearingFit]:
    """Return, for each track, the densities at its particles of the bearings `heard` by array number `array`."""
    position, reach = world.positions[array], float(world.reach[array])
    return [
        bearing_fit(m.predicted, m.weights, bearing=heard.bearing, sigma=heard.sigma, position=position, reach=reach)
        for m in moved
    ]


def _labelled(world: ImmWorld, moved: list[Moved], array: int, heard: Scan) -> list[Moved]:
    """Give each new label of `heard` to the unlabelled track that its bearing fits best, and return the tracks.

    A label is not given if its bearing fits no such track better than a density that is uniform in azimuth. `moved` is
    changed in place.
    """
    fits = np.array([f.fit for f in _fits(world, moved, array, heard)]).reshape(len(moved), len(heard.bearing))
    for i in np.flatnonzero(heard.labelled).tolist():
        label = int(heard.target_id[i])
        if any(m.track.label == label for m in moved):
            continue
        fit = [f if m.track.label == UNLABELLED_TRACK else 0.0 for m, f in zip(moved, fits[:, i].tolist(), strict=True)]
        if fit and max(fit) > 1.0 / (2.0 * math.pi):
            k = int(np.argmax(fit))
            moved[k] = moved[k]._replace(track=moved[k].track._replace(label=label))
    return moved


def _allowed(moved: list[Moved], heard: Scan) -> Bools:
    """Return (K, N) booleans: bearing i can belong to track k by their labels.

    A track with its own label among the bearings can have no other; a labelled bearing can be of no other track.
    """
    if not heard.labelled.any():
        return np.ones((len(moved), len(heard.bearing)), dtype=np.bool_)
    own = np.array([m.track.label for m in moved], dtype=np.int64)[:, None]
    same = own == heard.target_id
    spoken = (same & (own != UNLABELLED_TRACK)).any(axis=1, keepdims=True)  # its own bearing is among them
    return np.asarray(np.where(spoken, same, ~heard.labelled))


def _clutter(world: ImmWorld, bearing: Floats) -> Floats:
    """Return (N,) densities [1/rad] of the bearings (N,) under the clutter hypothesis, which is uniform in azimuth."""
    return np.full(len(bearing), world.config.clutter_rate / (2.0 * math.pi))


def _associate_jointly(
    world: ImmWorld, moved: list[Moved], array: int, heard: Scan, allowed: Bools
) -> tuple[BearingAssociation, list[Moved]]:
    """Associate an array's bearings jointly with all tracks; return the association and the reweighted tracks.

    Args:
        world: scene and settings.
        moved: K tracks at the time of the scan.
        array: number of the array.
        heard: the array's N rows of the scan.
        allowed: (K, N) booleans: bearing i can belong to track k.
    """
    K, N, config = len(moved), len(heard.bearing), world.config
    fits = _fits(world, moved, array, heard)
    exists = np.array([m.track.exists for m in moved])
    chance = np.array([m.track.sounds for m in moved]) * config.detection_probability
    fit = np.array([f.fit for f in fits]).reshape(K, N)
    # Likelihood that bearing i is of track k alone, and that track k is not heard
    alone = (exists * chance)[:, None] * fit * allowed
    unheard = 1.0 - exists * chance * np.array([f.reached for f in fits])
    # A track with its label among the bearings was heard.
    unheard = np.where((allowed & heard.labelled).any(axis=1), 1e-6 * unheard, unheard)
    # Likelihood that two tracks nearer than the array's resolution are heard as one
    shared, separate, pairs = _merged_densities(world, moved, array, heard, fits)
    shared *= (exists * chance)[:, None, None] * (exists * chance)[:, None] * allowed[:, None] * allowed
    # Joint association: marginals over all events
    found = joint_data_association(alone, unheard, shared, separate, _clutter(world, heard.bearing))
    # Weigh each track's particles by its share of every bearing
    out = []
    for k, m in enumerate(moved):
        mine = [(found.shared[k, b], pairs[k, b]) for b in range(K) if (k, b) in pairs]
        weights = reweigh(m.weights, fits[k], float(chance[k]), found.alone[k], float(found.unheard[k]), mine)
        out.append(_after(m, weights, fits[k].reached, config, float(found.unheard[k]), array))
    return found, out


def _merged_densities(
    world: ImmWorld, moved: list[Moved], array: int, heard: Scan, fits: list[BearingFit]
) -> tuple[Floats, Floats, dict[tuple[int, int], Floats]]:
    """Return the densities of bearings of two targets that an array hears as one.

    Args:
        world: scene and settings.
        moved: K tracks at the time of the scan.
        array: number of the array.
        heard: the array's N rows of the scan.
        fits: densities of the bearings for single targets.

    Returns:
        (K, K, N) densities of bearing i for two targets [1/rad]; (K, K) probabilities that the two are heard apart; by
        (k, b), the densities (N, J, L) at the particles of k if merged with b, for pairs near enough.
    """
    K, N, resolution = len(moved), len(heard.bearing), float(world.resolution[array])
    shared, separate = np.zeros((K, K, N)), np.ones((K, K))
    pairs: dict[tuple[int, int], Floats] = {}
    if K < 2 or not N or resolution <= 0.0:
        return shared, separate, pairs
    at = [direction(f, m.weights) for f, m in zip(fits, moved, strict=True)]
    for k, b in permutations(range(K), 2):
        each = merged_bearing_density(
            fits[k], at[k], at[b], bearing=heard.bearing, sigma=heard.sigma, resolution=resolution
        )
        if each.any():
            pairs[k, b] = each
            mean = 0.5 * np.einsum("nml,ml->n", each, moved[k].weights)  # the two ways to see it are averaged
            shared[k, b] += mean
            shared[b, k] += mean
            separate[k, b] = separate[b, k] = _resolution_probability(at[k], at[b], resolution)
    return shared, separate, pairs


def _resolution_probability(one: Direction, other: Direction, resolution: float) -> float:
    """Return the probability that an array resolves two targets: bearings differ by more than `resolution` [rad].

    `one` and `other` are the Gaussian predictions of their bearings.
    """
    gap = math.remainder(one.centre - other.centre, 2.0 * math.pi)
    scale = math.sqrt(2.0) * max(math.hypot(one.spread, other.spread), 1e-9)
    return 1.0 - 0.5 * (math.erf((resolution - gap) / scale) + math.erf((resolution + gap) / scale))


def _associate_any(
    world: ImmWorld, moved: list[Moved], array: int, heard: Scan, allowed: Bools
) -> tuple[BearingAssociation, list[Moved]]:
    """Associate every bearing with every track ([Lee] Eq. 3.6); return the association and the reweighted tracks.

    Hearing nothing does not change the weights.

    Args:
        world: scene and settings.
        moved: K tracks at the time of the scan.
        array: number of the array.
        heard: the array's N rows of the scan.
        allowed: (K, N) booleans: bearing i can belong to track k.
    """
    K, N, config = len(moved), len(heard.bearing), world.config
    position, reach = world.positions[array], float(world.reach[array])
    alone, unheard, out, evidence = np.zeros((K, N)), np.ones(K), [], 0.0
    for k, m in enumerate(moved):
        some = np.flatnonzero(allowed[k])
        reached = in_range(m.predicted, m.weights, position, reach)[1]
        weights, fit = m.weights, np.zeros(len(some))
        chance = m.track.exists * m.track.sounds * config.detection_probability
        if len(some):
            found = imm.update_weights(m.predicted, m.weights, heard.bearing[some], heard.sigma[some], position)
            weights, evidence = found.total, evidence + found.log_evidence
            # The mean density of each bearing is its share of that of all.
            share = found.each.reshape(len(some), -1).sum(axis=1)
            fit = chance * math.exp(found.log_evidence) * share * (2.0 * math.pi / config.clutter_rate)
        missed = 1.0 - chance * reached
        alone[k, some] = fit / (fit.sum() + missed)
        unheard[k] = missed / (fit.sum() + missed)
        out.append(_after(m, weights, reached, config, float(unheard[k]), array))
    return BearingAssociation(alone, unheard, np.zeros((K, K, N)), evidence), out


def _after(m: Moved, weights: Floats, reached: float, config: ImmConfig, unheard: float, array: int) -> Moved:
    """Return a track with new particle weights and its existence probability after an array's scan.

    Args:
        m: track before.
        weights: (J, L) new weights of its particles.
        reached: probability that it is in the array's range.
        config: settings of the method.
        unheard: probability that no bearing is of it.
        array: number of the array.
    """
    track = update_existence(m.track, reached, config.detection_probability, unheard)
    arrays = (*m.arrays, array)
    return m._replace(
        track=track, weights=weights, heard=m.heard or unheard < MIN_UNASSIGNED_TO_INITIATE, arrays=arrays
    )


def _initiate_tracks(world: ImmWorld, array: int, free: Scan, numbers: set[int], rng: Generator) -> list[Moved]:
    """Return new tracks on the lines of sight of the bearings of an array that belong to no track.

    A labelled bearing begins a confirmed track of that number, or a tentative one if the number is taken. Unlabelled
    ones begin tentative tracks, only with joint association and a birth probability above 0.

    Args:
        world: scene and settings.
        array: number of the array.
        free: rows of the bearings.
        numbers: numbers of existing tracks; new ones are added in place.
        rng: generator of the random numbers drawn.
    """
    # Where every track takes any bearing, several come to follow one source, and the others' bearings seem free.
    config, initiated = world.config, []
    unaided = config.birth_probability > 0.0 and config.association == "joint"
    for label, bearing, sigma in zip(free.target_id.tolist(), free.bearing.tolist(), free.sigma.tolist(), strict=True):
        if unaided or label != UNLABELLED_TRACK:
            track = track_on_bearing(world, array, bearing, sigma, free.t_ns, label, rng)
            if track.number in numbers:
                track = track._replace(number=TENTATIVE)
            numbers.add(track.number)
            initiated.append(new_track(world, track)._replace(arrays=(array,)))
    return initiated


def _with_hit(m: Moved, t_ns: int) -> Track:
    """Return the track of `m`; if it was heard in the scan at `t_ns`, that is its last time.

    It then also has one more hit, unless it is new.
    """
    if not m.heard:
        return m.track
    return m.track._replace(hits=m.track.hits + (not m.initiated), met_ns=t_ns)


def _is_kept(track: Track, t_ns: int, config: ImmConfig) -> bool:
    """Return whether a track goes on: it exists with sufficient probability, and was heard or seen recently enough."""
    return track.exists >= config.termination_threshold and t_ns - track.met_ns <= config.max_coasting_s * NS


def _confirmed(moved: list[Moved], free: int, config: ImmConfig) -> tuple[list[Moved], int]:
    """Return the tracks, confirmed ones first by number, and the lowest number that no track has had.

    Tentative tracks that meet the thresholds of confirmation get numbers from `free` on.
    """
    out = []
    for m in moved:
        track = m.track
        if (
            track.number == TENTATIVE
            and track.exists >= config.confirmation_threshold
            and track.hits >= config.confirmation_hits
        ):
            track, free = track._replace(number=free), free + 1
        free = max(free, track.number + 1)
        out.append(m._replace(track=track))
    return sorted(out, key=lambda m: (m.track.number == TENTATIVE, m.track.number)), free


def estimates(report: ImmStepResult, scene: Scene) -> list[tuple[int, Estimate]]:
    """Return (number, estimate) of each confirmed target after a scan, by number."""
    return [(belief.number, _estimate(belief, report, len(scene.cameras))) for belief in report.beliefs]


def _estimate(belief: TrackPosterior, report: ImmStepResult, cameras: int) -> Estimate:
    """Return the estimate of one confirmed target after a scan; `cameras` is the number of the scene's cameras.

    `fallback` is `depleted` if the effective sample size is below `MIN_EFFECTIVE_SAMPLE_SIZE`.
    """
    e, m = belief.estimate, belief.moved
    evidence = report.log_evidence
    return Estimate(
        xy=e.mean[::2],
        velocity=e.mean[1::2],
        covariance=np.ascontiguousarray(e.covariance[::2, ::2]),
        ess=belief.ess,
        log_likelihood=evidence if math.isfinite(evidence) else math.nan,
        n_observing=len(report.counts),
        n_detected=int(m.heard),
        fallback="depleted" if belief.ess < MIN_EFFECTIVE_SAMPLE_SIZE else "",
        used=tuple(cameras + a for a in m.arrays),
    )


def trace(result: tuple[ImmState, int]) -> TrackTrace:
    """Return the record of one target after the last step that smoothing needs.

    `result` is the state and the number of the target.
    """
    state, number = result
    assert state.t_ns is not None
    return trace_of(next(track for track in state.tracks if track.number == number), state.t_ns)


METHOD = Joint(
    config=ImmConfig,
    init=init,
    step=step,
    estimates=estimates,
    smoothing=Smoothing(lambda config: config, trace, smooth_backwards),
)


INTERVALS = 15
"""Intervals of which the shortest counts as an array's period."""
MIN_INTERVALS = 3
"""Minimum number of intervals from which an array's rate is estimated."""
LATE_PERIOD_SHARE = 0.5
"""A row may be late by this share of the period before it counts as missing."""


class ListeningTimes:
    """Clock of one microphone array, which states when it should have listened.

    Its interval between scans is 1 / rate of the scene, or else the shortest of the last intervals between its rows.
    """

    def __init__(self, array: MicrophoneArray) -> None:
        """Start before the first row; the interval is known if the scene states the array's rate."""
        self._known = None if array.rate_hz is None else round(NS / array.rate_hz)
        self._gaps: deque[int] = deque(maxlen=INTERVALS)
        self._row_ns: int | None = None  # of the last row
        self.last_ns: int | None = None  # when it listened last

    @property
    def period_ns(self) -> int | None:
        """Return the interval between scans [ns]; None if unknown."""
        if self._known is not None:
            return self._known
        return min(self._gaps) if len(self._gaps) >= MIN_INTERVALS else None

    def heard(self, t_ns: int) -> None:
        """Record that the array has a row at time `t_ns` [ns]."""
        if self._row_ns is not None:
            self._gaps.append(t_ns - self._row_ns)
        self._row_ns = self.last_ns = t_ns

    def due(self, t_ns: int, most: int) -> list[int]:
        """Return the times [ns] before `t_ns` at which the array listened in vain, the first `most` of them.

        All of them count as past afterwards. Empty if the interval is unknown or the array has had no row.
        """
        period = self.period_ns
        if period is None or self.last_ns is None or period <= 0:
            return []
        count = max(0, int((t_ns - LATE_PERIOD_SHARE * period - self.last_ns) // period))
        times = [self.last_ns + (n + 1) * period for n in range(min(count, most))]
        if count:
            self.last_ns += count * period
        return times


class ArrayScans:
    """Scans of all microphone arrays, with added scans in which arrays listened without hearing anything."""

    def __init__(self, scene: Scene, forget_s: float) -> None:
        """Start before the first row.

        Args:
            scene: the arrays.
            forget_s: longest time without a row that is processed as silence [s]; of a longer one only this much.
        """
        self._cameras = len(scene.cameras)
        self._clocks = [ListeningTimes(a) for a in scene.arrays]
        self._forget_ns = round(forget_s * NS)

    def scans(self, scan: Scan) -> Iterator[Scan]:
        """Generate the arrays' scans up to the time of `scan`: scans without detections first, then its rows.

        A scan without detection has a row that is not `seen`. Rows of an array are sorted by label and bearing; labels
        below 0 mean unlabelled.
        """
        rows = scan.take(scan.sensor >= self._cameras)
        # Silence before this scan, by the arrays' own clocks
        yield from self._in_vain(scan.t_ns)
        if not len(rows.sensor):
            return
        spoke = {sensor - self._cameras for sensor in rows.sensor.tolist()}
        for a in spoke:
            self._clocks[a].heard(scan.t_ns)
        # Others with their next scan now: not before its time, for a row of theirs may be about to come.
        silent = []
        for a, clock in enumerate(self._clocks):
            period = clock.period_ns
            if a in spoke or clock.last_ns is None or period is None:
                continue
            if scan.t_ns - clock.last_ns >= period:
                silent.append(self._cameras + a)
                clock.last_ns += period
        yield _ordered(concat([empty_scan(scan.t_ns, silent), rows]))

    def _in_vain(self, t_ns: int) -> Iterator[Scan]:
        """Generate the scans before `t_ns` in which arrays listened without hearing anything, in the order of time."""
        silent: dict[int, list[int]] = {}
        for a, clock in enumerate(self._clocks):
            period = clock.period_ns or 1
            for at in clock.due(t_ns, max(1, self._forget_ns // period)):
                silent.setdefault(at, []).append(self._cameras + a)
        for at in sorted(silent):
            yield empty_scan(at, silent[at])


def _ordered(scan: Scan) -> Scan:
    """Return the rows sorted by array, label, bearing and standard deviation, with labels below 0 made `UNLABELLED`."""
    label = np.maximum(scan.target_id, UNLABELLED)
    order = np.lexsort((scan.sigma, scan.bearing, label, scan.sensor))
    return scan._replace(target_id=label).take(order)
