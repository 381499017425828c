"""Likelihoods among people of all kinds against code that shares nothing with occlog, place by place.

Factors of cameras come from `apf_reference`, exact probabilities from `union_reference`
(unions of rectangles, closed forms), Eqs. 7-9 from `occlusion_reference`.
"""

from __future__ import annotations

from itertools import product

import apf_reference as plain
import numpy as np
import occlusion_reference as ref
import pytest
import union_reference as union
from tracker_scenes import PILLAR, ROOM, camera, scan, true_u

from occlog.core.occlusion.occlusion_probability import IMPROVED, PRINTED, QUADRATURE
from occlog.core.occlusion.priors import Priors, gaussian_priors, polygon_priors
from occlog.filtering.likelihood.directions import (
    EXACT,
    INDEPENDENT,
    RECURSION,
    DetectionModel,
    Occlusion,
    log_likelihood_among,
)
from occlog.records.scene import Occluder, Scene
from occlog.track.methods.apf.model import pack_noise, pack_scan, pack_sensors, read_noise

D, FLOOR, SOFTEN = 3.33, 1e-3, 0.02
CASES = [(seed, 1 + seed % 6, M) for seed, M in enumerate((3, 20, 7, 0, 12, 5, 1, 20, 9, 16, 4, 20))]
FORMS = [(*case, (PRINTED, IMPROVED, QUADRATURE)[(k + k // 6) % 3]) for k, case in enumerate(CASES)]
"""Each form with one to six cameras."""
TARGET = np.array([30.0, 68.0])
BEND = np.array([[0.0, 0.0], [9.0, 1.0], [3.0, 3.0], [2.0, 8.0]])


def scene_of(rng, N: int) -> Scene:
    """N cameras anywhere but in the pillar, so that many places are behind them, out of view or out of range."""
    places = rng.uniform(0, 100, (60, 2))
    places = places[np.abs(places - 50).max(axis=1) > 11][:N]
    towards = np.degrees(np.arctan2(*(TARGET - places).T[::-1])) + rng.normal(0, 40, len(places))
    cameras = [camera(f"c{i}", p, towards[i], range=rng.uniform(50, 150)) for i, p in enumerate(places)]
    return Scene(tuple(cameras), (), (Occluder("pillar", PILLAR),), (), ROOM, length_unit="unit")


def persons_of(rng, M: int, kinds=("general", "isotropic", "line", "known", "polygon")) -> list:
    """Corners of a polygon or mean and covariance, kind after kind."""
    out = []
    for j in range(M):
        mean = TARGET + rng.normal(0, 6, 2) if j % 3 else rng.uniform(0, 100, 2)
        kind, half = kinds[j % len(kinds)], rng.standard_normal((2, 2))
        covariance = {
            "general": 4.0 * np.eye(2) + 20.0 * half @ half.T,
            "isotropic": rng.uniform(1, 60) * np.eye(2),
            "line": 30.0 * np.outer(half[0], half[0]),
            "known": np.zeros((2, 2)),
        }
        out.append(mean + rng.uniform(0.5, 2) * BEND if kind == "polygon" else (mean, covariance[kind]))
    return out


def pack(persons: list) -> Priors:
    """The same for occlog: kinds may be mixed within one `Priors`."""
    corners = [p if isinstance(p, np.ndarray) else np.empty((0, 2)) for p in persons]
    each = [
        polygon_priors([p], D) if isinstance(p, np.ndarray) else gaussian_priors(p[0], p[1], D)
        for p in (p if isinstance(p, np.ndarray) else (p[0][None], p[1][None]) for p in persons)
    ]
    if not each:
        return gaussian_priors(np.empty((0, 2)), np.empty((0, 2, 2)), D)
    joined = [np.concatenate([getattr(e, name) for e in each]) for name in ("mean", "axis", "sigma", "minor", "radius")]
    first = np.concatenate([[0], np.cumsum([len(c) for c in corners])]).astype(np.int64)
    return Priors(*joined, first, np.concatenate([e.corners for e in each]))


def hiding(xy, place, persons, form):
    """(L, M) q: Eq. 7 for normal priors with an area, exact for others and by QUADRATURE."""
    q = union.hiding(xy, place, persons, D)
    for j, person in enumerate(persons):
        if form != QUADRATURE and not isinstance(person, np.ndarray) and np.linalg.det(person[1]) > 1e-6:
            one = ref.RefPriors(person[0][None], person[1][None], D, improved=form == IMPROVED)
            q[:, j] = ref.hiding(xy, place, one)[:, 0]
    return q


class Case:
    """Cameras, readings of a target (some missed, some false), places all over the room, and people."""

    def __init__(self, seed: int, N: int, M: int, L: int, kinds=None) -> None:
        rng = np.random.default_rng(seed)
        self.scene = scene_of(rng, N)
        near = TARGET + 3.0 * rng.standard_normal((L // 2, 2))
        self.xy = np.concatenate([near, rng.uniform(-5, 105, (L - L // 2, 2))])
        self.places = np.array([c.ground for c in self.scene.cameras])
        self.persons = persons_of(rng, M, *([] if kinds is None else [kinds]))
        hit, false = rng.uniform(0.7, 1.0, N), rng.uniform(1e-3, 0.2, N)
        self.model = DetectionModel(hit, 1 - hit, false, SOFTEN, np.full(N, 0.9), np.ones(N))
        luck = rng.random(N)
        z = np.where(luck < 0.55, -np.array(true_u(self.scene, TARGET)), rng.uniform(-60, 60, N))
        z[luck > 0.75] = np.nan
        self.observations = pack_scan(
            scan(0, [(i, None if np.isnan(v) else -v) for i, v in enumerate(z)]), read_noise(self.scene), True
        )
        cameras = [
            plain.RefCamera(c.ground, c.yaw, c.focal_px[0], c.fov, c.range, c.sigma_position, c.sigma_yaw)
            for c in self.scene.cameras
        ]
        self.plain = plain.RefScene(ROOM, [PILLAR], cameras)
        config = plain.RefConfig(hit=hit, miss=1 - hit, false_alarm_probability=false, out_of_view_likelihood=SOFTEN)
        self.a, self.b, self.assigned = plain.factors(self.xy, z, np.full(N, 2.0), self.plain, config)
        self.free = plain.on_floor(self.xy, self.plain)

    def found(self, probability: int, form: int, floor: float = FLOOR):
        packed = pack_sensors(self.scene), pack_noise(self.scene), self.model
        occlusion = Occlusion(probability, form, floor, 5.5)
        return log_likelihood_among(self.xy, self.observations, *packed, self.free, pack(self.persons), occlusion)

    def check(self, found, want) -> None:
        """Within 1e-6 of what the likelihood of each place is at most, not only of the largest of all places."""
        assert np.all(found[~self.free] == -np.inf)
        assert self.free.sum() > 5
        most = np.prod(np.where(self.assigned, np.maximum(self.a, self.b), self.a), axis=1)[self.free]
        np.testing.assert_allclose(np.exp(found[self.free]) / most, want[self.free] / most, rtol=0, atol=1e-6)


def test_the_cases_have_everything() -> None:
    """Places that no camera, one and several could see; behind cameras, beyond their view, range and the pillar."""
    views, why = set(), np.zeros(4, dtype=int)
    for seed, N, M in CASES:
        case = Case(seed, N, M, 24)
        views |= set(case.assigned[case.free].sum(axis=1).tolist())
        for c in case.plain.cameras:
            h, d = plain.offsets(case.xy, c)
            inside = (d > 0) & (np.abs(np.arctan2(h, d)) <= c.fov / 2)
            near = inside & (np.hypot(h, d) <= c.reach)
            why += [
                (d < 0).sum(),
                ((d > 0) & ~inside).sum(),
                (inside & ~near).sum(),
                (near & plain.blocked(c.xy, case.xy, PILLAR)).sum(),
            ]
    assert views >= {0, 1, 2, 3}
    assert why.min() > 10


@pytest.mark.parametrize(("seed", "N", "M", "form"), FORMS)
def test_independent_cameras(seed: int, N: int, M: int, form: int) -> None:
    case = Case(seed, N, M, 24)
    q = np.stack([hiding(case.xy, position, case.persons, form) for position in case.places], axis=1)
    share = np.prod(1 - q, axis=2)
    want = ref.independent(case.a, case.b, case.assigned, share, FLOOR)
    case.check(case.found(INDEPENDENT, form), want)
    # The product is the sum over all patterns of who sees the place, where nothing is floored.
    total = np.zeros(len(case.xy))
    for eta in product((False, True), repeat=N):
        seen = np.array(eta)
        factor = np.where(case.assigned, np.where(seen, share * case.a, (1 - share) * case.b), 0.5 * case.a)
        total += np.prod(factor, axis=1)
    case.check(case.found(INDEPENDENT, form, 0.0), total)


@pytest.mark.parametrize(("seed", "N", "M", "form"), FORMS)
def test_recursion(seed: int, N: int, M: int, form: int) -> None:
    case = Case(seed, N, M, 24)
    q = np.stack([hiding(case.xy, position, case.persons, form) for position in case.places], axis=1)
    chances = lambda rows, use: ref.patterns_disjoint(q[np.ix_(rows, use)])  # noqa: E731
    want = ref.over_patterns(case.a, case.b, case.assigned, chances, FLOOR)
    case.check(case.found(RECURSION, form), want)


@pytest.mark.parametrize("M", [3, 8])
@pytest.mark.parametrize("seed", [0, 2, 3])  # of which several cameras see the target
def test_recursion_where_eq_8_is_clipped(seed: int, M: int) -> None:
    """People right at the target hide it from several cameras at once: sums of q above 1 count as 1."""
    case = Case(seed, 6, 0, 40)
    rng = np.random.default_rng(seed)
    case.persons = [(TARGET + rng.normal(0, 1.5, 2), 0.3 * np.eye(2)) for _ in range(M)]
    q = np.stack([hiding(case.xy, position, case.persons, IMPROVED) for position in case.places], axis=1)

    def likelihood(least: float):
        def chances(rows, use):
            some = q[np.ix_(rows, use)]
            subsets = [[i for i in range(len(use)) if Q >> i & 1] for Q in range(1 << len(use))]
            clear = [np.prod(np.maximum(1.0 - some[:, Q].sum(axis=1), least), axis=1) for Q in subsets]
            return ref.from_together(np.column_stack(clear), len(use))

        return ref.over_patterns(case.a, case.b, case.assigned, chances, FLOOR)

    clipped, bare = likelihood(0.0), likelihood(-np.inf)
    assert np.abs(clipped / bare - 1.0)[case.free].max() > 1e-2
    case.check(case.found(RECURSION, IMPROVED), clipped)


@pytest.mark.parametrize(("seed", "N", "M"), CASES)
def test_exact(seed: int, N: int, M: int) -> None:
    """Sums over all 2^n patterns whose probabilities come from the areas and masses of unions."""
    case = Case(seed, N, M, 14)

    def chances(rows, use):
        return ref.from_together(union.together(case.xy[rows], case.places[use], case.persons, D), len(use))

    case.check(case.found(EXACT, QUADRATURE), ref.over_patterns(case.a, case.b, case.assigned, chances, FLOOR))


def test_the_union_reference_against_draws() -> None:
    """Five standard errors of 400,000 draws, for the union of the rectangles of three cameras."""
    rng = np.random.default_rng(8)
    x, cameras = np.array([20.0, 10.0]), np.array([[0.0, 0.0], [3.0, 12.0], [18.0, -4.0]])
    for covariance in (np.array([[30.0, 12.0], [12.0, 9.0]]), np.outer([4.0, 3.0], [4.0, 3.0])):
        mean = np.array([13.0, 7.0])
        together = union.together(x[None], cameras, [(mean, covariance)], D)[0]
        points = rng.multivariate_normal(mean, covariance, 400_000, check_valid="ignore")
        clear = np.ones(len(points), dtype=bool)
        for place in cameras:
            u = (x - place) / np.hypot(*(x - place))
            along, across = (points - place) @ u, (points - place) @ [-u[1], u[0]]
            clear &= ~((along >= 0) & (along <= np.hypot(*(x - place))) & (abs(across) <= D / 2))
        share = clear.mean()
        assert 0.05 < share < 0.95
        assert abs(share - together[7]) < 5 * np.sqrt(share * (1 - share) / len(points))


@pytest.mark.parametrize("probability", [INDEPENDENT, RECURSION, EXACT])
def test_the_floor_holds_and_does_nothing_else(probability: int) -> None:
    """Known people hide cameras for certain: no place falls below its floor, and floor 0 may be impossible."""
    case = Case(5, 6, 20, 60, ("known",))
    most = np.where(case.assigned, np.maximum(case.a, case.b), case.a)[case.free]
    with np.errstate(divide="ignore"):
        bare = np.exp(case.found(probability, QUADRATURE, 0.0))[case.free]
    for floor in (1e-6, 1e-2):
        found = np.exp(case.found(probability, QUADRATURE, floor))[case.free]
        if probability == INDEPENDENT:
            # Every camera has at least floor (a + b), and its factor grows by no more than that.
            least = np.prod(np.where(case.assigned[case.free], floor * most, most), axis=1)
            assert np.all(found >= least * (1 - 1e-9))
            assert np.all(found >= bare * (1 - 1e-9))
        else:
            least = floor * np.prod(most, axis=1)
            np.testing.assert_allclose(found, np.maximum(bare, least), rtol=1e-6)
