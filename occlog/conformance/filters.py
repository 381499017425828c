"""The kit of tracking methods of bearings: each check tries one promise, and states in a sentence how it is broken."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from occlog.errors import OcclogError
from occlog.plugins.interface import EstimatedPosition, Filter, TargetScan
from occlog.track.plugin_filter import fault_of

from .faults import (
    FIRST,
    BrokenError,
    Check,
    bytes_left,
    called,
    defaults,
    manners,
    named,
    refuse,
    step_unchanged,
    words,
)
from .samples import FEW, PLAIN, SIGMA_RAD, WALK_STEPS, SampleWalk, blind, later, without_sensors

SETTLED = WALK_STEPS // 2
"""Time step from which a filter must have found the target."""
FARTHEST_M = 3.0
"""Root mean square error [m] of a filter that has found it; lines of sight alone determine it to about 0.6 m."""
MAX_NEES = 20.0
"""Mean normalised squared error of a covariance that is reliable; 2 is right."""
GROWTH_BYTES = 150
"""Memory that a step may leave behind."""
SAME = 3.0
"""Tolerance between positions of the same walk [standard deviations]."""


Of = type[Filter]


def run(
    of: Of, walk: Iterable[TargetScan], *, scene: SampleWalk = PLAIN, seed: int = 1
) -> list[EstimatedPosition | None]:
    """Run a new filter of class `of` on the scans of a walk, and return its estimates, None where it gives none.

    Args:
        of: class of the filter.
        walk: scans, in the order of time.
        scene: sample walk that provides the sensors and the unit of length.
        seed: seed of the filter's random numbers.

    Raises:
        BrokenError: the filter raises, or returns an impossible position.
    """
    own = start(of, scene, seed)
    return [step(own, scan) for scan in walk]


def start(of: Of, scene: SampleWalk = PLAIN, seed: int = 1) -> Filter:
    """Return a new filter of class `of` with default settings and the sensors of `scene`.

    `seed`: seed of its random numbers. Raise BrokenError if the constructor raises.
    """
    with called("a new filter"):
        return of(scene.scene, defaults(of, scene.scene.length_unit), np.random.default_rng(seed))


def step(own: Filter, scan: TargetScan) -> EstimatedPosition | None:
    """Return the estimate of the filter `own` for one scan; None if it gives none.

    Raises:
        BrokenError: `step` raises, or returns an impossible position.
    """
    with called("step"):
        estimate = own.step(scan)
    refuse(_fault(estimate))
    return estimate


def _fault(estimate: EstimatedPosition | None) -> str | None:
    return None if estimate is None else fault_of(estimate)


def _bytes(estimates: Sequence[EstimatedPosition | None]) -> list[tuple[bytes, ...] | None]:
    return [None if p is None else tuple(np.asarray(v, dtype=np.float64).tobytes() for v in p[:2]) for p in estimates]


def _similar(of: Of, walk: SampleWalk, scans: Iterable[TargetScan], what: str) -> None:
    """Check that a filter estimates the same positions in a transformed world as in the plain one.

    Args:
        of: class of the filter.
        walk: the sample walk in the transformed world (turned, shifted, scaled or in other order).
        scans: scans of that walk.
        what: words for that world in messages.

    Raises:
        BrokenError: after `SETTLED` steps, positions differ by more than `SAME` standard deviations.
    """
    plain, other = run(of, PLAIN), run(of, scans, scene=walk)
    for n, (a, b) in enumerate(zip(plain, other, strict=True)):
        if n < SETTLED:
            continue
        if a is None or b is None:
            if (a is None) != (b is None):
                raise BrokenError(f"{what}: the filter gives a position with or without it, but not in both cases")
            continue
        spread = walk.scale * np.sqrt(np.trace(np.asarray(a.covariance)))
        off = float(np.linalg.norm(walk.at(np.asarray(a.xy)) - np.asarray(b.xy)))
        if off > SAME * spread:
            raise BrokenError(f"{what}: the filter's position is {off / walk.scale:.3g} m from that without it")


def check_shape(of: Of) -> None:
    """Check that estimates are `EstimatedPosition`s with arrays of the declared shapes."""
    _refuse(of, lambda wrong: not any(word in wrong for word in ("definite", "symmetric", "finite")))


def check_finite(of: Of) -> None:
    """Check that estimated positions and covariances are finite."""
    _refuse(of, lambda wrong: "finite" in wrong)


def check_symmetric(of: Of) -> None:
    """Check that covariances of estimates are symmetric."""
    _refuse(of, lambda wrong: "symmetric" in wrong)


def check_definite(of: Of) -> None:
    """Check that covariances of estimates are positive definite."""
    _refuse(of, lambda wrong: "definite" in wrong)


def _refuse(of: Of, wanted: Callable[[str], bool]) -> None:
    for estimate in _raw(of):
        wrong = _fault(estimate)
        if wrong is not None and wanted(wrong):
            raise BrokenError(wrong)


def _raw(of: Of) -> list[EstimatedPosition | None]:
    """Return the unchecked estimates of a new filter for the plain walk.

    Empty if it raises, which other checks report.
    """
    try:
        own = start(of)
        return [own.step(scan) for scan in PLAIN]
    except Exception:
        return []


def check_follows(of: Of) -> None:
    """Check that a filter follows a target that three sensors see.

    After `SETTLED` steps every step must give an estimate, and their RMS error must be at most `FARTHEST_M`.
    """
    estimates = run(of, PLAIN)[SETTLED:]
    off = [np.asarray(p.xy) - xy for p, xy in zip(estimates, PLAIN.truth[SETTLED:], strict=True) if p is not None]
    if len(off) < len(estimates):
        raise BrokenError(
            f"the filter gives no position in {len(estimates) - len(off)} of {len(estimates)} time steps, though three "
            "sensors see the target"
        )
    rms = float(np.sqrt((np.array(off) ** 2).sum(axis=1).mean()))
    if not rms <= FARTHEST_M:
        raise BrokenError(
            f"the filter's RMS error is {rms:.3g} m (allowed: {FARTHEST_M:g}), with bearing noise of 1 degree from 40 m"
        )


def check_consistent(of: Of) -> None:
    """Check that the mean NEES (squared error relative to the covariance) is at most `MAX_NEES`."""
    estimates = run(of, PLAIN)[SETTLED:]
    found = [
        (np.asarray(p.xy) - xy) @ np.linalg.solve(np.asarray(p.covariance), np.asarray(p.xy) - xy)
        for p, xy in zip(estimates, PLAIN.truth[SETTLED:], strict=True)
        if p is not None
    ]
    if found and not float(np.mean(found)) <= MAX_NEES:
        raise BrokenError(
            f"the filter's covariances are too small: mean NEES {np.mean(found):.3g} (expected 2, at most {MAX_NEES:g})"
        )


def check_independent(of: Of) -> None:
    """Check that filters of several targets do not influence each other."""
    alone, first, second = run(of, FEW), start(of), start(of)
    both = []
    for scan in FEW:
        both.append(step(first, scan))
        step(second, later(scan._replace(bearings=-scan.bearings), 0.1))
    if _bytes(alone) != _bytes(both):
        raise BrokenError(
            "a target's estimates depend on another's filter; keep state in the object, not in class or module"
        )


def check_inputs(of: Of) -> None:
    """Check that `step` leaves the arrays of the given scan unchanged."""
    own = start(of)
    for scan in FEW:
        step_unchanged(step, own, scan, "time step")


def check_results(of: Of) -> None:
    """Check that estimates which a filter has returned do not change in later steps."""
    own, kept = start(of), []
    for scan in FEW:
        estimate = step(own, scan)
        if estimate is not None:
            kept.append((estimate, np.array(estimate.xy), np.array(estimate.covariance)))
    if any((p.xy != xy).any() or (p.covariance != P).any() for p, xy, P in kept):
        raise BrokenError("the filter changes a position that it has returned; return copies")


def check_memory(of: Of) -> None:
    """Check that memory does not grow with the length of a walk."""
    own = start(of)
    grown = bytes_left((step(own, scan) for scan in replace(PLAIN, n_steps=400)), 200)
    if grown > GROWTH_BYTES:
        raise BrokenError(
            f"the filter's memory grows by {grown:.0f} bytes each step (allowed: {GROWTH_BYTES}); keep no history"
        )


def check_empty(of: Of) -> None:
    """Check that a filter accepts scans without any sensor, at the start and later."""
    scans = list(FEW)
    run(of, [without_sensors(scans[0]), *scans[1:6], without_sensors(scans[6]), *scans[7:]])


def check_hidden(of: Of) -> None:
    """Check that a filter accepts scans in which sensors observe but detect nothing (NaN), at the start and later."""
    scans = list(FEW)
    half = scans[7]._replace(
        bearings=np.array([np.nan, *scans[7].bearings[1:]]), sigma=np.array([np.nan, *scans[7].sigma[1:]])
    )
    run(of, [blind(scans[0]), *scans[1:6], blind(scans[6]), half, *scans[8:]])


def check_gap(of: Of) -> None:
    """Check that a filter accepts a scan that comes an hour after the previous one."""
    scans = list(PLAIN)
    run(of, [*scans[:20], *(later(m, 3600.0) for m in scans[20:])])


def check_same_time(of: Of) -> None:
    """Check that a filter accepts two scans with the same time."""
    scans = list(FEW)
    run(of, [m for scan in scans for m in (scan, scan)])


def check_time_back(of: Of) -> None:
    """Check that a scan of an earlier time is refused with ValueError, or gives a valid estimate."""
    scans = list(FEW)
    own = start(of)
    for scan in scans[:6]:
        step(own, scan)
    try:
        estimate = own.step(later(scans[6], -30.0))
    except (ValueError, OcclogError):
        return
    except Exception as error:
        raise BrokenError(f"the filter raises {words(error)} at a time that goes back; raise a ValueError") from error
    wrong = _fault(estimate)
    if wrong is not None:
        raise BrokenError(f"after a time that goes back {wrong}")


def check_one_sensor(of: Of) -> None:
    """Check that a filter accepts the bearings of a single sensor."""
    run(of, replace(FEW, sensors=(1,)))


def check_two_sensors(of: Of) -> None:
    """Check that a filter accepts a change of the sensors: first one pair, then another."""
    pairs = [replace(FEW, sensors=pair) for pair in ((0, 1), (1, 2))]
    run(of, [*list(pairs[0])[:6], *list(pairs[1])[6:]])


def check_candidates(of: Of) -> None:
    """Check that a filter accepts several bearings of a sensor at one time, also false ones."""

    def wild(scan: TargetScan) -> TargetScan:
        more = np.array([scan.bearings[0] + 2.0])
        return TargetScan(
            scan.t_ns,
            (scan.sensors[0], *scan.sensors),
            np.concatenate([scan.places[:1], scan.places]),
            np.concatenate([(more + np.pi) % (2 * np.pi) - np.pi, scan.bearings]),
            np.concatenate([scan.sigma[:1], scan.sigma]),
        )

    scans = list(FEW)
    run(of, [*scans[:6], wild(scans[6]), *scans[7:]])


def check_sharp(of: Of) -> None:
    """Check that a filter accepts bearings that are nearly exact."""
    run(of, (m._replace(sigma=np.full(len(m.sigma), 1e-3 * SIGMA_RAD)) for m in FEW))


def check_order(of: Of) -> None:
    """Check that estimates do not depend on the order of the sensors."""
    other = replace(PLAIN, sensors=(2, 0, 1))
    _similar(of, other, other, "rows in another order")


def check_wrap(of: Of) -> None:
    """Check that a target is found across the negative x axis, where bearings jump by a full turn."""
    for turn in (0.5 * np.pi, np.pi):
        turned = replace(PLAIN, turn=turn)
        _similar(of, turned, turned, f"in a world turned by {np.degrees(turn):.0f} degrees")


def check_shift(of: Of) -> None:
    """Check that estimates do not depend on the origin of the world, by a shift of about 2 km."""
    shifted = replace(PLAIN, shift=(1000.0, -2000.0))
    _similar(of, shifted, shifted, "in a world shifted by 2 km")


def check_unit(of: Of) -> None:
    """Check that estimates do not depend on the unit of length, by a world in centimetres."""
    scaled = replace(PLAIN, scale=100.0)
    _similar(of, scaled, scaled, "in centimetres")


def check_epoch(of: Of) -> None:
    """Check that estimates do not depend on the epoch of times: 1970, or the start of a simulation."""
    early = replace(PLAIN, start_ns=0)
    _similar(of, early, early, "with times that begin at 0")


CHECKS: dict[str, Check] = {
    **FIRST,
    **manners(lambda of: _bytes(run(of, FEW)), "step"),
    **named(globals()),
}
"""Every check by its name."""
