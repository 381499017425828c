"""[Ercan] Fig. 10: CPU time of the likelihood against the number of cameras, measured in this process."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.occlusion.priors import Priors
from occlog.filtering.likelihood.directions import PackedScan, log_likelihood, log_likelihood_among
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.measure.priors.from_positions import virtual_priors
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, power_of, quotient_of
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Occluders, Truth
from occlog.scans.grouping import BearingRows, choose_sensors, scans_of
from occlog.scans.occluder_priors import OccluderFeed, known_positions
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import (
    OCCLUDER_SUPPORT_SIGMAS,
    occlusion_of,
    pack_detection,
    pack_noise,
    pack_scan,
    pack_sensors,
    read_noise,
)

from .trial import KNOWN, NONE, SQUARE_ORDER, names, square_room

RECURSION, INDEPENDENT = "priors, recursion", "priors, independent"
SCATTER = 4.0
"""Standard deviation of the particles around the target, about the tracker's error with 4 cameras."""
LINEAR, NEARLY = 1.3, 1.6
"""Largest exponents of N that count as close to linear, and as in part."""


class LikelihoodInput(NamedTuple):
    """Input of the likelihood at one step: L particles (L, 2), packed scan, and priors by name of the series."""

    xy: Floats  # (L, 2) positions of the particles
    packed: PackedScan
    priors: dict[str, Priors]  # by series


class LikelihoodForm(NamedTuple):
    """One form of the likelihood to be timed: name of its series, and settings of the filter."""

    series: str
    config: ApfConfig


LIKELIHOOD_FORMS = (
    LikelihoodForm(NONE, ApfConfig()),
    LikelihoodForm(KNOWN, ApfConfig()),
    LikelihoodForm(INDEPENDENT, ApfConfig(likelihood="independent")),
    LikelihoodForm(RECURSION, ApfConfig(likelihood="recursion", occlusion_form="printed")),
)


def fig10(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Measure the CPU time of the likelihoods of a step, relative to two cameras without priors, as a table.

    All forms are timed at the same steps; a run is one pass over its own world. x is the number of cameras.
    """
    scene = scene_from_yaml(square_room(pillar=True), "scene")
    counts = (2, 4, 8) if size.quick else tuple(range(1, 9))
    taken: dict[tuple[str, int], list[float]] = {}
    for run in range(size.runs):
        truth, bearings = _world(scene, size, run)
        for n in counts:
            _measure(taken, scene, n, list(_steps(scene, truth, bearings, n, size)))
    unit = taken[NONE, 2]
    return [
        PaperRow(
            s.series,
            n,
            tuple(t / u for t, u in zip(taken[s.series, n], unit, strict=True)),
            {"milliseconds": 1e3 * math.fsum(taken[s.series, n]) / size.runs / size.steps},
        )
        for s in LIKELIHOOD_FORMS
        for n in counts
    ]


def _world(scene: Scene, size: Size, run: int) -> tuple[Truth, Bearings]:
    seed = size.seed + run
    truth = Truth.concat(list(simulate_truth(scene, WorldConfig(steps=size.steps, occluders=40), seed)))
    return truth, Bearings.concat(list(observe(scene, [truth], ObserveConfig(diameter=3.33), seed)))


def _steps(scene: Scene, truth: Truth, bearings: Bearings, n: int, size: Size) -> Iterator[LikelihoodInput]:
    """Generate the input of a filter at each step: measurements, priors, and particles around the target.

    Args:
        scene: scene.
        truth: positions of target and occluders.
        bearings: bearings of all cameras.
        n: number of cameras that are used.
        size: number of particles, and seed.
    """
    known = OccluderFeed([Occluders.concat(list(known_positions([truth])))], 3.33, 10**10)
    guessed = OccluderFeed([Occluders.concat(list(virtual_priors([truth], 8.0, 1.2, size.seed)))], 3.33, 10**10)
    target = truth.take(truth.target_id == 0)
    rng = np.random.default_rng(size.seed)
    read = read_noise(scene)
    use = BearingRows(choose_sensors(scene, names(SQUARE_ORDER[:n])))
    for index, group in enumerate(scans_of([bearings], scene, use)):
        scan, exact, prior = group.of_target(0), known.at(group.t_ns), guessed.at(group.t_ns)
        if scan is None or exact is None or prior is None:
            continue
        middle = np.array([target.x[index], target.y[index]])
        xy = middle + SCATTER * rng.standard_normal((size.particles, 2))
        yield LikelihoodInput(xy, pack_scan(scan, read, True), {KNOWN: exact, INDEPENDENT: prior, RECURSION: prior})


def _measure(taken: dict[tuple[str, int], list[float]], scene: Scene, n: int, steps: list[LikelihoodInput]) -> None:
    """Measure the CPU time [s] of all steps for every form, and append it to `taken`, by form and n.

    `n` is the number of cameras; one step is computed before, to compile the kernels.
    """
    for form in LIKELIHOOD_FORMS:
        compute = _likelihood(scene, form)
        compute(steps[0])  # compiles the kernels before the time is taken
        start = time.process_time()
        for step in steps:
            compute(step)
        taken.setdefault((form.series, n), []).append(time.process_time() - start)


def _likelihood(scene: Scene, form: LikelihoodForm) -> Callable[[LikelihoodInput], Floats]:
    informed = form.series != NONE
    sensors, noise = pack_sensors(scene), pack_noise(scene)
    detection = pack_detection(scene, form.config, informed=informed)

    def compute(step: LikelihoodInput) -> Floats:
        free = np.ones(len(step.xy), dtype=np.bool_)
        if not informed:
            return np.asarray(
                log_likelihood(step.xy, step.packed, sensors=sensors, noise=noise, model=detection, free=free)
            )
        priors = step.priors[form.series]
        occlusion = occlusion_of(form.config)._replace(far=OCCLUDER_SUPPORT_SIGMAS)
        return log_likelihood_among(
            step.xy,
            step.packed,
            sensors=sensors,
            noise=noise,
            model=detection,
            free=free,
            priors=priors,
            occlusion=occlusion,
        )

    return compute


def judge10(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 10, from two cameras on: the time grows about linearly with the cameras, not as 2^N."""
    own = {s.series: [r for r in v.series(table, s.series) if r.x >= 2] for s in LIKELIHOOD_FORMS}
    none, out = own[NONE], []
    for key, name in (("recursion", RECURSION), ("independent", INDEPENDENT)):
        rows = own[name]
        if len(rows) < 2 or len(none) < 2:
            continue
        power, growth = power_of(rows), quotient_of(rows[-1], rows[0])
        statement = f"Time grows about linearly with the cameras ({name}): exponent of N."
        rule = f"exponent of N at most {LINEAR}; in part up to {NEARLY}"
        linear, nearly = v.at_most(LINEAR), v.at_most(NEARLY)
        out.append(v.judge(f"fig10-linear-{key}", statement, power, linear, nearly, rule=rule, paper=1.0))
        most = 2.0 ** (rows[-1].x - rows[0].x)
        statement = f"Time grows much less than 2^N ({name}): from the fewest cameras to the most, by this factor."
        rule = "below half of 2^N; in part below 2^N"
        half, whole = v.below(0.5 * most), v.below(most)
        out.append(v.judge(f"fig10-exponential-{key}", statement, growth, half, whole, rule=rule, paper=most))
        statement = f"Time grows about as without priors ({name}): quotient of the two growths."
        out.append(v.stated(f"fig10-as-none-{key}", statement, 1.0, quotient_of(_growth(rows), _growth(none))))
    return out


def _growth(rows: list[PaperRow]) -> PaperRow:
    """Ratio of the CPU time with the most cameras to that with the fewest, run by run, as a row."""
    growth = tuple(b / a for a, b in zip(rows[0].values, rows[-1].values, strict=True))
    return PaperRow("growth", math.nan, growth)


FIG10 = Experiment(
    item="fig10",
    title="CPU time of the likelihood",
    x_label="cameras",
    y_label="time, relative",
    runs=5,
    steps=4000,
    quick=(2, 100),
    compute=fig10,
    judge=judge10,
    note="M = 40, one static occluder; 1 is two cameras without priors.",
)
