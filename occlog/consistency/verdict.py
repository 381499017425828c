"""The verdict: whether a run's estimates are plausible, as findings with the figure, the limit and the remedy.

A finding requires that a figure exceeds a limit of practical importance (the constants of this file), and that it does
so significantly: the probability of the data at the limit, with the effective number of samples, is below
`SIGNIFICANCE`. docs/explanation/believe.md lists each finding with causes and remedies.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import bdtrc

from occlog.array_types import NS
from occlog.core.metrics.normalised_squares import Ratio
from occlog.records.scene import Scene
from occlog.records.tables import Diagnostics, Tracks
from occlog.records.verdicts import Check, Severity, finding, outcome

from .bearings import ComparedBearings, ResidualStatistics, UnassociatedCandidates, UnconfirmedBearings, pose_shares
from .estimates import (
    INCONSISTENT_SENSOR,
    MIN_EFFECTIVE_SAMPLE_SIZE,
    OUT_OF_VIEW,
    REGION_EDGE,
    SINGLE_SENSOR,
    UNDETECTED_IN_VIEW,
    EffectiveSampleSizes,
    PositionConsistency,
    RivalTrajectory,
)

SIGNIFICANCE = 1e-3
"""Probability that chance alone makes a limit seem broken."""
MIN_SAMPLES = 20
"""Minimum number of bearings, expected squares or frames for a check."""
MAX_DEPLETED_SHARE = 0.25
"""Share of rows with too few effective particles that matters."""
MAX_DEPLETED_SHARE_SMOOTHED = 0.02
"""Share of rows with too few effective particles that matters for smoothed estimates: earlier rows descend from the
particles of a depleted row, too."""
MAX_GAP_SHARE, MIN_GAPS = 0.8, 3
"""Share of rows after a gap from which nothing is filtered, and the minimum number of such rows for the check."""
MAX_RESTART_SHARE = 0.01
"""Share of rows with a restart that matters: one in a hundred."""
MAX_FLAGGED_SHARE = 0.05
"""Maximum share of flagged rows."""
MAX_POSSIBLE_OUTLIER_SHARE = 0.1
"""Share of rows that are contested that matters."""
MAX_REJECTED_SHARE = 0.25
"""Share of bearings rejected that matters."""
MAX_UNCONFIRMED_REJECTED_SHARE = 0.02
"""Maximum share rejected where one sensor at a time sees the target, and its motion alone reveals false bearings."""
NIS_LOW, NIS_HIGH = 0.5, 2.25
"""Normalised squared residuals that matter: stated standard deviations 1.4 times too large, 1.5 times too small."""
MAX_MOTION_VARIANCE_FACTOR = 4.0
"""Factor of the motion's variance that matters."""
MAX_BLIND_SHARE = 0.5
"""Share of rows in which fewer than two of the cameras that were selected see the target that matters."""
MAX_PERSISTENT_CANDIDATE_SHARE = 0.5
"""Share of frames with a candidate that stays and that no track explains that matters."""
MAX_NAMED = 20
"""Targets of one finding that are listed."""
PARTICLES, RESTARTED, TIME_GAPS = "effective sample size", "track loss", "time gaps"
NEVER_SEEN, SELECTED, FLAGGED = "targets never detected", "coverage by the selected cameras", "quality flags"
REJECTED_MEASUREMENTS, CONFIRMED, NIS = (
    "rejected measurements",
    "single-sensor measurements",
    "residuals (NIS)",
)
MOTION, ROOM, WALLS = "process noise", "positions outside the room", "detections through walls"
UNASSOCIATED_CANDIDATES, RIVALS = "unassociated candidates", "rival trajectories"
"""Names of checks."""
QUALITY_FLAGS = {
    REGION_EDGE: "region-edge",
    SINGLE_SENSOR: "single-sensor",
    OUT_OF_VIEW: "out-of-view",
    UNDETECTED_IN_VIEW: "undetected-in-view",
    INCONSISTENT_SENSOR: "inconsistent-sensor",
}
"""Values of `quality_flags`, and the ids of their messages."""
FALLBACKS = {
    "few_inliers": ("few-inliers", MAX_FLAGGED_SHARE),
    "unverified": ("unverified", MAX_FLAGGED_SHARE),
    "possible_outlier": ("possible-outlier", MAX_POSSIBLE_OUTLIER_SHARE),
    "infeasible_constraints": ("infeasible-constraints", 0.0),
    "no_path": ("no-path", 0.0),
    "not_converged": ("not-converged", 0.0),
    "unobservable": ("unobservable", 0.0),
    "ambiguous": ("ambiguous", 0.0),
}
"""Values of `fallback` that are reported: the ids of their messages, and the share of rows that is allowed."""


@dataclass
class ConsistencyEvidence:
    """Evidence on a run's estimates, accumulated over a stream of tables.

    Attributes:
        rows: number of estimates.
        fallbacks: number of rows by the value of `fallback`.
        doubts: number of rows by the value of `quality_flags`.
        targets: identities of the targets of the rows.
        seen: identities of those that a sensor detected.
        span_ns: first and last time [ns].
        selected: rows for which at least two cameras were selected.
        blind: of these, rows in which fewer than two sensors detected the target.
        particles: effective sample sizes.
        agreements: residuals of the bearings.
        alone: bearings that no other sensor can confirm.
        crowd: candidates (bearings without a label) near no track.
        positions: where the bearings of a time step intersect.
        distances: residuals are also of measurements that are no directions; then `positions` is not used.
        rivals: by target, other trajectories that are nearly as probable; None: the method does not search for any.
        unit: unit of lengths.
        diagnosed: there are diagnostics.
    """

    rows: int = 0
    fallbacks: Counter[str] = field(default_factory=Counter)
    doubts: Counter[str] = field(default_factory=Counter)
    targets: set[int] = field(default_factory=set)
    seen: set[int] = field(default_factory=set)
    span_ns: tuple[int, int] | None = None
    selected: int = 0
    blind: int = 0
    particles: EffectiveSampleSizes = field(default_factory=EffectiveSampleSizes)
    agreements: ResidualStatistics = field(default_factory=ResidualStatistics)
    alone: UnconfirmedBearings = field(default_factory=UnconfirmedBearings)
    crowd: UnassociatedCandidates = field(default_factory=UnassociatedCandidates)
    positions: PositionConsistency = field(default_factory=PositionConsistency)
    distances: bool = False
    rivals: dict[int, list[RivalTrajectory]] | None = None
    unit: str = ""
    diagnosed: bool = False

    def add_diagnostics(self, part: Diagnostics) -> None:
        """Update the counts and the histogram of sample sizes with further rows of diagnostics."""
        self.diagnosed = True
        self.rows += len(part)
        self.targets.update(part.target_id.tolist())
        self.seen.update(part.target_id[part.n_detected > 0].tolist())
        if len(part):
            first, last = int(part.t_ns.min()), int(part.t_ns.max())
            before = self.span_ns or (first, last)
            self.span_ns = min(first, before[0]), max(last, before[1])
        self.fallbacks.update(f for f in part.fallback.tolist() if f)
        self.doubts.update(d for text in part.quality_flags.tolist() if text for d in text.split(","))
        several = np.char.find(part.selected, ",") >= 0
        self.selected += int(np.count_nonzero(several))
        self.blind += int(np.count_nonzero(several & (part.n_detected < 2)))
        self.particles.add(part.ess)

    def saw(self, tracks: Tracks, compared: ComparedBearings, scene: Scene) -> None:
        """Add the residuals of bearings at `tracks`, and the counts of candidates near no track."""
        self.agreements.add(compared.residuals, pose_shares(tracks, scene))
        self.alone.add(compared.residuals)
        self.crowd.add(compared.frames)
        if not self.distances:
            self.positions.add(tracks, compared.residuals, scene)

    def competes(self, target: int, rivals: Sequence[RivalTrajectory]) -> None:
        """Add the rival trajectories that a search found for a target."""
        self.rivals = {} if self.rivals is None else self.rivals
        self.rivals.setdefault(target, []).extend(rivals)

    def figures(self) -> dict[str, object]:
        """Return the figures of a command's summary: sample sizes, residual statistics, unassociated candidates."""
        found: dict[str, object] = {}
        if self.particles.rows:
            found["median_effective_sample_size"] = self.particles.median
            found["depleted_share"] = self.particles.few / self.particles.rows
        metrics = self.agreements.figures()
        found |= {name.replace("bearings", self.what): value for name, value in metrics.items()}
        if self.crowd.frames:
            found["unassociated_candidates_per_frame"] = self.crowd.unexplained
        return found

    @property
    def what(self) -> str:
        """Return the name of the measurements that residuals are of, `bearings` or `measurements`, for messages."""
        return "measurements" if self.distances else "bearings"

    def checks(self, *, one_target: bool, smoothed: bool = False) -> tuple[Check, ...]:
        """Return all checks that the diagnostics and residuals allow, with their findings.

        Args:
            one_target: the method takes candidates without a label for those of its one target.
            smoothed: estimates are of trajectories that were drawn backwards through the filter's particles.
        """
        undiagnosed = "" if self.diagnosed else "there are no diagnostics"
        few, seen = f"fewer than {MIN_SAMPLES} {self.what} were judged", self.agreements.bearings
        unseen = few if seen < MIN_SAMPLES else ""
        crowded = "" if one_target else "the method itself distinguishes targets"
        return (
            *outcome(
                PARTICLES,
                self._depleted(smoothed),
                unless=undiagnosed or ("" if self.particles.rows else "the method has no particles"),
                median=self.particles.median,
            ),
            *outcome(RESTARTED, self._restarts(), unless=undiagnosed, rows=self.rows),
            *outcome(TIME_GAPS, self._gaps(), unless=undiagnosed),
            *outcome(
                NEVER_SEEN,
                self._unseen(),
                unless=undiagnosed or ("measurements are not directions alone" if self.distances else ""),
            ),
            *outcome(
                SELECTED, self._blind(), unless=undiagnosed or ("" if self.selected else "no cameras were selected")
            ),
            *outcome(FLAGGED, self._rows(), unless=undiagnosed, rows=self.rows),
            *outcome(REJECTED_MEASUREMENTS, self._rejected(), unless=unseen, bearings=seen),
            *outcome(CONFIRMED, self._unconfirmed(), unless=few if self.alone.bearings < MIN_SAMPLES else ""),
            *outcome(
                NIS,
                self._nis(),
                unless=few if self._expected() < MIN_SAMPLES else "",
                nis=self.agreements.nis.value,
                allowed=NIS_HIGH,
            ),
            *outcome(RIVALS, self._rivals(), unless="" if self.rivals is not None else "the method does not seek them"),
            *outcome(MOTION, self._motion(), unless="" if self.agreements.noise else "the method does not estimate it"),
            *outcome(
                ROOM,
                self._outside(),
                unless=few if self.positions.rows < MIN_SAMPLES else "",
                outside=self.positions.outside,
            ),
            *outcome(
                WALLS,
                self._through_walls(),
                unless="" if any(saw >= MIN_SAMPLES for saw, _ in self.positions.hidden.values()) else few,
            ),
            *outcome(
                UNASSOCIATED_CANDIDATES,
                self._several() if one_target else (),
                unless=crowded or ("" if self.crowd.frames else "no frame has candidates without a label"),
            ),
        )

    def _depleted(self, smoothed: bool) -> Iterator[Check]:
        """Generate a finding if effective sample sizes are small too often; smoothed tracks have their own limit."""
        allowed = MAX_DEPLETED_SHARE_SMOOTHED if smoothed else MAX_DEPLETED_SHARE
        yield from depleted_particles(PARTICLES, self.particles, allowed)

    def _restarts(self) -> Iterator[Check]:
        """Generate a finding if too many rows have a restart after the track was lost."""
        count = self.fallbacks["restart"]
        if exceeds_share(count, self.rows, MAX_RESTART_SHARE):
            share = count / self.rows
            yield finding(RESTARTED, "track-loss", count=count, rows=self.rows, share=share, allowed=MAX_RESTART_SHARE)

    def _gaps(self) -> Iterator[Check]:
        """Generate a finding if most rows follow the one before after so long a gap that nothing is filtered."""
        gaps = self.fallbacks["gap"]
        if self.span_ns is not None and gaps >= MIN_GAPS and gaps >= MAX_GAP_SHARE * self.rows:
            yield finding(
                TIME_GAPS,
                "gaps",
                count=gaps,
                rows=self.rows,
                interval_s=(self.span_ns[1] - self.span_ns[0]) / NS * len(self.targets) / self.rows,
                share=gaps / self.rows,
                allowed=MAX_GAP_SHARE,
            )

    def _unseen(self) -> Iterator[Check]:
        """Generate a finding that lists the targets which no sensor ever detected."""
        unseen = sorted(self.targets - self.seen)
        if unseen and not self.distances:
            yield finding(
                NEVER_SEEN,
                "targets-never-detected",
                targets=unseen[:MAX_NAMED],
                count=len(unseen),
                of=len(self.targets),
            )

    def _blind(self) -> Iterator[Check]:
        """Generate a finding if fewer than two of the selected cameras detect the target in too many rows."""
        if exceeds_share(self.blind, self.selected, MAX_BLIND_SHARE):
            yield finding(
                SELECTED,
                "selection-without-view",
                count=self.blind,
                rows=self.selected,
                share=self.blind / self.selected,
                allowed=MAX_BLIND_SHARE,
            )

    def _rows(self) -> Iterator[Check]:
        """Generate findings about rows with a quality flag, and about fallbacks that are not rare.

        A rare flag is a note.
        """
        flags = [(self.doubts[flag], id, MAX_FLAGGED_SHARE) for flag, id in QUALITY_FLAGS.items()]
        flags += [(self.fallbacks[value], *of) for value, of in FALLBACKS.items()]
        for n, (count, id, allowed) in enumerate(flags):
            rare = count <= allowed * self.rows
            if count and (not rare or n < len(QUALITY_FLAGS)):
                share = count / self.rows
                severity: Severity | None = "note" if rare else None
                yield finding(FLAGGED, id, severity, count=count, rows=self.rows, share=share, allowed=allowed)

    def _rivals(self) -> Iterator[Check]:
        """Generate a finding for each target with a rival trajectory nearly as probable as the reported one.

        It is a note if both differ in few rows.
        """
        origin_ns = 0 if self.span_ns is None else self.span_ns[0]
        for target, found in sorted((self.rivals or {}).items()):
            if not found:
                continue
            worst = max(found, key=lambda rival: rival.rows / rival.of)
            share = worst.rows / worst.of
            yield finding(
                RIVALS,
                "rival-mode",
                None if share > MAX_FLAGGED_SHARE else "note",
                targets=[target],
                odds=math.exp(min(rival.excess for rival in found)),
                distance=max(rival.distance for rival in found),
                unit=self.unit,
                count=worst.rows,
                rows=worst.of,
                first_s=(min(rival.first_ns for rival in found) - origin_ns) / NS,
                last_s=(max(rival.last_ns for rival in found) - origin_ns) / NS,
                share=share,
                allowed=MAX_FLAGGED_SHARE,
            )

    def _rejected(self) -> Iterator[Check]:
        """Generate a finding for each sensor with more rejected measurements than the allowed share."""
        for name, own in sorted(self.agreements.sensors.items()):
            if own.bearings >= MIN_SAMPLES and exceeds_share(
                own.bearings - own.inliers, own.bearings, MAX_REJECTED_SHARE
            ):
                yield finding(
                    REJECTED_MEASUREMENTS,
                    "measurements-rejected",
                    sensors=[name],
                    count=own.bearings,
                    what=self.what,
                    share=own.doubted,
                    allowed=MAX_REJECTED_SHARE,
                )

    def _unconfirmed(self) -> Iterator[Check]:
        """Generate a finding if bearings are probably false where sensors detect the target one at a time."""
        alone = self.alone
        if (
            alone.bearings >= MIN_SAMPLES
            and alone.one_at_a_time
            and exceeds_share(alone.doubted, alone.bearings, MAX_UNCONFIRMED_REJECTED_SHARE)
        ):
            yield finding(
                CONFIRMED,
                "measurements-unconfirmed",
                count=alone.bearings,
                what=self.what,
                share=alone.share,
                allowed=MAX_UNCONFIRMED_REJECTED_SHARE,
            )

    def _nis(self) -> Iterator[Check]:
        """Generate a finding if the NIS of all sensors together is not as stated, else for single sensors."""
        whole = self.agreements.nis
        if (check := nis_check(f"the {self.what}", whole, self._expected())) is not None:
            yield check
            return
        for name, own in sorted(self.agreements.sensors.items()):
            check = nis_check(f"the {self.what} of {name}", own.nis, own.means.expected, (name,))
            if check is not None and check.status == "failed":
                yield check

    def _motion(self) -> Iterator[Check]:
        """Generate a finding for each target that moves more irregularly than the motion model states."""
        for target, factor in sorted(self.agreements.noise.items()):
            if factor > MAX_MOTION_VARIANCE_FACTOR:
                yield finding(
                    MOTION,
                    "process-noise-small",
                    targets=[target],
                    factor=math.sqrt(factor),
                    allowed=math.sqrt(MAX_MOTION_VARIANCE_FACTOR),
                    setting="process_noise_velocity",
                )

    def _outside(self) -> Iterator[Check]:
        """Generate a finding if bearings intersect outside the room more often than allowed."""
        positions = self.positions
        if positions.rows >= MIN_SAMPLES and exceeds_share(positions.outside, positions.rows, MAX_FLAGGED_SHARE):
            yield finding(
                ROOM,
                "outside-room",
                count=positions.outside,
                rows=positions.rows,
                share=positions.outside / positions.rows,
                allowed=MAX_FLAGGED_SHARE,
            )

    def _through_walls(self) -> Iterator[Check]:
        """Generate a finding for each sensor that detects targets behind walls more often than allowed."""
        for name, (saw, hidden) in sorted(self.positions.hidden.items()):
            if saw >= MIN_SAMPLES and exceeds_share(hidden, saw, MAX_FLAGGED_SHARE):
                yield finding(
                    WALLS,
                    "detection-through-wall",
                    sensors=[name],
                    count=hidden,
                    rows=saw,
                    share=hidden / saw,
                    allowed=MAX_FLAGGED_SHARE,
                )

    def _expected(self) -> float:
        """Return the expected sum of squared residuals of all sensors."""
        return math.fsum(a.means.expected for a in self.agreements.sensors.values())

    def _several(self) -> Iterator[Check]:
        """Generate a finding if bearings without a label that are near no track persist: there may be more targets."""
        persistent = {
            name: share
            for name, share in self.crowd.persistent(MIN_SAMPLES).items()
            if share > MAX_PERSISTENT_CANDIDATE_SHARE
        }
        if not persistent:
            return
        yield finding(
            UNASSOCIATED_CANDIDATES,
            "several-targets",
            sensors=persistent,
            unassociated=self.crowd.unexplained,
            candidates=self.crowd.candidates,
            share=max(persistent.values()),
            allowed=MAX_PERSISTENT_CANDIDATE_SHARE,
        )


def depleted_particles(
    check: str, particles: EffectiveSampleSizes, allowed: float, severity: Severity | None = None
) -> Iterator[Check]:
    """Generate a finding if the effective sample size is too small in more than the share `allowed` of the rows.

    Args:
        check: name of the check.
        particles: histogram of effective sample sizes.
        allowed: share of the rows, 0 to 1.
        severity: severity of the finding; None: the declared one.
    """
    if exceeds_share(particles.few, particles.rows, allowed):
        yield finding(
            check,
            "particles-depleted",
            severity,
            share=particles.few / particles.rows,
            least=MIN_EFFECTIVE_SAMPLE_SIZE,
            median=particles.median,
            allowed=allowed,
        )


def exceeds_share(count: int, of: int, share: float) -> bool:
    """Return whether `count` of `of` exceeds a share significantly (binomial test at `SIGNIFICANCE`)."""
    return of > 0 and count > share * of and float(bdtrc(count - 1, of, share)) < SIGNIFICANCE


def nis_check(what: str, nis: Ratio, expected: float, sensors: tuple[str, ...] = ()) -> Check | None:
    """Return the finding about the variance factor of residuals; None if it is as stated, or with too few samples.

    Args:
        what: name of the measurements, for the message.
        nis: normalised innovation squared with its standard error.
        expected: expected sum of the squares.
        sensors: names of their sensors; empty: all.
    """
    low, high = nis.interval(SIGNIFICANCE)
    if expected < MIN_SAMPLES or NIS_LOW <= nis.value <= NIS_HIGH or low <= 1.0 <= high:
        return None
    factor = math.sqrt(nis.value)
    if nis.value > 1.0:
        return finding(
            NIS,
            "nis-large",
            sensors=sensors,
            what=what,
            factor=factor,
            nis=nis.value,
            nis_error=nis.error,
            allowed=NIS_HIGH,
        )
    factor = 1.0 / factor if factor > 0.0 else math.inf
    return finding(
        NIS,
        "nis-small",
        sensors=sensors,
        what=what,
        factor=factor,
        nis=nis.value,
        nis_error=nis.error,
        allowed=NIS_LOW,
    )
