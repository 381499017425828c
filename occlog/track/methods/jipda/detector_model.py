"""Online estimates of detection probability, clutter rate, survival, manoeuvre and posture rates.

All estimates start from a prior with the weight of a few boxes, so that one set of defaults serves detectors of all
kinds.

Online estimates of box errors: measurement noise, camera biases, time-correlated errors and gait variance.

All of it comes from how far the cameras of one time step disagree (`kernels.camera_disagreement`), never from residuals
against the filter's prediction, which hold its own lag:

* noise of middles and sizes, y = a + b size^2, by weighted least squares of the squared disagreements;
* biases of each camera, by a scalar Kalman filter each;
* the part that lasts, s^2 exp(-t / NOISE_CORRELATION_S), from the products of a person's disagreements in successive
  frames of a camera;
* gait noise, an error of the position common to all cameras and new at every time step: with z the positions that
  time steps alone say, at equal intervals, and d_k = z_k - 2 z_{k-1} + z_{k-2}, white acceleration leaves d_k and
  d_{k-2} uncorrelated, so that E d_k d_{k-2} is the variance of the error of z_{k-2}.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints

from .config import JipdaConfig
from .kernels.detections import LOG_SIZE_RANGE, DetectorModel, PackedDetections
from .kernels.joint_association import BLIND_FRAME_PROBABILITY, NOISE_INFLATION, JipdaResult
from .kernels.lasting_errors.camera_disagreement import BoxDisagreement
from .target_set import CONSTANT_VELOCITY, MANOEUVRE, POSTURE_CHANGE, TargetSet, two_states

PRIOR_BOXES = 5.0
"""Weight of the prior measurement noise of edges, in boxes of each of five sizes."""
SIZES = np.array([30.0, 60.0, 120.0, 240.0, 480.0])
PRIOR_BIAS = np.array([0.01, 0.1, 0.02, 0.05])
"""Standard deviations of the biases of middle and width across, of middle and height down; see `DetectorModel.bias`."""
NOISE_CORRELATION_S = 0.5
"""Correlation time of persistent errors [s]."""
PRIOR_CORRELATED_NOISE, PRIOR_CORRELATED_PAIRS, USUAL_CORRELATED_NOISE = 0.015, 20.0, 0.01
"""Prior of the time-correlated error, in heights; its weight in pairs of frames with this noise, in heights."""
PRIOR_GAIT_SIGMA, PRIOR_GAIT_PAIRS = 0.03, 200.0
"""Prior of the gait noise [m]; its weight in triples of frames."""
PRIOR_CHANGES = 200.0
"""Prior: errors are uncorrelated from frame to frame; its weight is half as many frames."""
MAX_NOISE_CORRELATION = 0.9
MAX_CORRELATED_NOISE = 0.06
GAIT_SIGMA_RANGE = (0.03, 0.12)
"""Range of the gait noise: feet and head move about the position [m]."""
MAX_CHANGE_PRODUCT_M2 = 0.2
"""Products of changes count at most so much [m^2]: an identity switch is not gait noise."""
MIN_KEPT_SHARE = 0.3
OUTLIER_CHI2 = 12.0
"""Clipping of squared residuals, in variances."""
MIN_EDGE_NOISE = np.array([0.25, 1e-5])
MIDDLES = np.array([0, 2])
INTERVAL_TOLERANCE = 0.2
"""Intervals are equal that differ by less than this share."""


@dataclass(frozen=True)
class EdgeErrorStatistics:
    """Sums from which the errors of box edges are estimated online, priors included; C cameras.

    `bias` and `bias_variance` (C, 4) are each camera's systematic errors of centre and width, centre and height (in
    heights, widths, heights, heights), `normal` (4, 2, 2) and `right` (4, 2) the normal equations of the noise variance
    a + b size^2 of these four, `lasting`, `gait_variance` and `changes` the sums of time-correlated noise, gait and
    frame-to-frame correlation. `before`, `path` and `last` hold recent residuals and positions by track key (and
    camera). `metre` is the length of a metre in the scene's unit.
    """

    metre: float
    bias: Floats  # (C, 4)
    bias_variance: Floats  # (C, 4)
    normal: Floats  # (4, 2, 2) normal equations of the noise
    right: Floats  # (4, 2) right-hand sides
    lasting: Floats  # (2,) sums of products and of their weights
    gait_variance: Floats  # (2,) the same
    before: dict[tuple[int, int], tuple[int, Floats]]  # by person and camera: time, last disagreement of middles
    path: dict[
        int, tuple[tuple[int, Floats, float], ...]
    ]  # by person: time, position, variance of the last five time steps
    changes: Floats  # (2,) squared changes of disagreements over two frames, and over one
    last: dict[
        tuple[int, int], tuple[tuple[int, Floats], ...]
    ]  # by person and camera: time, disagreements in two frames


def prior_edge_errors(cameras: int, metre: float, config: JipdaConfig) -> EdgeErrorStatistics:
    """Return the sums of the box-error model before any box, for `cameras` cameras; the settings give the noise.

    `metre` is the length of a metre in the scene's unit.
    """
    a = np.array([0.5, 2.0, 0.5, 2.0]) * config.edge_noise_px**2
    b = np.array([1.0, 4.0, 1.0, 4.0]) * config.relative_edge_noise**2
    x = np.stack([np.ones_like(SIZES), SIZES**2])
    y = a[:, None] + b[:, None] * SIZES**2
    weight = PRIOR_BOXES / y**2
    return EdgeErrorStatistics(
        metre=metre,
        bias=np.zeros((cameras, 4)),
        bias_variance=np.tile(PRIOR_BIAS**2, (cameras, 1)),
        normal=np.einsum("an,bn,kn->kab", x, x, weight),
        right=np.einsum("an,kn,kn->ka", x, y, weight),
        lasting=PRIOR_CORRELATED_PAIRS / USUAL_CORRELATED_NOISE**4 * np.array([PRIOR_CORRELATED_NOISE**2, 1.0]),
        gait_variance=PRIOR_GAIT_PAIRS * np.array([(PRIOR_GAIT_SIGMA * metre) ** 2, 1.0]),
        before={},
        path={},
        changes=np.full(2, PRIOR_CHANGES),
        last={},
    )


def edge_noise_variance(edges: EdgeErrorStatistics) -> Floats:
    """Return the noise model (4, 2) of boxes; rows: centre x, width, centre y, height.

    Columns are the constant variance [px^2] and the coefficient of the squared size, by nonnegative least squares. The
    size is the box's height for both centres and the height, its width for the width. The coefficient of centres is
    without the part that is correlated in time.
    """
    out = np.linalg.solve(edges.normal, edges.right[..., None])[..., 0]
    for k in range(4):
        A, r = edges.normal[k], edges.right[k]
        for one, other in ((0, 1), (1, 0)):
            if out[k, one] < MIN_EDGE_NOISE[one]:
                out[k, one] = MIN_EDGE_NOISE[one]
                out[k, other] = max((r[other] - A[0, 1] * MIN_EDGE_NOISE[one]) / A[other, other], MIN_EDGE_NOISE[other])
    # The persistent part is counted separately
    out[MIDDLES, 1] = np.maximum(out[MIDDLES, 1] - correlated_noise(edges), 0.0)
    return np.asarray(out, dtype=np.float64)


def correlated_noise(edges: EdgeErrorStatistics) -> float:
    """Return the variance of the time-correlated error of box centres, per axis, in box heights squared."""
    return float(np.clip(edges.lasting[0] / edges.lasting[1], 0.0, MAX_CORRELATED_NOISE**2))


def gait_variance(edges: EdgeErrorStatistics) -> float:
    """Return the variance per axis [scene unit^2] of the observed position about a smooth track, caused by gait.

    It is limited to the range `GAIT_SIGMA_RANGE`.
    """
    return float(
        np.clip(edges.gait_variance[0] / edges.gait_variance[1], *(np.array(GAIT_SIGMA_RANGE) * edges.metre) ** 2)
    )


def correlated_noise_factor(edges: EdgeErrorStatistics, between: float = 1.0) -> float:
    """Return the variance inflation (1 + r) / (1 - r) for noise with correlation r between successive used frames.

    If one of `between` frames of a camera is used, r is the estimated frame-to-frame correlation to this power.
    """
    similar = float(np.clip(edges.changes[0] / edges.changes[1] - 1.0, 0.0, MAX_NOISE_CORRELATION) ** between)
    return (1.0 + similar) / (1.0 - similar)


def update_edge_errors(
    edges: EdgeErrorStatistics,
    t_ns: int,
    boxes: PackedDetections,
    found: BoxDisagreement,
    *,
    key: Ints,
    owner: Ints,
    lasts: Floats,
) -> EdgeErrorStatistics:
    """Return the sums of the box-error model, updated with the residuals of one time step.

    Args:
        edges: sums before the time step; not changed.
        t_ns: time of the time step.
        boxes: frames of the time step with their M boxes, packed.
        found: residuals of the boxes after a fit of positions and body sizes to this time step alone.
        key: (N,) track keys.
        owner: (M,) index of the person of each box.
        lasts: (C,) factor of the measurement variance for errors correlated over successive frames of a camera.
    """
    camera = np.repeat(boxes.camera, np.diff(boxes.first))
    used = np.flatnonzero((found.kept > MIN_KEPT_SHARE).any(axis=1))
    if len(used):
        edges = _noise_and_bias(edges, used, camera, found, lasts)
    edges = _changes(edges, t_ns, used, camera, found, key[owner[used]])
    edges = _correlated_noise(edges, t_ns, used, camera, found, key[owner[used]])
    return _gait_variance(edges, t_ns, found, key)


def _noise_and_bias(
    edges: EdgeErrorStatistics, used: Ints, camera: Ints, found: BoxDisagreement, lasts: Floats
) -> EdgeErrorStatistics:
    """Return the sums with noise and camera biases updated from the residuals of n boxes.

    Noise: weighted least squares of squared residuals. Biases: one scalar Kalman filter for each camera and quantity.

    Args:
        edges: sums before the time step.
        used: (n,) indices of the boxes that count.
        camera: (M,) camera of each box.
        found: residuals of all M boxes of the time step.
        lasts: (C,) factor of the measurement variance of biases, for errors correlated over successive frames.
    """
    noise = edge_noise_variance(edges)
    noise[MIDDLES, 1] += correlated_noise(edges)
    r, kept, size = found.residual[used], found.kept[used], found.size[used]
    S = noise[:, 0] + noise[:, 1] * size**2
    share = np.where(kept > MIN_KEPT_SHARE, kept, 1.0)
    # Noise: squared disagreements by the share of the variance that they keep, by weighted least squares
    y, weight = np.minimum(r**2 / share, OUTLIER_CHI2 * S), np.where(kept > MIN_KEPT_SHARE, (kept / S) ** 2, 0.0)
    x = np.stack([np.ones_like(size), size**2])
    # Biases: a scalar Kalman filter for each; errors that last count less
    bias, variance = edges.bias.copy(), edges.bias_variance.copy()
    for k, row in enumerate(used):
        c = camera[row]
        slow = S[k] / (share[k] * size[k] ** 2) * lasts[c]
        gain = np.where(kept[k] > MIN_KEPT_SHARE, variance[c] / (variance[c] + slow), 0.0)
        bias[c] += gain * r[k] / (share[k] * size[k])
        variance[c] *= 1.0 - gain
    return replace(
        edges,
        normal=edges.normal + np.einsum("ank,bnk,nk->kab", x, x, weight),
        right=edges.right + np.einsum("ank,nk,nk->ka", x, y, weight),
        bias=bias,
        bias_variance=variance,
    )


def _changes(
    edges: EdgeErrorStatistics, t_ns: int, used: Ints, camera: Ints, found: BoxDisagreement, key: Ints
) -> EdgeErrorStatistics:
    """Return the sums of squared residual changes over two frames and over one, updated with one time step.

    Their ratio is (1 - r^2) / (1 - r), with r the frame-to-frame correlation; slower errors cancel. Only three
    residuals of a person and camera at about equal intervals count.

    Args:
        edges: sums before the time step.
        t_ns: time of the time step.
        used: (n,) indices of the boxes that count.
        camera: (M,) camera of each box.
        found: residuals of all M boxes of the time step.
        key: (n,) track key of the person of each box that counts.
    """
    noise, sums = edge_noise_variance(edges), edges.changes.copy()
    noise[MIDDLES, 1] += correlated_noise(edges)
    last = {k: v for k, v in edges.last.items() if t_ns - v[-1][0] < 2 * NS}
    for row, person in zip(used.tolist(), key.tolist(), strict=True):
        size, kept = found.size[row], found.kept[row]
        deviation = np.sqrt((noise[:, 0] + noise[:, 1] * size**2) * np.maximum(kept, MIN_KEPT_SHARE))
        now = np.where(kept > MIN_KEPT_SHARE, found.residual[row] / deviation, np.nan)
        at = (person, int(camera[row]))
        changes = (*last.get(at, ()), (t_ns, now))[-3:]
        last[at] = changes
        if len(changes) == 3:
            first, second = changes[1][0] - changes[0][0], changes[2][0] - changes[1][0]
            if max(first, second) > (1.0 + INTERVAL_TOLERANCE) * min(first, second):
                continue
            two = np.minimum((now - changes[0][1]) ** 2, OUTLIER_CHI2)
            one = 0.5 * np.minimum((now - changes[1][1]) ** 2, OUTLIER_CHI2)
            one += 0.5 * np.minimum((changes[1][1] - changes[0][1]) ** 2, OUTLIER_CHI2)
            fine = np.isfinite(two) & np.isfinite(one)
            sums += (two[fine].sum(), one[fine].sum())
    return replace(edges, changes=sums, last=last)


def _correlated_noise(
    edges: EdgeErrorStatistics, t_ns: int, used: Ints, camera: Ints, found: BoxDisagreement, key: Ints
) -> EdgeErrorStatistics:
    """Return the sums of the time-correlated noise of box centres, updated with one time step.

    They are weighted products of a person's residuals in successive frames of a camera: the expectation at a lag t is
    s^2 exp(-t / `NOISE_CORRELATION_S`).

    Args:
        edges: sums before the time step.
        t_ns: time of the time step.
        used: (n,) indices of the boxes that count.
        camera: (M,) camera of each box.
        found: residuals of all M boxes of the time step.
        key: (n,) track key of the person of each box that counts.
    """
    noise, sums = edge_noise_variance(edges), edges.lasting.copy()
    noise[MIDDLES, 1] += correlated_noise(edges)
    before = {k: v for k, v in edges.before.items() if t_ns - v[0] < 4.0 * NOISE_CORRELATION_S * NS}
    for row, person in zip(used.tolist(), key.tolist(), strict=True):
        size, kept = found.size[row, MIDDLES], found.kept[row, MIDDLES]
        off = np.where(
            kept > MIN_KEPT_SHARE, found.residual[row, MIDDLES] / size / np.sqrt(np.maximum(kept, 0.1)), np.nan
        )
        variance = noise[MIDDLES, 0] / size**2 + noise[MIDDLES, 1]
        now = np.concatenate([off, variance])
        at = (person, int(camera[row]))
        if at in before:
            then, old = before[at]
            # E of the product is s^2 exp(-t / NOISE_CORRELATION_S)
            w = np.exp(-(t_ns - then) / NS / NOISE_CORRELATION_S)
            weight = 1.0 / (variance * old[2:])
            product = np.clip(off * old[:2], -OUTLIER_CHI2 * variance, OUTLIER_CHI2 * variance)
            fine = np.isfinite(product)
            sums += (np.sum((w * weight * product)[fine]), np.sum((w * w * weight)[fine]))
        before[at] = (t_ns, now)
    return replace(edges, lasting=sums, before=before)


def _gait_variance(edges: EdgeErrorStatistics, t_ns: int, found: BoxDisagreement, key: Ints) -> EdgeErrorStatistics:
    """Return the sums of the gait variance, updated with the positions of one time step.

    With d_k the second differences of a person's last five fitted positions at about equal intervals, the mean of
    d_k d_{k-2} over both axes, less the variance of the fit, is an estimate. People without a position now start again.

    Args:
        edges: sums before the time step.
        t_ns: time of the time step.
        found: positions (N, 2) fitted to this time step alone (NaN: too few boxes), and their variances (N,).
        key: (N,) track keys.
    """
    sums, path = edges.gait_variance.copy(), {}
    most = MAX_CHANGE_PRODUCT_M2 * edges.metre**2
    for i in np.flatnonzero(np.isfinite(found.position[:, 0])).tolist():
        k = int(key[i])
        now = (*edges.path.get(k, ()), (t_ns, found.position[i], float(found.variance[i])))[-5:]
        if len(now) > 1 and now[-1][0] - now[-2][0] > 2 * NS:
            now = now[-1:]
        path[k] = now
        if len(now) == 5:
            t = np.diff([p[0] for p in now])
            if t.max() > (1.0 + INTERVAL_TOLERANCE) * t.min():
                continue
            z = np.array([p[1] for p in now])
            late, early = z[4] - 2.0 * z[3] + z[2], z[2] - 2.0 * z[1] + z[0]
            product = float(np.mean(np.clip(late * early, -most, most)))
            sums += (product - now[2][2], 1.0)
    # People who were not seen well at this time step start again
    return replace(edges, gait_variance=sums, path=path)


def reliable_boxes(
    boxes: PackedDetections, owner: Ints, beta: Floats, visible: Floats, sure: Bools, least: float
) -> Bools:
    """Return a mask (M,) of boxes from which detectors are learned: whole, and surely of an unoccluded existing person.

    Args:
        boxes: M boxes of L frames, packed.
        owner: (M,) index of the likeliest person; negative: clutter.
        beta: (N, M) association probability of person and box; above `MIN_ASSOCIATION_TO_LEARN` is required.
        visible: (L, N) expected visible share; NaN: outside the image.
        sure: (N,) people who surely exist.
        least: minimum visible share.
    """
    box = np.arange(len(boxes.box))
    frame = np.repeat(np.arange(len(boxes.camera)), np.diff(boxes.first))
    good = (owner >= 0) & boxes.usable.all(axis=1)
    mine, at = owner[good], box[good]
    good[good] = (
        sure[mine] & (beta[mine, at] > MIN_ASSOCIATION_TO_LEARN) & (np.nan_to_num(visible[frame[good], mine]) > least)
    )
    return good


MIN_ASSOCIATION_TO_LEARN = 0.7
"""Minimum association probability of a box for learning."""


DETECTION_BY_VISIBILITY = np.array([0.02, 0.1, 0.4, 0.8, 0.95, 1.0])
"""Prior: probability of detection at the visible shares 0, 0.2, .. 1, against that in plain view."""
PRIOR_FRAMES = 10.0
"""Weight of the prior detection probability and clutter rate, in frames."""
PRIOR_CURVE = 20.0
"""Weight of the prior visibility curve, in people at each of its nodes."""
PRIOR_TRUNCATED = (2.0, 4.0)
"""Prior: every other box ends where the cover of the feet begins."""
PRIOR_MERGES = (0.5, 10.0)
"""Prior counts of touching pairs with a merged detection, and of touching pairs."""
PRIOR_OUTLIER_EDGES = (1.0, 50.0)
"""Prior counts of boxes with an outlier edge, and of boxes."""
PRIOR_MANOEUVRES = 5.0
"""Weight of the prior manoeuvre rate, in manoeuvres."""
PRIOR_POSTURE_CHANGES = 2.0
"""Weight of the prior posture-change rate, in posture changes."""
PRIOR_DEATHS = 2.0
"""Weight of the prior departure rate, in departures."""
PRIOR_HIDDEN = (1.0, 60.0)
"""Prior counts of the times that something unknown (a post, a plant) hides a person, and of person-seconds."""
HIDDEN_S = 1.0
"""Mean time for which something unknown hides a person [s]."""
PRIOR_COMMON_MISSES = (0.2, 200.0)
"""Prior counts of people missed by all cameras at once, as by a detector that fuses them, and of people."""
MIN_HIDDEN_COMPLEMENT = 1e-6
"""Least probability that nothing unknown hides a person."""
MAX_COMMON_MISS = 0.3
"""Maximum probability of a miss in all cameras at once."""
MAX_ALL_MISSED = 0.01
"""People are in plain view, for this count, if independent misses in all frames are less probable."""
PRIOR_COMMON_CLUTTER = (0.2, 10.0, 100.0)
"""Prior counts of false people with boxes in all cameras, of true arrivals, and of time steps."""
PRIOR_PERSISTENT_CLUTTER = (1.0, 4.0)
"""Prior counts of persistent clutter in the camera's next frame, and of clutter."""
MAX_PERSISTENT_CLUTTER = 0.95
"""Maximum probability of persistent clutter."""
PRIOR_SOURCE_FRAMES = 2.0
"""Weight of the rate of all clutter boxes in that of a source, in frames."""
SOURCE_MEMORY = 0.995
"""Factor of what is known of a source, per frame."""
MIN_SOURCE_RATE = 0.02
"""Sources with a smaller expected number of boxes in a frame are forgotten."""
ESTABLISHED_FRAMES, ESTABLISHED_S, ESTABLISHED_SHARE = 4.0, 1.0, 0.6
"""Number of frames and age [s] of an established source, and the share of frames with a box of no person there."""
SAME_SOURCE_CHI2 = 25.0
"""Maximum squared Mahalanobis distance of a box from the mean of the boxes of its source."""
MAX_SOURCE_BOXES = 50.0
"""Number of boxes above which the mean of a source is a moving one."""
MAX_LOG_CLUTTER_RATIO = 50.0
"""Greatest log of a density against that of a box anywhere."""
MIN_CLUTTER_PROBABILITY = 0.05
"""Minimum clutter probability of a box that is tested for persistence."""
MIN_EXISTENCE_TO_LEARN, MIN_VISIBILITY_TO_LEARN = 0.9, 0.85
"""Minimum existence of the people from which detection rates are learned, and minimum visibility to count as
unoccluded."""
DETECTION_RANGE = (0.05, 0.98)
MAX_MERGE_PROBABILITY = 0.9
"""Maximum share of touching pairs with a merged detection."""


@dataclass(frozen=True)
class DetectorStatistics:
    """Counts of detections, misses, clutter, manoeuvres and departures so far, priors included; C cameras.

    Each field is a pair (or one pair per camera) of an event count and its exposure, so that their ratio is a
    probability or a rate: detections / people in plain view, clutter boxes / frames, detections / expected ones at K
    visible shares, truncated boxes, merged pairs, outlier edges, persistent clutter, departures / person-seconds,
    manoeuvres and posture changes / seconds, spells of unmodelled occlusion / person-seconds, misses by all cameras at
    once. `false` has a third entry: time steps.
    """

    detected: Floats  # (C, 2) people in plain view: detected, all
    clutter: Floats  # (C, 2) clutter boxes, frames
    curve: Floats  # (K, 2) detected, expected in plain view
    cuts: Floats  # (2,) boxes that end where the cover of the feet begins, boxes of people with covered feet
    merges: Floats  # (C, 2) pairs who touch in the image: in one box, of whom there is a box
    wrong: Floats  # (2,) boxes with a wrong edge, all boxes
    again: Floats  # (C, 2) clutter boxes that persist in the next frame, clutter boxes
    left: Floats  # (2,) people who left, person-seconds
    turned: Floats  # (2,) manoeuvres begun, seconds of calm motion
    bent: Floats  # (2,) times that a person bent, person-seconds upright
    false: Floats  # (3,) tracks with boxes of many cameras in one time step alone, in several, and time steps
    hidden: Floats  # (C, 2) times that something unknown hid a person, person-seconds in plain view
    missed: Floats  # (2,) people who were missed in all frames of a time step at once, all people in plain view


def prior_statistics(cameras: int, config: JipdaConfig) -> DetectorStatistics:
    """Return the counts before any frame, for `cameras` cameras: priors by the settings and module constants."""
    return DetectorStatistics(
        detected=np.tile([PRIOR_FRAMES * config.detection_probability, PRIOR_FRAMES], (cameras, 1)),
        clutter=np.tile([PRIOR_FRAMES * config.clutter_rate, PRIOR_FRAMES], (cameras, 1)),
        curve=PRIOR_CURVE * np.column_stack([DETECTION_BY_VISIBILITY, np.ones_like(DETECTION_BY_VISIBILITY)]),
        cuts=np.array(PRIOR_TRUNCATED),
        merges=np.tile(PRIOR_MERGES, (cameras, 1)),
        wrong=np.array(PRIOR_OUTLIER_EDGES),
        again=np.tile(PRIOR_PERSISTENT_CLUTTER, (cameras, 1)),
        left=PRIOR_DEATHS * np.array([1.0, config.mean_dwell_s]),
        turned=PRIOR_MANOEUVRES * np.array([1.0, config.manoeuvre_interval_s]),
        bent=PRIOR_POSTURE_CHANGES * np.array([1.0, config.posture_change_interval_s]),
        hidden=np.tile(PRIOR_HIDDEN, (cameras, 1)),
        missed=np.array(PRIOR_COMMON_MISSES),
        false=np.array(PRIOR_COMMON_CLUTTER),
    )


def detector_model(
    counts: DetectorStatistics, edges: EdgeErrorStatistics, config: JipdaConfig, interval: Floats, between: float = 1.0
) -> DetectorModel:
    """Return the detectors' parameters (detection probability, noise, biases, merging) estimated from the counts.

    Args:
        counts: counts of detections and misses.
        edges: sums of box errors.
        config: settings; without `use_visibility` detection does not depend on the visible share.
        interval: (C,) time since each camera's last frame [s], > 0; may be infinite.
        between: number of a camera's frames per frame that is used, >= 1.
    """
    curve = np.maximum.accumulate(counts.curve[:, 0] / counts.curve[:, 1])
    curve = curve / curve[-1] if config.use_visibility else np.ones_like(curve)
    return DetectorModel(
        detection=np.clip(counts.detected[:, 0] / counts.detected[:, 1], *DETECTION_RANGE),
        curve=curve,
        cut=float(counts.cuts[0] / counts.cuts[1]),
        wrong=float(counts.wrong[0] / counts.wrong[1]),
        bias=edges.bias,
        noise=edge_noise_variance(edges),
        gait_variance=correlated_noise(edges),
        # White noise equivalent to noise with a correlation that falls as exp(-t / NOISE_CORRELATION_S)
        lasting=1.0 / np.tanh(0.5 * interval / NOISE_CORRELATION_S),
        merge=np.minimum(counts.merges[:, 0] / counts.merges[:, 1], MAX_MERGE_PROBABILITY),
        common_miss=min(float(counts.missed[0] / counts.missed[1]), MAX_COMMON_MISS),
        slow=correlated_noise_factor(edges, between),
    )


def common_clutter_rate(counts: DetectorStatistics) -> float:
    """Return the expected number per time step of false tracks that have boxes in all cameras.

    A detector that fuses the cameras causes them.
    """
    return float(counts.false[0] / counts.false[2])


def common_clutter_ratio(counts: DetectorStatistics) -> float:
    """Return the ratio of false tracks with boxes in all cameras to true new people."""
    return float(counts.false[0] / counts.false[1])


def target_death_rate(counts: DetectorStatistics) -> float:
    """Return the death rate of targets: the rate at which people leave the scene, per person [1/s]."""
    return float(counts.left[0] / counts.left[1])


def hiding_rate(counts: DetectorStatistics) -> Floats:
    """Return (C,) rates [1/s] at which an unmodelled obstacle comes to hide a person in plain view of each camera."""
    return np.asarray(counts.hidden[:, 0] / counts.hidden[:, 1])


def predict_hidden(hidden: Floats, interval: Floats, counts: DetectorStatistics) -> Floats:
    """Return (N, C) probabilities that an unmodelled obstacle hides people, predicted to each camera's frame now.

    Each camera has a two-state Markov chain; the mean duration of an occlusion is `HIDDEN_S`.

    Args:
        hidden: (N, C) probabilities at each camera's last frame; not changed.
        interval: (C,) time since then [s]; infinite: no frame now, and the probability stays.
        counts: statistics that give the rate at which people in plain view are hidden.
    """
    out = hidden.copy()
    for c, rate in enumerate(hiding_rate(counts).tolist()):
        if np.isfinite(interval[c]):
            to = two_states(float(interval[c]), rate, 1.0 / HIDDEN_S)
            out[:, c] = to[1, 0] + (to[1, 1] - to[1, 0]) * hidden[:, c]
    return out


def update_hidden(hidden: Floats, boxes: PackedDetections, result: JipdaResult) -> Floats:
    """Return (N, C) probabilities that an unmodelled obstacle hides people, updated by detections and misses.

    By Bayes' rule: a detection excludes it, a miss raises it. Blind frames (no output of the detector) are skipped.

    Args:
        hidden: (N, C) predicted probabilities; not changed.
        boxes: frames of the time step, packed.
        result: JIPDA update of the time step, with these probabilities included in its detection probabilities.
    """
    out = hidden.copy()
    blind = blind_frames(boxes, result.existence, result.detection)
    for frame, c in enumerate(boxes.camera.tolist()):
        if blind[frame]:
            continue
        here = slice(boxes.first[frame], boxes.first[frame + 1])
        missed = 1.0 - np.minimum((result.beta + result.joint)[:, here].sum(axis=1), 1.0)
        seen = result.detection[frame] > 0.0
        out[seen, c] *= (missed / (1.0 - result.detection[frame]))[seen]
    return np.minimum(out, 1.0 - MIN_HIDDEN_COMPLEMENT)


def manoeuvre_rate(counts: DetectorStatistics) -> float:
    """Return the rate [1/s] at which a person who walks with constant velocity begins a manoeuvre."""
    return float(counts.turned[0] / counts.turned[1])


def posture_change_rate(counts: DetectorStatistics) -> float:
    """Return the rate [1/s] at which an upright person begins to bend, fall, lie down or get up."""
    return float(counts.bent[0] / counts.bent[1])


def clutter_rate(counts: DetectorStatistics) -> Floats:
    """Return (C,) expected numbers of clutter boxes (false alarms) in a frame of each camera."""
    return np.asarray(counts.clutter[:, 0] / counts.clutter[:, 1])


class Clutter(NamedTuple):
    """Sources of persistent clutter in a camera's images, such as shadows, posts and pictures; n sources.

    `box` (n, 4) is the mean left, top, right, bottom [px] of a source's boxes, `free` the probability that it is of no
    person, `hits` the number of later frames with such a box (weighted by that probability), `tries` the number of
    later frames, both fading with `SOURCE_MEMORY`, and `age` the time since the first box [s].
    """

    box: Floats  # (n, 4) mean of its boxes [px]
    free: Floats  # (n,) probability that it is of no person
    hits: Floats  # (n,) later frames with a box there, by the probability that it is of no person
    tries: Floats  # (n,) later frames
    age: Floats  # (n,) since the first box [s]


def no_clutter() -> Clutter:
    """Return clutter sources of a camera without any source (n = 0)."""
    return Clutter(np.zeros((0, 4)), *np.zeros((4, 0)))


def source_rates(sources: Clutter, again: float) -> Floats:
    """Return (n,) expected numbers of boxes of each clutter source in the camera's next frame.

    Args:
        sources: n clutter sources of a camera.
        again: probability that a clutter box persists in the camera's next frame; the prior of each source's rate.
    """
    share = (PRIOR_SOURCE_FRAMES * again + sources.hits) / (PRIOR_SOURCE_FRAMES + sources.tries)
    return np.asarray(sources.free * np.minimum(share, MAX_PERSISTENT_CLUTTER))


def established(sources: Clutter) -> Clutter:
    """Return the clutter sources that are old enough and had a box in most of their frames.

    Boxes there are taken as clutter for confirmed tracks, too.
    """
    sure = (sources.tries >= ESTABLISHED_FRAMES) & (sources.age >= ESTABLISHED_S)
    sure &= sources.hits > ESTABLISHED_SHARE * sources.tries
    return Clutter(*(part[sure] for part in sources))


def update_sources(
    sources: Clutter, box: Floats, free: Floats, again: float, noise: Floats, interval: float
) -> tuple[Clutter, tuple[float, float]]:
    """Update the clutter sources of a camera with the m boxes of one frame.

    Boxes near a source move its mean and count as hits, others (probably of no person) become new sources, and sources
    with a low expected rate are dropped.

    Args:
        sources: clutter sources before the frame.
        box: (m, 4) left, top, right, bottom [px].
        free: (m,) probability that a box is of no person.
        again: probability that a clutter box persists in the camera's next frame.
        noise: (4, 2) variances of centre and width, centre and height: constant [px^2], and factor of the squared size.
        interval: time since the camera's last frame [s]; infinite in the first one.

    Returns:
        The sources after the frame; and, of the sources first seen in the last frame, the expected number of those with
        a box in this one and their expected number.
    """
    n, m = len(sources.box), len(box)
    matched, hit = np.full(n, -1), np.zeros(n)
    if n and m:
        distance = _squared_distances(box, sources.box, noise)
        matched = np.where(distance.min(axis=0) < SAME_SOURCE_CHI2, distance.argmin(axis=0), -1)
        hit = np.where(matched >= 0, free[matched], 0.0)
    new = sources.tries == 0.0
    counted = float((sources.free * hit)[new].sum()), float(sources.free[new].sum())
    seen = matched >= 0
    there = sources.box.copy()
    weight = np.minimum(sources.hits[seen] + 2.0, MAX_SOURCE_BOXES)
    there[seen] += (box[matched[seen]] - there[seen]) / weight[:, None]
    old = Clutter(
        there,
        np.maximum(sources.free, hit),
        SOURCE_MEMORY * sources.hits + hit,
        SOURCE_MEMORY * sources.tries + np.where(seen, hit, 1.0),
        sources.age + interval,
    )
    keep = source_rates(old, again) > MIN_SOURCE_RATE
    rest = np.setdiff1d(np.flatnonzero(free > MIN_CLUTTER_PROBABILITY), matched[keep & seen])
    zeros = np.zeros(len(rest))
    return Clutter(
        np.concatenate([old.box[keep], box[rest]]),
        np.concatenate([old.free[keep], free[rest]]),
        np.concatenate([old.hits[keep], zeros]),
        np.concatenate([old.tries[keep], zeros]),
        np.concatenate([old.age[keep], zeros]),
    ), counted


def persistent_clutter_probability(counts: DetectorStatistics) -> Floats:
    """Return (C,) probabilities that a clutter box persists in the camera's next frame."""
    return np.asarray(np.minimum(counts.again[:, 0] / counts.again[:, 1], MAX_PERSISTENT_CLUTTER))


def persistent_clutter_density(
    boxes: PackedDetections, before: Sequence[Clutter], again: Floats, noise: Floats, size: Floats
) -> Floats:
    """Return the density (M,) of persistent clutter (shadows, posts, pictures) at each box of a time step.

    It is an expected number of boxes, relative to the density of a clutter box anywhere in the image; 0 for positions
    on the ground.

    Args:
        boxes: M boxes of L frames, packed.
        before: clutter sources of each camera.
        again: (C,) probability that a clutter box persists in the camera's next frame.
        noise: (4, 2) variances of centre and width, centre and height: constant [px^2], and factor of the squared size.
        size: (C, 2) width and height of the images [px].
    """
    out = np.zeros(len(boxes.box))
    for frame, c in enumerate(boxes.camera.tolist()):
        here = slice(boxes.first[frame], boxes.first[frame + 1])
        old, now = before[c].box, boxes.box[here]
        above = len(boxes.covariance) and np.isfinite(boxes.covariance[here, 0]).any()
        if not len(old) or not len(now) or above:
            continue
        # Density of the new box about the old one, against that of a box anywhere in the image
        variance = _variances(old, noise)
        log = -0.5 * (_squared_distances(now, old, noise) + np.log(2.0 * np.pi * variance).sum(axis=1))
        sizes = (np.log(np.maximum(now[:, 2:] - now[:, :2], 1.0)) + LOG_SIZE_RANGE).sum(axis=1)
        log += np.log(size[c]).sum() + sizes[:, None]
        rates = source_rates(before[c], float(again[c]))
        out[here] = (np.exp(np.minimum(log, MAX_LOG_CLUTTER_RATIO)) * rates).sum(axis=1)
    return out


def _variances(box: Floats, noise: Floats) -> Floats:
    """Return (n, 4) variances [px^2] of the difference of two boxes of one clutter source, near boxes `box` (n, 4).

    Columns: centre x, width, centre y, height. Row k of `noise` (4, 2) has the constant variance [px^2] of column k,
    and the factor of the squared size; the result is twice that variance, times `NOISE_INFLATION`.
    """
    width, height = (box[:, 2:] - box[:, :2]).T
    extent = np.column_stack([height, width, height, height])
    return np.asarray(2.0 * NOISE_INFLATION * (noise[:, 0] + noise[:, 1] * extent**2))


def _squared_distances(now: Floats, old: Floats, noise: Floats) -> Floats:
    """Return (m, n) squared Mahalanobis distances of boxes `now` (m, 4) from the boxes `old` (n, 4) of clutter sources.

    Boxes are left, top, right, bottom [px]. `noise` (4, 2): variances of centre x, width, centre y, height as a
    constant [px^2] and a factor of the squared size.
    """
    off = _centres_and_sizes(now)[:, None] - _centres_and_sizes(old)
    return np.asarray((off**2 / _variances(old, noise)).sum(axis=2))


def squared_distance(now: Floats, old: Floats, noise: Floats) -> Floats:
    """Return (n,) squared Mahalanobis distances of boxes `now` (n, 4) from the boxes `old` (n, 4) in the same rows.

    Boxes are left, top, right, bottom [px]. `noise` (4, 2): variances of centre x, width, centre y, height as a
    constant [px^2] and a factor of the squared size.
    """
    off = _centres_and_sizes(now) - _centres_and_sizes(old)
    return np.asarray((off**2 / _variances(old, noise)).sum(axis=1))


def _centres_and_sizes(box: Floats) -> Floats:
    """Return (n, 4) centre x, width, centre y, height of boxes (n, 4) left, top, right, bottom [px]."""
    low, high = box[:, :2], box[:, 2:]
    return np.stack([0.5 * (low + high), high - low], axis=2).reshape(-1, 4)


def blind_frames(boxes: PackedDetections, existence: Floats, detection: Floats) -> Bools:
    """Return a mask (L,) of frames without boxes that are likelier blind (lost or covered) than misses of all people.

    The prior probability of a blind frame is `BLIND_FRAME_PROBABILITY`.

    Args:
        boxes: L frames with their boxes, packed.
        existence: (N,) existence probabilities of the people.
        detection: (L, N) detection probabilities of the people in each frame.
    """
    missed = np.log1p(-existence * np.minimum(detection, DETECTION_RANGE[1])).sum(axis=1)
    return np.asarray((np.diff(boxes.first) == 0) & (missed < math.log(BLIND_FRAME_PROBABILITY)))


def update_statistics(
    counts: DetectorStatistics,
    people: TargetSet,
    before: Floats,
    *,
    dt: float,
    config: JipdaConfig,
    boxes: PackedDetections,
    rates: DetectorModel,
    result: JipdaResult,
    interval: Floats,
    alone: bool = False,
) -> DetectorStatistics:
    """Return the counts of detections, merges, outlier edges, manoeuvres and posture changes, updated by one time step.

    Clutter is not counted here, but after track initiation (`_update_clutter`).

    Args:
        counts: statistics before the time step; not changed.
        people: N tracks after the update.
        before: (N,) their existence probabilities before it.
        dt: time since the last time step [s].
        config: durations of manoeuvres and of posture changes.
        boxes: frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        result: associations and existence from the update.
        interval: (C,) time since each camera's last frame [s]; infinite: no frame now, or none before.
        alone: there are position sensors only. Then people who surely exist are those before the update: a miss by the
            only sensor lowers the existence, so that no miss would be counted otherwise.
    """
    detected, curve, merges = counts.detected.copy(), counts.curve.copy(), counts.merges.copy()
    hidden = counts.hidden.copy()
    sure = (before if alone else people.existence) > MIN_EXISTENCE_TO_LEARN
    last = len(curve) - 1
    present = 1.0 - result.missed
    independent = np.log1p(-np.minimum(result.detection, DETECTION_RANGE[1])).sum(axis=0)
    plain = (before > MIN_EXISTENCE_TO_LEARN) & (independent < math.log(MAX_ALL_MISSED))
    missed = counts.missed + np.array([(result.existence * result.missed)[plain].sum(), result.existence[plain].sum()])
    blind = blind_frames(boxes, people.existence, result.detection)
    for frame, c in enumerate(boxes.camera.tolist()):
        if blind[frame]:
            continue
        visible = result.visible[frame]
        here = slice(boxes.first[frame], boxes.first[frame + 1])
        hit, unmerged = result.beta[:, here].sum(axis=1), 1.0 - np.minimum(result.joint[:, here].sum(axis=1), 1.0)
        plain = sure & (visible > MIN_VISIBILITY_TO_LEARN)
        shown = unmerged * present * (1.0 - people.hidden[:, c])
        detected[c] += (hit[plain].sum(), shown[plain].sum())
        if np.isfinite(interval[c]):
            time = people.hidden[plain, c].sum() * interval[c]
            hidden[c] += (time / HIDDEN_S, (plain.sum() * interval[c] - time))
        merges[c] += result.merges[frame]
        # The curve, with each person's weight between two of its nodes
        seen = np.flatnonzero(sure & (visible > 0.0))
        at = visible[seen] * last
        k = np.minimum(at.astype(np.int64), last - 1)
        for knot, weight in ((k, 1.0 - (at - k)), (k + 1, at - k)):
            np.add.at(curve[:, 0], knot, weight * hit[seen])
            np.add.at(curve[:, 1], knot, weight * shown[seen] * rates.detection[c])
    # As many begin as end: the time spent in manoeuvres over how long one takes
    model = dt * people.model[sure].sum(axis=0)
    turned = counts.turned + np.array([model[MANOEUVRE] / config.manoeuvre_duration_s, model[CONSTANT_VELOCITY]])
    bent = counts.bent + np.array(
        [model[POSTURE_CHANGE] / config.posture_change_duration_s, model[CONSTANT_VELOCITY] + model[MANOEUVRE]]
    )
    return replace(
        counts,
        detected=detected,
        curve=curve,
        cuts=counts.cuts + result.cuts,
        merges=merges,
        wrong=counts.wrong + result.wrong,
        turned=turned,
        bent=bent,
        missed=missed,
        hidden=hidden,
    )
