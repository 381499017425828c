"""The verdict: whether a run's estimates are plausible, as sentences with the number, the limit and the remedy.

Limits have two parts.  A finding is reported only if it is far enough off to matter (the constants of this file), and
if chance cannot make it so: its confidence interval, with the effective number of what it was made from, is beyond that
limit with a probability of `SIGNIFICANCE` for the contrary.  docs/explanation/believe.md has each finding with causes
and remedies.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import bdtrc

from occlog.array_types import NS
from occlog.console.text import counted
from occlog.core.metrics.normalised_squares import Ratio
from occlog.records.scene import Scene
from occlog.records.tables import Diagnostics, Tracks
from occlog.records.verdicts import Check, Severity, finding, outcome

from .bearings import ComparedBearings, ResidualStatistics, UnassociatedCandidates, UnconfirmedBearings, pose_shares
from .estimates import CLEAR_SIGMAS, MIN_EFFECTIVE_SAMPLE_SIZE, WORDS, EffectiveSampleSizes, PositionConsistency

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
PARTICLES, RESTARTED, TIME_GAPS = "effective number of particles", "restarts of the filter", "gaps between rows"
NEVER_SEEN, SELECTED, FLAGGED = "targets that no sensor sees", "views of the selected cameras", "flags of the rows"
REJECTED_MEASUREMENTS, CONFIRMED, NIS = (
    "rejected measurements",
    "measurements of one sensor at a time",
    "residuals (NIS)",
)
MOTION, ROOM, WALLS = "motion noise", "positions outside the room", "lines of sight through walls"
UNASSOCIATED_CANDIDATES = "candidates that no track explains"
"""Names of checks."""
ROWS = {
    "contradiction": "no position holds all constraints, and what was seen there was omitted; check poses and labels",
    "wall": "no way around a wall was found; more states may help (fill_s)",
    "unfinished": "the search did not converge; allow more iterations",
}
"""Values of `fallback` of which a verdict speaks if any row has them, and what they say."""
FLAGS_OF_FALSE_BEARINGS = {
    "doubted": "fewer than half of the bearings are accepted; check poses, clocks and labels",
    "unchecked": "two measurements alone fix the position, and none of the others agrees: one of the two may be false, "
    "which the covariance does not say; add stations, or follow the target over time (apf, map)",
}
"""Values of `fallback` that single false bearings make, and of which a verdict speaks from a share of the rows on."""
FLAGS_OF_POSSIBLE_OUTLIERS = {
    "contested": "a measurement that is accepted may be false: another position is possible where fewer agree, or they "
    "scatter more than stated, which the covariance does not say; leave these rows out, add stations, or follow the "
    "target over time (apf, map)",
}
"""Values of `fallback` that some rows of honest data have, too."""
FLAGS_WITH_RIGHT_COVARIANCE = {
    "unobservable": "the measurements do not determine the position, and the covariance says so; add sensors",
    "ambiguous": "measurements fit several positions, of which the row has the most probable, and the covariance holds "
    "all: there are two ranges alone, stations are in line, one of a few values is false, or noise is as large as the "
    "distances; add stations off the line, or follow the target over time (apf, map)",
}
"""Values of `fallback` that need care, though the covariance is right."""


@dataclass
class ConsistencyEvidence:
    """Evidence on a run's estimates, accumulated over a stream of tables.

    Attributes:
        rows: estimates.
        fallbacks: rows by the value of `fallback`.
        doubts: rows by the value of `doubt`.
        targets: ids of the targets of the rows.
        seen: of these, whom a sensor saw.
        span_ns: first and last time.
        selected: rows for which at least two cameras were selected.
        blind: of these, rows in which fewer than two sensors saw the target.
        particles: effective numbers.
        agreements: residuals of the bearings.
        alone: bearings that no other sensor can confirm.
        crowd: candidates that are left.
        places: where the bearings of a time step meet.
        distances: residuals are also of measurements that are no directions, so that nothing is said of `places`.
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
    places: PositionConsistency = field(default_factory=PositionConsistency)
    distances: bool = False
    diagnosed: bool = False

    def fared(self, part: Diagnostics) -> None:
        """Count rows of diagnostics."""
        self.diagnosed = True
        self.rows += len(part)
        self.targets.update(part.target_id.tolist())
        self.seen.update(part.target_id[part.n_seen > 0].tolist())
        if len(part):
            first, last = int(part.t_ns.min()), int(part.t_ns.max())
            before = self.span_ns or (first, last)
            self.span_ns = min(first, before[0]), max(last, before[1])
        self.fallbacks.update(f for f in part.fallback.tolist() if f)
        self.doubts.update(d for text in part.doubt.tolist() if text for d in text.split(","))
        several = np.char.find(part.selected, ",") >= 0
        self.selected += int(np.count_nonzero(several))
        self.blind += int(np.count_nonzero(several & (part.n_seen < 2)))
        self.particles.add(part.ess)

    def saw(self, tracks: Tracks, compared: ComparedBearings, scene: Scene) -> None:
        """Count residuals of bearings, and candidates that are left."""
        self.agreements.add(compared.residuals, pose_shares(tracks, scene))
        self.alone.add(compared.residuals)
        self.crowd.add(compared.frames)
        if not self.distances:
            self.places.add(tracks, compared.residuals, scene)

    def figures(self) -> dict[str, object]:
        """Figures of a summary."""
        found: dict[str, object] = {}
        if self.particles.rows:
            found["median_effective_particles"] = self.particles.median
            found["share_depleted"] = self.particles.few / self.particles.rows
        told = self.agreements.figures()
        found |= {name.replace("bearings", self.what): value for name, value in told.items()}
        if self.crowd.frames:
            found["candidates_unexplained_per_frame"] = self.crowd.unexplained
        return found

    @property
    def what(self) -> str:
        """What residuals are of."""
        return "measurements" if self.distances else "bearings"

    def checks(self, *, one_target: bool, smoothed: bool = False) -> tuple[Check, ...]:
        """Every check that the diagnostics and the residuals allow, with what it found.

        Args:
            one_target: candidates without a label are taken for one target's by the method.
            smoothed: estimates were made from trajectories drawn backwards through the filter's particles.
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
            *outcome(REJECTED_MEASUREMENTS, self._not_believed(), unless=unseen, bearings=seen),
            *outcome(CONFIRMED, self._unconfirmed(), unless=few if self.alone.bearings < MIN_SAMPLES else ""),
            *outcome(
                NIS,
                self._nis(),
                unless=few if self._expected() < MIN_SAMPLES else "",
                nis=self.agreements.nis.value,
                allowed=NIS_HIGH,
            ),
            *outcome(MOTION, self._motion(), unless="" if self.agreements.noise else "the method does not estimate it"),
            *outcome(
                ROOM, self._outside(), unless=few if self.places.rows < MIN_SAMPLES else "", outside=self.places.outside
            ),
            *outcome(
                WALLS,
                self._through_walls(),
                unless="" if any(saw >= MIN_SAMPLES for saw, _ in self.places.hidden.values()) else few,
            ),
            *outcome(
                UNASSOCIATED_CANDIDATES,
                self._several() if one_target else (),
                unless=crowded or ("" if self.crowd.frames else "no frame has candidates without a label"),
            ),
        )

    def _depleted(self, smoothed: bool) -> Iterator[Check]:
        """Particles that ran out."""
        few, rows, most = (
            self.particles.few,
            self.particles.rows,
            MAX_DEPLETED_SHARE_SMOOTHED if smoothed else MAX_DEPLETED_SHARE,
        )
        if exceeds_share(few, rows, most):
            whose = (
                "their covariances and those of smoothed rows before them are" if smoothed else "their covariances are"
            )
            yield finding(
                PARTICLES,
                "warning",
                "depleted",
                f"{few / rows:.0%} of the rows rest on fewer than {MIN_EFFECTIVE_SAMPLE_SIZE:.0f} effective "
                "particles (median "
                f"{self.particles.median:.0f}; allowed in {most:.0%} of the rows): {whose} too "
                "small; use more particles, or check the noise that is stated, which may be too small",
                share=few / rows,
                allowed=most,
            )

    def _restarts(self) -> Iterator[Check]:
        """Rows in which the target was lost."""
        restarts = self.fallbacks["restart"]
        if exceeds_share(restarts, self.rows, MAX_RESTART_SHARE):
            yield finding(
                RESTARTED,
                "warning",
                "restarts",
                f"the target was lost and searched again in {restarts} of {self.rows} rows (allowed: "
                f"{MAX_RESTART_SHARE:.0%}); "
                "the motion or the noise that is stated is wrong, or the bearings are not of one target",
                share=restarts / self.rows,
                allowed=MAX_RESTART_SHARE,
            )

    def _gaps(self) -> Iterator[Check]:
        """Rows so far apart that nothing is filtered."""
        gaps = self.fallbacks["gap"]
        if self.span_ns is not None and gaps >= MIN_GAPS and gaps >= MAX_GAP_SHARE * self.rows:
            apart = (self.span_ns[1] - self.span_ns[0]) / NS * len(self.targets) / self.rows
            yield finding(
                TIME_GAPS,
                "warning",
                "gaps",
                f"{gaps} of {self.rows} rows come after a gap, and the filter restarts there: the rows of a target "
                f"are {apart:.3g} s apart on average, so that nothing is filtered; take each time step alone (fix), or "
                "allow longer gaps (max_gap_s) with a motion that holds for so long; if times are in "
                "another unit, state it by --input-units ms",
                share=gaps / self.rows,
                allowed=MAX_GAP_SHARE,
            )

    def _unseen(self) -> Iterator[Check]:
        """Targets that no sensor saw."""
        unseen = sorted(self.targets - self.seen)
        if unseen and not self.distances:
            yield finding(
                NEVER_SEEN,
                "note",
                "never-seen",
                f"{counted(len(unseen), 'target')} of {len(self.targets)}, the first {unseen[0]}, no sensor saw at any "
                "time: the rows say where targets can be, and their covariances are as wide; add sensors, or leave "
                "out who was not seen",
                targets=unseen[:MAX_NAMED],
            )

    def _blind(self) -> Iterator[Check]:
        """Cameras that were selected in vain."""
        if exceeds_share(self.blind, self.selected, MAX_BLIND_SHARE):
            yield finding(
                SELECTED,
                "warning",
                "selection",
                f"in {self.blind} of {self.selected} rows (allowed: {MAX_BLIND_SHARE:.0%}) fewer than two sensors "
                "see the "
                "target, although more cameras were selected: the selection is for longer than the target stays in "
                "view, or the policy ignores views; select by greedy, more cameras, or more often",
                share=self.blind / self.selected,
                allowed=MAX_BLIND_SHARE,
            )

    def _rows(self) -> Iterator[Check]:
        """Rows with a flag."""
        kinds: tuple[tuple[Mapping[str, str], Counter[str], float, Severity], ...] = (
            (WORDS, self.doubts, MAX_FLAGGED_SHARE, "warning"),
            (FLAGS_OF_FALSE_BEARINGS, self.fallbacks, MAX_FLAGGED_SHARE, "warning"),
            (FLAGS_OF_POSSIBLE_OUTLIERS, self.fallbacks, MAX_POSSIBLE_OUTLIER_SHARE, "warning"),
            (ROWS, self.fallbacks, 0.0, "warning"),
            (FLAGS_WITH_RIGHT_COVARIANCE, self.fallbacks, 0.0, "note"),
        )
        for words, found, least, severity in kinds:
            for code, text in words.items():
                if found[code] > least * self.rows:
                    share = f" (allowed: {least:.0%})" if least else ""
                    sentence = f"{found[code]} of {self.rows} rows{share}: {code}: {text}"
                    yield finding(FLAGGED, severity, code, sentence, share=found[code] / self.rows, allowed=least)
                elif found[code] and words is WORDS:
                    said = f"{found[code]} of {self.rows} rows are not to be accepted (the diagnostics say which)"
                    rare = found[code] / self.rows
                    yield finding(FLAGGED, "note", code, f"{said}: {code}: {text}", share=rare, allowed=least)

    def _not_believed(self) -> Iterator[Check]:
        """Sensors whose bearings are rejected."""
        for name, own in sorted(self.agreements.sensors.items()):
            if own.bearings >= MIN_SAMPLES and exceeds_share(
                own.bearings - own.believed, own.bearings, MAX_REJECTED_SHARE
            ):
                yield finding(
                    REJECTED_MEASUREMENTS,
                    "warning",
                    "not-believed",
                    f"{name}: {own.doubted:.0%} of {own.bearings} {self.what} are rejected (allowed: "
                    f"{MAX_REJECTED_SHARE:.0%}); its pose, its clock or its labels may be wrong, or the target "
                    "was lost",
                    sensors=[name],
                    share=own.doubted,
                    allowed=MAX_REJECTED_SHARE,
                )

    def _unconfirmed(self) -> Iterator[Check]:
        """False bearings where one sensor at a time sees the target."""
        alone = self.alone
        if (
            alone.bearings >= MIN_SAMPLES
            and alone.one_at_a_time
            and exceeds_share(alone.doubted, alone.bearings, MAX_UNCONFIRMED_REJECTED_SHARE)
        ):
            yield finding(
                CONFIRMED,
                "warning",
                "unconfirmed",
                f"{alone.share:.0%} of {alone.bearings} {self.what} are rejected (allowed: "
                f"{MAX_UNCONFIRMED_REJECTED_SHARE:.0%} where "
                f"one sensor at a time sees the target): the motion alone distinguishes false {self.what} from true "
                "ones; "
                "others may be false, too, and covariances too small; add sensors that see the target at the same "
                "time, or check identities and the detector's false alarms",
                share=alone.share,
                allowed=MAX_UNCONFIRMED_REJECTED_SHARE,
            )

    def _nis(self) -> Iterator[Check]:
        """Residuals that are not as stated, of all sensors, or else of single ones."""
        whole = self.agreements.nis
        if (said := nis_check(f"the {self.what}", whole, self._expected())) is not None:
            yield said
            return
        for name, own in sorted(self.agreements.sensors.items()):
            said = nis_check(f"the {self.what} of {name}", own.nis, own.means.expected, (name,))
            if said is not None and said.status == "failed":
                yield said

    def _motion(self) -> Iterator[Check]:
        """Targets that move more irregularly than stated."""
        for target, factor in sorted(self.agreements.noise.items()):
            if factor > MAX_MOTION_VARIANCE_FACTOR:
                yield finding(
                    MOTION,
                    "warning",
                    "motion",
                    f"target {target} moves {math.sqrt(factor):.1f} times as irregularly as the settings of its motion "
                    f"say (allowed: {math.sqrt(MAX_MOTION_VARIANCE_FACTOR):.0f} times); state a larger acceleration",
                    targets=[target],
                    factor=math.sqrt(factor),
                    allowed=math.sqrt(MAX_MOTION_VARIANCE_FACTOR),
                )

    def _outside(self) -> Iterator[Check]:
        """Bearings that meet outside the room."""
        told = self.places
        if told.rows >= MIN_SAMPLES and exceeds_share(told.outside, told.rows, MAX_FLAGGED_SHARE):
            yield finding(
                ROOM,
                "warning",
                "outside-room",
                f"in {told.outside} of {told.rows} rows (allowed: {MAX_FLAGGED_SHARE:.0%}) the bearings meet more "
                f"than {CLEAR_SIGMAS:g} "
                "standard deviations outside the room, which estimates stay in: the target has left it, the room of "
                "the scene is too small, or poses are wrong",
                share=told.outside / told.rows,
                allowed=MAX_FLAGGED_SHARE,
            )

    def _through_walls(self) -> Iterator[Check]:
        """Sensors that see targets through walls."""
        for name, (saw, hidden) in sorted(self.places.hidden.items()):
            if saw >= MIN_SAMPLES and exceeds_share(hidden, saw, MAX_FLAGGED_SHARE):
                yield finding(
                    WALLS,
                    "warning",
                    "through-wall",
                    f"in {hidden} of {saw} rows (allowed: {MAX_FLAGGED_SHARE:.0%}) {name} sees the target, "
                    "although it is behind "
                    "a wall or static occluder of the scene where the bearings meet; the track avoids the wall and is "
                    "wrong if the wall is: check the scene's occluders, room and poses",
                    sensors=[name],
                    share=hidden / saw,
                    allowed=MAX_FLAGGED_SHARE,
                )

    def _expected(self) -> float:
        return math.fsum(a.means.expected for a in self.agreements.sensors.values())

    def _several(self) -> Iterator[Check]:
        """Candidates that stay, and that no track explains."""
        persistent = {
            name: share
            for name, share in self.crowd.persistent(MIN_SAMPLES).items()
            if share > MAX_PERSISTENT_CANDIDATE_SHARE
        }
        if not persistent:
            return
        yield finding(
            UNASSOCIATED_CANDIDATES,
            "warning",
            "several-targets",
            f"the candidates cannot be one target: {self.crowd.unexplained:.1f} of {self.crowd.candidates:.1f} in a "
            f"frame are near no track, and in {', '.join(persistent)} they stay from frame to frame (in "
            f"{max(persistent.values()):.0%} of the frames; allowed: {MAX_PERSISTENT_CANDIDATE_SHARE:.0%}); "
            "follow all people "
            "(method jipda, from the boxes), label the candidates, or say where the target is initially",
            sensors=persistent,
            share=max(persistent.values()),
            allowed=MAX_PERSISTENT_CANDIDATE_SHARE,
        )


def exceeds_share(count: int, of: int, share: float) -> bool:
    """Whether a count exceeds a share significantly: with a probability below `SIGNIFICANCE` if the share were true."""
    return of > 0 and count > share * of and float(bdtrc(count - 1, of, share)) < SIGNIFICANCE


def nis_check(what: str, nis: Ratio, expected: float, sensors: tuple[str, ...] = ()) -> Check | None:
    """Variance factor of residuals; None if they are as stated, or too few.

    Args:
        what: name of the measurements.
        nis: their normalised square.
        expected: sum of squares that is expected.
        sensors: names of their sensors; empty: all.
    """
    low, high = nis.interval(SIGNIFICANCE)
    if expected < MIN_SAMPLES or NIS_LOW <= nis.value <= NIS_HIGH or low <= 1.0 <= high:
        return None
    factor, kind = math.sqrt(nis.value), "bearings" if "bearings" in what else "measurements"
    found = f"NIS {nis.value:.2g} +- {nis.error:.1g}, expected 1, allowed {NIS_LOW:g} to {NIS_HIGH:g}"
    if nis.value > 1.0:
        return finding(
            NIS,
            "warning",
            "nis-large",
            f"{what} are {factor:.1f} times as far from the track as their standard deviations say ({found}): the "
            "noise that is stated is too small, a pose or a clock is wrong, or the track is wrong; state a "
            "larger noise, or check the calibration",
            sensors=sensors,
            nis=nis.value,
            allowed=NIS_HIGH,
        )
    return finding(
        NIS,
        "note",
        "nis-small",
        f"{what} have standard deviations that are {1.0 / factor if factor > 0.0 else math.inf:.1f} times too large "
        f"({found}): covariances are too large, and false {kind} pass; state a smaller noise",
        sensors=sensors,
        nis=nis.value,
        allowed=NIS_LOW,
    )
