"""Method `rssi`: a tag that walks among readers is found, and the covariance can be believed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from occlog.array_types import NS, Floats, Ints
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.track.methods.readers.rssi import PathLoss, TagEstimate, TagFilterModel, begin, step

ROOM = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 12.0], [0.0, 12.0]])
PLACES = np.array([[x, y, 1.0] for x in (1.0, 6.0, 11.0) for y in (1.0, 6.0, 11.0)])
MODEL = PathLoss(
    positions=PLACES,
    power=np.full(9, -60.0),
    exponent=2.0,
    noise_db=4.0,
    shadow_db=3.0,
    shadow_s=5.0,
    height=1.0,
    metre=1.0,
)
RULES = TagFilterModel(
    model=MODEL,
    ranges=np.full(9, np.inf),
    room=ROOM,
    particles=600,
    speed=0.5,
    turn_s=4.0,
    detection=0.95,
    stray=0.01,
)


class Walk(NamedTuple):
    """True places of a tag, and its reads."""

    xy: Floats  # (T, 2)
    count: Ints  # (T, R)
    rssi: Floats  # (T, R)


def walk(seed: int, steps: int = 60) -> Walk:
    """A walk of the filter's own motion, reflected by the walls, with shadowing and noise."""
    rng = np.random.default_rng(seed)
    xy, velocity, shadow = np.zeros((steps, 2)), 0.5 * rng.standard_normal(2), 3.0 * rng.standard_normal(9)
    here, decay, forget = rng.uniform(3.0, 9.0, 2), np.exp(-1.0 / 4.0), np.exp(-1.0 / 5.0)
    rssi = np.zeros((steps, 9))
    for k in range(steps):
        velocity = decay * velocity + 0.5 * np.sqrt(1.0 - decay**2) * rng.standard_normal(2)
        here = here + velocity
        velocity = np.where((here < 0.0) | (here > 12.0), -velocity, velocity)
        here = np.where(here < 0.0, -here, np.where(here > 12.0, 24.0 - here, here))
        shadow = forget * shadow + 3.0 * np.sqrt(1.0 - forget**2) * rng.standard_normal(9)
        xy[k] = here
        rssi[k] = MODEL.expected(here[None])[0] + shadow + 4.0 / np.sqrt(2.0) * rng.standard_normal(9)
    return Walk(xy, np.full((steps, 9), 2), rssi)


def filtered(rules: TagFilterModel, reads: Walk, seed: int = 0) -> list[TagEstimate]:
    rng = generator(seed, RandomStream.TRACK, 0)
    cloud = begin(rules, 0, rng)
    out = []
    for k in range(len(reads.xy)):
        cloud, found = step(rules, cloud, k * NS, reads.count[k], reads.rssi[k], rng)
        out.append(found)
    return out


def nees(reads: Walk, found: list[TagEstimate]) -> Floats:
    error = np.array([f.xy for f in found]) - reads.xy
    inverse = np.linalg.inv(np.array([f.covariance[:2, :2] for f in found]))
    return np.einsum("ni,nij,nj->n", error, inverse, error)


def test_the_covariance_is_that_of_the_errors_and_without_shadowing_it_would_be_too_small() -> None:
    walks = [walk(seed) for seed in range(8)]
    with_it = np.array([nees(w, filtered(RULES, w)).mean() for w in walks])
    as_noise = RULES._replace(model=MODEL._replace(noise_db=5.0 * np.sqrt(2.0), shadow_db=0.0))
    without = np.array([nees(w, filtered(as_noise, w)).mean() for w in walks])
    assert with_it.mean() < 2.0 + 3.0 * max(with_it.std() / np.sqrt(8.0), 0.2)
    assert with_it.mean() > 1.0
    worse = without - with_it
    assert worse.mean() > 2.0 * worse.std(ddof=1) / np.sqrt(8.0)


def test_a_tag_in_range_of_one_reader_is_found_by_reads_without_strengths() -> None:
    rules = RULES._replace(ranges=np.full(9, 2.5))
    inside = np.linalg.norm(PLACES[:, :2] - np.array([6.0, 6.0]), axis=1) <= 2.5
    reads = Walk(np.full((6, 2), 6.0), np.repeat(inside[None].astype(np.int64), 6, axis=0), np.full((6, 9), np.nan))
    last = filtered(rules, reads)[-1]
    assert np.linalg.norm(last.xy - 6.0) < 1.0
    assert last.covariance[0, 0] < 4.0


def test_particles_stay_in_the_room() -> None:
    reads = walk(1, 5)
    assert all(((f.xy > 0.0) & (f.xy < 12.0)).all() for f in filtered(RULES, reads))


def test_reads_that_no_particle_explains_begin_anew() -> None:
    rng = np.random.default_rng(0)
    cloud = begin(RULES, 0, rng)
    far = cloud._replace(xy=cloud.xy + 100.0)
    reads = walk(2, 1)
    _, found = step(RULES, far, NS, reads.count[0], reads.rssi[0], rng)
    assert found.restarted
    assert np.isfinite(found.xy).all()


@pytest.mark.parametrize("seed", [0, 5])
def test_the_same_seed_gives_the_same_track(seed: int) -> None:
    reads = walk(3, 4)
    a, b = filtered(RULES, reads, seed), filtered(RULES, reads, seed)
    assert all(np.array_equal(x.xy, y.xy) for x, y in zip(a, b, strict=True))
