"""Fundamental matrices of all pairs of views, from calibration or matches, and checks of matches.

Matches are points of targets labelled in both views: centres or ends of their ellipses or true boxes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.fundamental import check_fundamental, symmetric_errors
from occlog.errors import InputError, option
from occlog.records.declared.views import ViewTracks
from occlog.records.scene import Camera, Scene
from occlog.records.tables import TruthBoxes
from occlog.records.view_pairs import PointMatches, ViewPair, ViewPairs

from .config import EpipolarConfig
from .from_scene import estimate_fundamental, fundamental_of_cameras, ideal_pixels
from .geometry import bends


class PairCheck(NamedTuple):
    """Agreement of the matches of two views with a fundamental matrix; distances are from epipolar lines.

    Attributes:
        a, b: names of the views.
        matches: number of matches.
        median_px: median distance [px].
        most_px: distance that 95 % of the matches do not exceed [px].
        share: share of the matches with both distances within the tolerance.
        chance: this share for wrong pairings.
        fits: whether the matrix fits.
    """

    a: str
    b: str
    matches: int
    median_px: float
    most_px: float
    share: float
    chance: float
    fits: bool


def calibrated_pairs(scene: Scene) -> ViewPairs:
    """All pairs of cameras with poses at different positions; InputError without pairs."""
    pairs = []
    placed = [camera for camera in scene.cameras if camera.placed]
    for a, b in combinations(placed, 2):
        try:
            matrix = fundamental_of_cameras(a, b)
        except ValueError:  # the same position
            continue
        pairs.append(ViewPair(a.name, b.name, matrix, "calibration", undistorted=bends(a) or bends(b)))
    if not pairs:
        raise InputError(
            f"scene: {len(placed)} of {len(scene.cameras)} cameras have a pose; a fundamental matrix needs two, at "
            "different positions; calibrate more, or give matches",
            id="too-few-sensors",
        )
    return ViewPairs(tuple(pairs))


def estimated_pairs(
    matches: Iterable[PointMatches],
    scene: Scene | None = None,
    config: EpipolarConfig | None = None,
) -> ViewPairs:
    """Estimate the fundamental matrix of each pair of views from its matches, without lens distortion.

    Args:
        matches: matches of each pair, in recorded pixels.
        scene: cameras with lenses that may be known, to undistort the points; their poses are not used.
        config: model, threshold and largest error, see `estimate_fundamental`; None: the defaults.

    Raises:
        InputError: the matches of a pair do not determine its matrix.
    """
    config = config or EpipolarConfig()
    return ViewPairs(tuple(_estimated(m, scene, config) for m in matches))


def checked_pairs(
    pairs: ViewPairs, matches: Iterable[PointMatches], scene: Scene | None, tolerance_px: float
) -> tuple[PairCheck, ...]:
    """Check how well each pair's matches agree with its fundamental matrix.

    Args:
        pairs: known fundamental matrices.
        matches: matches of each pair, in recorded pixels.
        scene: cameras with lenses, to undistort the points; None: points are without distortion.
        tolerance_px: largest distance from an epipolar line of a match that agrees.

    Raises:
        InputError: no matrix is known of a pair that has matches, it is for other pixels, or the matches are too few.
    """
    return tuple(_checked(pairs, m, scene, tolerance_px) for m in matches)


def _estimated(m: PointMatches, scene: Scene | None, config: EpipolarConfig) -> ViewPair:
    a, b, undistorted = _ideal(m, scene)
    try:
        fit = estimate_fundamental(a, b, config)
    except ValueError as error:
        raise InputError(f"{m.where}: {error}") from error
    return ViewPair(
        a=m.a,
        b=m.b,
        matrix=fit.matrix,
        source="matches",
        noise_px=fit.noise_px,
        error_px=fit.error_px,
        undistorted=undistorted,
        affine=fit.affine,
        matches=len(a),
        inliers=int(fit.inliers.sum()),
        parallax_px=fit.parallax_px,
    )


def _checked(pairs: ViewPairs, m: PointMatches, scene: Scene | None, tolerance_px: float) -> PairCheck:
    pair = pairs.find(m.a, m.b)
    if pair is None:
        raise InputError(
            f"{m.where}: no fundamental matrix of these views to check; choose others ({option('cameras')})",
            id="disjoint-inputs",
        )
    a, b, undistorted = _ideal(m, scene)
    if pair.undistorted != undistorted:
        pixels = "without lens distortion" if pair.undistorted else "as recorded, but the scene has lens distortion"
        raise InputError(
            f"{m.where}: the fundamental matrix is for pixels {pixels}; give the scene it was made with",
            id="incompatible-inputs",
        )
    try:
        found = check_fundamental(pair.matrix, a, b, tolerance_px)
    except ValueError as error:
        raise InputError(f"{m.where}: {error}") from error
    errors = symmetric_errors(pair.matrix, a, b)
    most = float(np.percentile(np.where(np.isnan(errors), np.inf, errors), 95, method="lower"))
    return PairCheck(
        a=m.a,
        b=m.b,
        matches=len(a),
        median_px=found.median_px,
        most_px=most,
        share=found.share,
        chance=found.chance,
        fits=found.fits,
    )


def _ideal(m: PointMatches, scene: Scene | None) -> tuple[Floats, Floats, bool]:
    """Points (N, 2) of both views without lens distortion [px], and whether distortion was removed.

    Without a scene the points are unchanged. InputError for a camera that the scene does not have.
    """
    cameras = [None if scene is None else _camera(scene, name, m.where) for name in (m.a, m.b)]
    points = [
        ideal_pixels(camera, p) if camera is not None and bends(camera) else p
        for camera, p in zip(cameras, (m.points_a, m.points_b), strict=True)
    ]
    return points[0], points[1], any(bends(camera) for camera in cameras)


def _camera(scene: Scene, name: str, where: str) -> Camera:
    try:
        return scene.camera(name)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


MAX_MATCHES = 2_000
"""Matches of a pair that are used; of more, those of time steps drawn at random, of each all targets and both ends."""
SEED = 6
"""Seed of the random choice of times."""
VISIBLE = 0.8
"""Boxes of targets of which less than this is visible are skipped: the drawing there is a guess."""


def matches_of_tracks(
    chunks: Iterable[ViewTracks] | Iterable[TruthBoxes], where: str, points: str = "centres", window_ns: int = 0
) -> tuple[PointMatches, ...]:
    """Match points of the same target at the same time in two views, for each pair of views.

    Args:
        chunks: view tracks or true boxes in the order of time.
        where: source, for messages.
        points: `centres`, or `ends`, the tops and the bottoms.  People's middles are all at about one
            height, so that their centres are on a plane and determine no matrix; their heads and feet do.
        window_ns: rows at most this far apart [ns] are of one time, unless a view reports twice.
    """
    sides = (-1, 1) if points == "ends" else (0,)
    samples: dict[tuple[str, str], _Sample] = {}
    for step in _time_steps(_times(chunks), window_ns):
        for a, b in combinations(sorted(step), 2):
            both = [(step[a][target], step[b][target]) for target in step[a] if target in step[b]]
            if both:
                block = [[xy + np.array([0.0, side * r]) for xy, r in pair] for pair in both for side in sides]
                samples.setdefault((a, b), _Sample()).add(np.array(block))
    return tuple(samples[pair].matches(*pair, f"{where}: {pair[0]} and {pair[1]}") for pair in sorted(samples))


@dataclass
class _Sample:
    """Random sample of time steps with their matches, at most about twice `MAX_MATCHES` in memory.

    Whole time steps are sampled, since regular sampling of ordered matches would select the same targets or ends.
    Each time step draws a number in [0, 1) and is kept if it is below `share`; `kept` has the numbers and matches,
    `size` counts these.
    """

    kept: list[tuple[float, Floats]] = field(default_factory=list)  # (lot, matches) of each time step
    size: int = 0
    share: float = 1.0  # lots below this are kept
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(SEED))

    def add(self, block: Floats) -> None:
        """Add the matches `block` (N, 2 views, 2 coordinates) [px] of a time step, if it is drawn.

        `share`, the probability of that, is halved when too many matches are kept.
        """
        lot = float(self.rng.random())
        if lot < self.share:
            self.kept.append((lot, block))
            self.size += len(block)
        while self.size >= 2 * MAX_MATCHES and len(self.kept) > 1:
            self.share *= 0.5
            self.kept = [(lot, block) for lot, block in self.kept if lot < self.share] or self.kept[:1]
            self.size = sum(len(block) for _, block in self.kept)

    def matches(self, a: str, b: str, where: str) -> PointMatches:
        """Return the sampled matches of views a and b: at most `MAX_MATCHES`, but at least one time step.

        `where` is their source, for messages.
        """
        lots = np.array([lot for lot, _ in self.kept])
        order = np.argsort(lots)
        sizes = np.cumsum([len(self.kept[k][1]) for k in order])
        chosen = order[: max(int(np.searchsorted(sizes, MAX_MATCHES, side="right")), 1)]
        both = np.concatenate([self.kept[k][1] for k in np.sort(chosen)])
        return PointMatches(a, b, both[:, 0], both[:, 1], where)


Shown = dict[int, tuple[Floats, float]]
"""Centres of targets and how far they reach up and down."""
ViewDetections = dict[str, Shown]
"""Detections by view."""


def _time_steps(times: Iterable[tuple[int, ViewDetections]], window_ns: int) -> Iterator[ViewDetections]:
    """Group detections of the views, given with increasing times [ns], to time steps of at most `window_ns` [ns].

    A view has one time in a step.
    """
    step: ViewDetections = {}
    begin = 0
    for t_ns, shown in times:
        if step and (t_ns - begin > window_ns or step.keys() & shown.keys()):
            yield step
            step = {}
        if not step:
            begin = t_ns
        step = {**step, **shown}
    if step:
        yield step


def _times(chunks: Iterable[ViewTracks] | Iterable[TruthBoxes]) -> Iterator[tuple[int, ViewDetections]]:
    """Generate each time [ns] with its detections by view and target; independent of chunk borders."""
    shown: ViewDetections = {}
    last = 0
    for chunk in chunks:
        table = _boxes(chunk) if isinstance(chunk, TruthBoxes) else _ellipses(chunk)
        for t_ns, sensor, target, x, y, reach in zip(*table, strict=True):
            if shown and t_ns != last:
                yield last, shown
                shown = {}
            last = int(t_ns)
            shown.setdefault(str(sensor), {})[int(target)] = (np.array([x, y]), float(reach))
    if shown:
        yield last, shown


Columns = tuple[np.ndarray, np.ndarray, np.ndarray, Floats, Floats, Floats]
"""Time, sensor, target, centre, and how far the target reaches up and down from it."""


def _ellipses(table: ViewTracks) -> Columns:
    good = table.take(~np.isin(table.lifecycle, ("left", "terminated")))
    reach = np.hypot(good.a_px * np.sin(good.rho), good.b_px * np.cos(good.rho))
    return good.t_ns, good.sensor, good.target_id, good.x_px, good.y_px, reach


def _boxes(table: TruthBoxes) -> Columns:
    good = table.take((table.box >= 0) & (table.target_id >= 0) & ~(table.visible < VISIBLE))
    half = 0.5 * good.height_px
    return good.t_ns, good.sensor, good.target_id, good.left_px + 0.5 * good.width_px, good.top_px + half, half
