"""Tracks in the world, with covariance, from tracks in the images of several calibrated views.

[Qu] Sec. 5 names this step, and leaves open how.

Targets that may have taken each other's identities.

Trackers that are on another target together agree with each other, so that one time alone does
not show it.  But they mostly get there one by one, through times at which views contradict each
other or at which all but one have lost the target.  While that lasts, a target is exchanged at a
constant rate; from then on it may be where any of the other targets is.

Verdict on tracks in the world: what doubts their rows have, and which targets one view alone supports.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words
from occlog.measure.epipolar.from_scene import ideal_pixels_anywhere
from occlog.records.declared.views import ViewTracks
from occlog.records.scene import Camera, Scene
from occlog.records.tables import FusedTracks
from occlog.records.verdicts import Check, finding

from .config import GroundConfig, in_scene
from .triangulation import (
    BEHIND,
    DISAGREEING,
    MET,
    NEAR_PARALLEL,
    TOO_FEW,
    CameraRig,
    CentresInViews,
    GroundPosition,
    TargetHeightPrior,
    ViewContradictions,
    ViewOdds,
    covariances_with_contradiction,
    triangulate_in_space,
)

MIN_CONTRADICTION_PROBABILITY = 0.5
"""Views contradict each other if one of them is on something else with at least this probability."""
MAX_GAP_S = 1.0
"""Longer times without a row count as this long [s]."""


class LastGroundState(NamedTuple):
    """State of a target after its last row: its time, the switch probability then, and whether several views showed it.

    `exchanged` is the probability that its identity has been exchanged with another target's; `together` is true once
    several views have shown it at one time.
    """

    t_ns: int
    exchanged: float  # probability
    together: bool  # several views have shown it at once


class SwitchProbabilities:
    """Running probabilities that each target's identity was exchanged with another's.

    In s seconds during which a target's views contradict each other with probability c, its probability p grows to 1 -
    (1 - p) exp(-rate c s). While a single view shows a target that several have shown before, a fixed factor takes the
    place of c. Probabilities never decrease.
    """

    def __init__(self, rate: float, alone: float, start: float) -> None:
        """Start without targets.

        Args:
            rate: rate of identity exchanges where views contradict each other [1/s].
            alone: share of it where one view alone shows a target that several have shown before.
            start: probability that the trackers of a target begin on different ones.
        """
        self._rate, self._alone, self._start = rate, alone, start
        self._known: dict[int, LastGroundState] = {}

    def update(self, t_ns: int, targets: Ints, contested: Floats, views: Ints) -> Floats:
        """Advance the targets of one time step, and return (K,) probabilities that their identities were exchanged.

        The state is changed in place. A contradiction below `MIN_CONTRADICTION_PROBABILITY` counts as none, and more
        than `MAX_GAP_S` since a target's last row counts as `MAX_GAP_S`.

        Args:
            t_ns: the time [ns].
            targets: (K,) identities, each once.
            contested: (K,) probability that one of a target's views is on something else.
            views: (K,) number of views that show each target.
        """
        out = np.zeros(len(targets))
        rows = zip(targets.tolist(), contested.tolist(), views.tolist(), strict=True)
        for k, (target, doubt, several) in enumerate(rows):
            last = self._known.get(target, LastGroundState(t_ns, self._start, False))
            seconds = min((t_ns - last.t_ns) / NS, MAX_GAP_S)
            contradiction = doubt if doubt >= MIN_CONTRADICTION_PROBABILITY else 0.0
            left_alone = self._alone if last.together else 0.0
            strength = contradiction if several > 1 else left_alone
            out[k] = 1.0 - (1.0 - last.exchanged) * np.exp(-self._rate * strength * seconds)
            self._known[target] = LastGroundState(t_ns, float(out[k]), last.together or several > 1)
        return out


def spread_over_others(xyz: Floats, covariance: Floats, exchanged: Floats) -> Floats:
    """Return (K, 3, 3) covariances widened for the chance that a target is at the position of another one.

    The sum of the covariance and p times the mean outer product of the differences to the other K - 1 positions.

    Args:
        xyz: (K, 3) positions of the targets at one time, in the world.
        covariance: (K, 3, 3) of the positions without exchanges.
        exchanged: (K,) probability p that a target is at one of the other positions, each as likely.
    """
    off = xyz[None, :, :] - xyz[:, None, :]
    spread = np.einsum("kni,knj->kij", off, off) / max(len(xyz) - 1, 1)
    return np.asarray(covariance + exchanged[:, None, None] * spread)


WHY = {TOO_FEW: "single_view", NEAR_PARALLEL: "parallel", BEHIND: "behind", DISAGREEING: "inconsistent"}
"""Names in `GroundTracksPart.counts` of the reasons why a target has no position at a time."""

SINGLE_VIEW, INCONSISTENT_VIEWS, POSSIBLE_SWITCH = "single_view", "inconsistent_views", "possible_switch"
"""Values of the column `quality_flags`, in the order of the column."""
MIN_SWITCH_PROBABILITY = 0.25
"""A target is flagged as exchanged from this probability on."""


class GroundTracksPart(NamedTuple):
    """Triangulated tracks of some time steps, with counts and the sum of their squared residuals.

    `counts` has `times`, pairs of target and time with a tracker; `views_N`, positions from N views; `skipped`, views
    that did not agree with the others; and, by the names in `WHY`, target times without a position. `nis` is the sum of
    the squared standardised residuals of positions from several views, `freedom` its degrees of freedom.
    """

    tracks: FusedTracks
    counts: Counter[str]
    nis: float  # sum of the squared standardised residuals of positions by several views
    freedom: int  # degrees of freedom of that sum


def ground_tracks(
    chunks: Iterable[ViewTracks], scene: Scene, config: GroundConfig | None = None, cameras: Sequence[str] = ()
) -> Iterator[GroundTracksPart]:
    """Generate world positions with covariances, triangulated from image tracks, some time steps at a time.

    Positions use one time step each; covariances also the possible identity exchanges at earlier ones. The result does
    not depend on the division into chunks.

    Args:
        chunks: view tracks in the order of time; rows in which a tracker has left or lost its target are not used.
        scene: with the poses and lenses of the cameras.
        config: settings; None: the defaults.
        cameras: use only these; none: all that have rows.

    Raises:
        InputError: a camera that the scene does not have or that has no pose, or times that go back.
    """
    config = in_scene(config or GroundConfig(), scene)
    window = round(config.window_s * 1e9)
    rest, last_ns, seen = ViewTracks.empty(), None, 0
    exchanges = SwitchProbabilities(
        config.identity_switch_rate, config.single_view_switch_factor, config.initial_switch_probability
    )
    for chunk in chunks:
        if not len(chunk):
            continue
        _check(chunk, scene, cameras, last_ns, seen)
        last_ns, seen = int(chunk.t_ns[-1]), seen + len(chunk)
        table = ViewTracks.concat([rest, chunk.take(_wanted(chunk, cameras))])
        if not len(table):
            continue
        starts = _starts(table, window)
        # The last time may go on in the next chunk: keep its rows
        yield _part(table.take(slice(0, starts[-1])), starts[:-1], scene, config, exchanges)
        rest = table.take(slice(starts[-1], None))
    if len(rest):
        yield _part(rest, np.zeros(1, dtype=np.int64), scene, config, exchanges)


def _wanted(chunk: ViewTracks, cameras: Sequence[str]) -> Bools:
    """Return (R,) booleans: the row is of a camera in `cameras` (empty: any), and its tracker has not left or ended."""
    wanted = ~np.isin(chunk.lifecycle, ("left", "terminated"))
    return wanted & np.isin(chunk.sensor, list(cameras)) if cameras else wanted


def _check(chunk: ViewTracks, scene: Scene, cameras: Sequence[str], last_ns: int | None, seen: int) -> None:
    """Raise InputError if times decrease, or a camera in use has no pose.

    Args:
        chunk: rows of view tracks, not empty.
        scene: scene with the poses of the cameras.
        cameras: names of those in use; empty: all.
        last_ns: time of the last row of earlier chunks; None: there is none.
        seen: number of earlier rows, for the message.
    """
    if last_ns is not None and chunk.t_ns[0] < last_ns:
        raise InputError(
            f"view tracks: row {seen}: time {time_words(chunk.t_ns[0])} is earlier than the preceding "
            f"{time_words(last_ns)}; sort by t_ns",
            id="unsorted-times",
        )
    for name in np.unique(chunk.sensor).tolist():
        if (not cameras or name in cameras) and not scene.camera(name).placed:
            raise InputError(
                f"view tracks: camera {name} has no pose in the scene; calibrate it, or leave it out", id="missing-pose"
            )


def _starts(table: ViewTracks, window_ns: int) -> Ints:
    """Return the indices of the rows at which time steps begin, for rows in the order of time.

    A time step has the rows within `window_ns` of its first time; it ends sooner where a camera would appear twice.
    With a window of 0 or less each distinct time is a step.
    """
    times, first = np.unique(table.t_ns, return_index=True)
    if window_ns <= 0:
        return first.astype(np.int64)
    starts, begin, sensors = [0], int(times[0]), set[str]()
    for t_ns, row, end in zip(times.tolist(), first.tolist(), [*first[1:].tolist(), len(table)], strict=True):
        here = set(table.sensor[row:end].tolist())
        if t_ns - begin > window_ns or here & sensors:
            starts.append(row)
            begin, sensors = t_ns, set()
        sensors |= here
    return np.array(starts, dtype=np.int64)


def _part(
    table: ViewTracks, starts: Ints, scene: Scene, config: GroundConfig, exchanges: SwitchProbabilities
) -> GroundTracksPart:
    """Triangulate all targets at the time steps that begin at rows `starts` of `table`, each at its step's last time.

    Args:
        table: R rows of view tracks in the order of time; empty: an empty part.
        starts: (S,) index of the first row of each time step, increasing from 0.
        scene: scene with the poses of the cameras.
        config: settings, with the height filled in (`in_scene`).
        exchanges: probabilities of identity exchange so far; updated in place, time step by time step.
    """
    if not len(table):
        return GroundTracksPart(FusedTracks.empty(), Counter(), 0.0, 0)
    step = np.searchsorted(starts, np.arange(len(table)), side="right") - 1
    t_ns = table.t_ns[np.append(starts[1:], len(table)) - 1]
    keys, point = np.unique(np.column_stack([step, table.target_id]), axis=0, return_inverse=True)
    names, view = np.unique(table.sensor, return_inverse=True)
    cameras = [scene.camera(str(name)) for name in names]
    sights = _sights(table, point.reshape(-1), view, len(keys), cameras, config.centre_error_share)
    height = (
        TargetHeightPrior(config.target_height, config.sigma_target_height)
        if config.target_height and config.sigma_target_height
        else None
    )
    rig, angle = _rig(cameras), np.radians(config.min_triangulation_angle_deg)
    met = triangulate_in_space(sights, rig, height, config.false_rejection_probability, angle)
    odds = ViewOdds(config.view_inlier_probability, _agreement(config), _areas(cameras))
    contest = covariances_with_contradiction(met, sights, rig, height, odds, float(np.sin(angle)))
    times, targets = t_ns[keys[:, 0]], keys[:, 1]
    covariance, exchanged = _possible_identity_switches(exchanges, keys, times, met, contest, sights)
    met = met._replace(covariance=covariance)
    doubts = np.column_stack(
        [
            met.used.sum(axis=1) == 1,
            (contest.contested >= MIN_CONTRADICTION_PROBABILITY) | (sights.there & ~met.used).any(axis=1),
            exchanged > MIN_SWITCH_PROBABILITY,
        ]
    )
    several = (met.status == MET) & (met.used.sum(axis=1) > 1)
    return GroundTracksPart(
        tracks=_tracks(met, times, targets, [c.name for c in cameras], doubts),
        counts=_counts(met, sights),
        nis=float(met.misfit[several].sum()),
        freedom=int((2 * met.used[several].sum(axis=1) - 3).sum()),
    )


def _agreement(config: GroundConfig) -> float:
    """Return the variance of the residuals of views on the same target, as a share (at most 1) of the variance stated.

    It is the squared ratio of `common_error_share` to `centre_error_share`; 1 if the latter is 0.
    """
    return (
        min(1.0, (config.common_error_share / config.centre_error_share) ** 2)
        if config.centre_error_share > 0.0
        else 1.0
    )


def _areas(cameras: Sequence[Camera]) -> Floats:
    """Return (V,) image areas of the cameras [px^2], at least 1.

    Where the image size is unknown, it is taken as twice the principal point's coordinates.
    """
    sizes = [c.image_size or (2.0 * c.principal_px[0], 2.0 * c.principal_px[1]) for c in cameras]
    return np.array([max(float(w * h), 1.0) for w, h in sizes])


def _possible_identity_switches(
    exchanges: SwitchProbabilities,
    keys: Ints,
    t_ns: Ints,
    met: GroundPosition,
    contest: ViewContradictions,
    sights: CentresInViews,
) -> tuple[Floats, Floats]:
    """Return (N, 3, 3) covariances widened for possible identity exchanges, and (N,) probabilities of these.

    Points without a position keep their covariance, NaN.

    Args:
        exchanges: running probabilities; updated in place, time step by time step.
        keys: (N, 2) time step and target of each point, sorted.
        t_ns: (N,) times.
        met: triangulated positions of the N points.
        contest: their covariances without exchanges, and the probabilities that views contradict each other.
        sights: image centres of the N points in V views.
    """
    covariance, exchanged = contest.covariance.copy(), np.zeros(len(keys))
    views = sights.there.sum(axis=1)
    for rows in np.split(np.arange(len(keys)), np.flatnonzero(np.diff(keys[:, 0])) + 1):
        exchanged[rows] = exchanges.update(int(t_ns[rows[0]]), keys[rows, 1], contest.contested[rows], views[rows])
        placed = rows[met.status[rows] == MET]
        covariance[placed] = spread_over_others(met.xyz[placed], covariance[placed], exchanged[placed])
    return covariance, exchanged


def _rig(cameras: Sequence[Camera]) -> CameraRig:
    """Return the parameters of V cameras as arrays: focal lengths, principal points, rotations and positions."""
    return CameraRig(
        focal=np.array([c.focal_px for c in cameras]),
        principal=np.array([c.principal_px for c in cameras]),
        rotation=np.array([c.rotation for c in cameras]),
        centre=np.array([c.position for c in cameras]),
    )


def _sights(
    table: ViewTracks, point: Ints, view: Ints, points: int, cameras: Sequence[Camera], model_share: float
) -> CentresInViews:
    """Return undistorted image centres (N, V, 2) of N points in V views, and their covariances (N, V, 2, 2) [px^2].

    A point is a target at a time step. Each covariance is the tracker's plus that of the target's centre about the
    ellipse's centre, carried through the undistortion. A view without a row of the point, or with a centre that cannot
    be undistorted, is marked as not showing it.

    Args:
        table: R rows of view tracks.
        point: (R,) index of each row's point, 0 to N - 1.
        view: (R,) index of each row's camera.
        points: N.
        cameras: V cameras.
        model_share: standard deviation of the target's centre about the ellipse's, as a share of the half axes.
    """
    shape = (points, len(cameras))
    there, pixels = np.zeros(shape, dtype=np.bool_), np.zeros((*shape, 2))
    covariance = np.broadcast_to(np.eye(2), (*shape, 2, 2)).copy()
    own = _covariances(table) + model_share**2 * _shapes(table)
    for k, camera in enumerate(cameras):
        rows = np.flatnonzero(view == k)
        centres = np.column_stack([table.x_px[rows], table.y_px[rows]])
        ideal, slopes = _ideal(camera, centres)
        good = np.isfinite(ideal).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
        kept = rows[good]
        there[point[kept], k], pixels[point[kept], k] = True, ideal[good]
        covariance[point[kept], k] = slopes[good] @ own[kept] @ slopes[good].transpose(0, 2, 1)
    return CentresInViews(there, pixels, covariance)


def _covariances(table: ViewTracks) -> Floats:
    """Return (R, 2, 2) covariances of the ellipse centres of view tracks [px^2], plus (0.01 px)^2 on the diagonal.

    The addition keeps them from being singular.
    """
    xx, xy, yy = table.cov_xx_px, table.cov_xy_px, table.cov_yy_px
    return np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2) + 1e-4 * np.eye(2)


def _shapes(table: ViewTracks) -> Floats:
    """Return (n, 2, 2) shape matrices R diag(a^2, b^2) R^T of the ellipses of n view tracks [px^2].

    a and b are the half axes, and R turns by the angle rho of axis a.
    """
    c, s = np.cos(table.rho), np.sin(table.rho)
    a2, b2 = table.a_px**2, table.b_px**2
    xy = c * s * (a2 - b2)
    return np.stack([c * c * a2 + s * s * b2, xy, xy, s * s * a2 + c * c * b2], axis=1).reshape(-1, 2, 2)


def _ideal(camera: Camera, centres: Floats) -> tuple[Floats, Floats]:
    """Return (R, 2) undistorted pixels of recorded `centres` (R, 2), and the (R, 2, 2) Jacobians of this mapping.

    [r, i, j] is the derivative of undistorted coordinate i with respect to recorded coordinate j, by central
    differences over one pixel; the identity for a camera without distortion. NaN where a pixel cannot be undistorted.
    """
    ideal = ideal_pixels_anywhere(camera, centres)
    if camera.straight:
        return ideal, np.broadcast_to(np.eye(2), (len(centres), 2, 2))
    # Central differences over one pixel
    steps = [0.5 * np.eye(2)[axis] for axis in range(2)]
    changes = [
        ideal_pixels_anywhere(camera, centres + step) - ideal_pixels_anywhere(camera, centres - step) for step in steps
    ]
    return ideal, np.stack(changes, axis=2)


def _tracks(met: GroundPosition, t_ns: Ints, target: Ints, names: Sequence[str], doubts: Bools) -> FusedTracks:
    """Return output rows of the points with a position, in the order given; velocities are NaN (unknown).

    Args:
        met: positions and covariances of N points.
        t_ns: (N,) times.
        target: (N,) identities of the targets.
        names: names of the V views, for the column `seen_by`.
        doubts: (N, 3) quality flags: from a single view, from views that contradict each other, identity possibly
            switched.
    """
    good = np.flatnonzero(met.status == MET)
    nan = np.full(len(good), np.nan)
    cov = met.covariance[good]
    (x, y, z), entries = met.xyz[good].T, ((0, 0, "xx"), (0, 1, "xy"), (1, 1, "yy"), (0, 2, "xz"), (1, 2, "yz"))
    return FusedTracks.of(
        t_ns=t_ns[good],
        target_id=target[good].astype(np.int32),
        x=x,
        y=y,
        z=z,
        vx=nan,
        vy=nan,
        **{f"cov_{name}": cov[:, i, j] for i, j, name in entries},
        cov_zz=cov[:, 2, 2],
        seen_by=_joined(met.used[good], names),
        quality_flags=_joined(doubts[good], (SINGLE_VIEW, INCONSISTENT_VIEWS, POSSIBLE_SWITCH)),
    )


def _joined(mask: Bools, words: Sequence[str]) -> Strings:
    """Return (N,) strings: for each row of `mask` (N, W) the words of its True columns, comma-separated."""
    return np.array([",".join(w for w, has in zip(words, row, strict=True) if has) for row in mask.tolist()], np.str_)


def _counts(met: GroundPosition, sights: CentresInViews) -> Counter[str]:
    """Return the counts of N points, pairs of target and time, by name.

    `times`: N. `views_K`: positions from K views. `skipped`: views that show a point with a position and were not used.
    `single_view`, `parallel`, `behind`, `inconsistent`: points without a position, by reason.
    """
    good = met.status == MET
    counts: Counter[str] = Counter(times=len(good))
    for views in met.used.sum(axis=1)[good].tolist():
        counts[f"views_{views}"] += 1
    counts["skipped"] = int((sights.there & ~met.used)[good].sum())
    for status, why in WHY.items():
        counts[why] = int((met.status == status).sum())
    return counts


MIN_SINGLE_VIEW_SHARE = 0.9
"""One view alone supports a target if it alone made this share of its rows."""
MIN_FLAGGED_SHARE = 0.1
"""Minimum share of flagged rows for a warning."""
MAX_NIS_RATIO = 1.5
"""A line warns where squared standardised residuals are so many times as large as stated."""
FLAGS = {
    SINGLE_VIEW: "ground-single-view",
    INCONSISTENT_VIEWS: "ground-inconsistent-views",
    POSSIBLE_SWITCH: "ground-possible-switch",
}
"""Quality flags, and the ids of their messages."""


class GroundConsistency:
    """Counts of quality flags and sums of squared residuals over the parts of a run, and the findings about them.

    It counts rows by flag, rows of each target, rows of each target from a single view, and adds up the squared
    standardised residuals with their degrees of freedom.
    """

    def __init__(self) -> None:
        """Start with all counts at 0."""
        self._doubts: Counter[str] = Counter()
        self._rows: Counter[int] = Counter()
        self._alone: Counter[int] = Counter()
        self._nis, self._freedom = 0.0, 0

    def add(self, part: GroundTracksPart) -> None:
        """Add the rows of a part: quality flags by target, squared residuals and their degrees of freedom."""
        self._nis += part.nis
        self._freedom += part.freedom
        for target, doubt in zip(part.tracks.target_id.tolist(), part.tracks.quality_flags.tolist(), strict=True):
            words = doubt.split(",") if doubt else []
            self._doubts.update(words)
            self._rows[target] += 1
            self._alone[target] += SINGLE_VIEW in words

    def figures(self) -> dict[str, object]:
        """Return figures for the summary by name.

        `quality_flags`: rows by flag, without flags that no row has. `single_view_targets`: identities in more than 90
        % of the rows from a single view. `nis_per_freedom`: mean squared standardised residual, 1 if covariances are
        right; only with positions from several views.
        """
        return {
            "quality_flags": {word: self._doubts[word] for word in FLAGS if self._doubts[word]},
            "single_view_targets": self._one_view(),
            **({"nis_per_freedom": self._nis / self._freedom} if self._freedom else {}),
        }

    def findings(self, check: str) -> tuple[Check, ...]:
        """Return the findings of the check named `check`, empty if all is well.

        There is one for each quality flag of more than `MIN_FLAGGED_SHARE` of the rows, one for targets that a single
        view supports, and one for squared residuals above `MAX_NIS_RATIO` times their degrees of freedom.
        """
        total = sum(self._rows.values())
        found = [
            finding(check, id, count=self._doubts[flag], rows=total)
            for flag, id in FLAGS.items()
            if self._doubts[flag] > MIN_FLAGGED_SHARE * total
        ]
        if alone := self._one_view():
            found.append(finding(check, "ground-single-view-targets", targets=alone))
        if self._freedom and self._nis > MAX_NIS_RATIO * self._freedom:
            found.append(finding(check, "ground-views-disagree", factor=(self._nis / self._freedom) ** 0.5))
        return tuple(found)

    def _one_view(self) -> list[int]:
        """Return the sorted identities of targets with a single view in more than 90 % of their rows."""
        return [
            target for target, rows in sorted(self._rows.items()) if self._alone[target] > MIN_SINGLE_VIEW_SHARE * rows
        ]
