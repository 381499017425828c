"""`occlog priors`: read inputs, estimate priors of occluders, and write them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.errors import InputError, UsageError, did_you_mean, option
from occlog.io.open import check_unit, input_losses, load_scene, open_input
from occlog.records.columns import ColumnTable
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Doa, Occluders, Tracks, Truth, Views
from occlog.runner import Job
from occlog.settings import configure

from .config import AcousticConfig, HullConfig, PositionPriorConfig
from .from_positions import kalman_priors, virtual_priors
from .from_sound import acoustic_priors
from .from_views import hull_priors
from .request import AcousticRequest, HullRequest, KalmanRequest

T = TypeVar("T", bound=ColumnTable)
S = TypeVar("S", Views, Bearings)
Result = tuple[dict[str, object], tuple[Loss, ...]]


class TableStream:
    """Stream of a table in a table file or recording, with its scene and the losses of its provenance."""

    def __init__(self, path: Path, scene: Path | None) -> None:
        """Open the file; only headers are read. `scene` is a file that replaces the scene in it; None: not replaced."""
        self.path = path
        self.opened = open_input(path)
        self.losses = self.opened.losses
        recorded = self.opened.scene
        self.scene = None if scene is None and recorded is None else load_scene(scene, recorded, path)
        if self.scene is not None and self.opened.made_in_a_scene:
            check_unit(self.opened, self.scene.length_unit)

    @property
    def unit(self) -> str:
        """Length unit of the table; m if it states none."""
        return self.opened.length_unit or "m"

    def need_scene(self) -> Scene:
        """The scene; UsageError if none is given."""
        return self.scene if self.scene is not None else load_scene(None, None, self.path)

    def chunks(self, table: type[T]) -> Iterator[T]:
        """Generate all rows of a table; InputError if the file has none."""
        return _not_empty(self.opened.rows(table), self.path)


def _not_empty(chunks: Iterable[T], path: Path) -> Iterator[T]:
    rows = 0
    for chunk in chunks:
        rows += len(chunk)
        yield chunk
    if rows == 0:
        raise InputError(
            f"{path}: has no rows, of which occluders could be estimated; give another file", id="empty-input"
        )


def run_kalman(request: KalmanRequest, job: Job) -> Result:
    """Estimate priors of occluders from positions by Kalman filters, write them; return the summary and input losses.

    UsageError if options contradict the kind of positions; InputError if no row is of a moving occluder.
    """
    path, measured = request.positions, request.measured
    source = TableStream(path, request.scene)
    unit = source.scene.length_unit if source.scene is not None else source.unit
    tracks = source.opened.recording is None and source.opened.has(Tracks)
    if tracks and not measured:
        raise UsageError(
            f"{path}: holds tracks, which have errors already; add {option('measured')}, so that no noise is added to "
            "their positions",
            id="missing-option",
        )
    defaults = PositionPriorConfig.in_unit(unit)
    config = configure(replace(defaults, measurement_noise=0.0) if tracks else defaults, request.settings)
    if measured and config.measurement_noise == 0 and not tracks:
        raise UsageError(
            f"{option('measured')} positions need a {option('measurement_noise')} above 0; omit "
            f"{option('measured')} if they are exact",
            id="missing-option",
        )
    if measured:
        rows: Iterator[Tracks] | Iterator[Truth] = (
            job.progress(source.chunks(Tracks), "priors") if tracks else job.progress(source.chunks(Truth), "priors")
        )
        priors = kalman_priors(rows, config, without=request.without)
    else:
        truth = job.progress(source.chunks(Truth), "priors")
        left = (c.take(~np.isin(c.target_id, request.without)) for c in truth)
        priors = virtual_priors(left, config.measurement_noise, config.process_noise_velocity, request.seed)
    parameters = {"source": "kalman", "measured": measured, "without": request.without, **asdict(config)}
    provenance, tally = job.provenance(parameters, source.losses, request.seed), PriorsTally()
    with job.tables(provenance, unit) as tables:
        for table in priors:
            tables.write(output=table)
            tally.add(table)
        if not tally.identities:
            raise InputError(
                f"{path}: no row is of a moving occluder; priors need rows of the role occluder: give a file with some",
                id="empty-input",
            )
    head = {"occluders": str(request.output), "source": "kalman", "measurement_noise": config.measurement_noise}
    return {**head, **tally.summary()}, source.losses


def run_hull(request: HullRequest, job: Job) -> Result:
    """Estimate priors of occluders from views by visual hulls, and write them; return the summary and input losses."""
    path = request.views
    source = TableStream(path, request.scene)
    scene = source.need_scene()
    used = cameras_of(request, scene)
    config = configure(HullConfig.in_unit(scene.length_unit), request.settings)
    views = _of_cameras(job.progress(source.chunks(Views), "hull"), used)
    observed = None if request.bearings is None else TableStream(request.bearings, request.scene)
    frames = None if observed is None else _of_cameras(observed.chunks(Bearings), used)
    losses = input_losses([source.opened, None if observed is None else observed.opened])
    provenance = job.provenance({"source": "hull", "cameras": used, **asdict(config)}, losses)
    tally, candidates, n_steps = PriorsTally(), 0, 0
    with job.tables(provenance, scene.length_unit) as tables:
        for part in hull_priors(views, scene, config, frames):
            tables.write(output=part.occluders, hulls=part.hulls)
            tally.add(part.occluders)
            candidates, n_steps = candidates + part.candidates, n_steps + part.n_steps
        if not n_steps:
            raise InputError(f"{path}: no row is of the chosen cameras; choose others", id="empty-input")
    summary = {"occluders": str(request.output), "source": "hull", "cameras": len(used), **tally.summary()}
    return {**summary, "candidates_per_step": candidates / n_steps}, losses


def cameras_of(request: HullRequest, scene: Scene) -> list[str]:
    """Names of the cameras with a pose that a request selects, in scene order.

    Raises:
        UsageError: a named camera is not in the scene, or fewer than two cameras are left.
    """
    names = tuple(c.name for c in scene.cameras)
    for name in (*request.cameras, *request.without):
        if name not in names:
            raise UsageError(
                f"no camera {name!r} in the scene; {did_you_mean(name, names, 'it has')}", id="unknown-sensor"
            )
    placed = [c.name for c in scene.cameras if c.placed and c.name not in request.without]
    used = [name for name in placed if not request.cameras or name in request.cameras]
    if len(used) < 2:
        raise UsageError(
            f"{len(used)} cameras with a pose are left; a visual hull needs at least 2: calibrate or choose more",
            id="too-few-sensors",
        )
    return used


def run_acoustic(request: AcousticRequest, job: Job) -> Result:
    """Estimate priors of occluders from directions of arrival, and write them; return the summary and input losses."""
    source = TableStream(request.doa, request.scene)
    scene = source.need_scene()
    config = configure(AcousticConfig.in_unit(scene.length_unit), request.settings)
    chunks = job.progress(source.chunks(Doa), "acoustic")
    tally = PriorsTally()
    with job.tables(
        job.provenance({"source": "acoustic", **asdict(config)}, source.losses), scene.length_unit
    ) as tables:
        for table in acoustic_priors(chunks, scene, config):
            tables.write(output=table)
            tally.add(table)
    return {"occluders": str(request.output), "source": "acoustic", **tally.summary()}, source.losses


def _of_cameras(chunks: Iterable[S], names: list[str]) -> Iterator[S]:
    for chunk in chunks:
        yield chunk.take(np.isin(chunk.sensor, names))


class PriorsTally:
    """Counts of priors, and their mean spread, for the summary."""

    def __init__(self) -> None:
        """Start all counts at 0."""
        self.rows = 0
        self.occluders = 0
        self.times = 0
        self.identities: set[int] = set()
        self.spread = 0.0

    def add(self, table: Occluders) -> None:
        """Count the rows of a table; those without occluder count as times only."""
        there = table.occluder_id >= 0
        self.rows += len(table)
        self.times += len(np.unique(table.t_ns))
        self.occluders += int(there.sum())
        self.identities.update(table.occluder_id[there].tolist())
        self.spread += float(np.sum(table.cov_xx[there] + table.cov_yy[there]))

    def summary(self) -> dict[str, object]:
        """Figures of the summary by name.

        `mean_occluders`: per time; None without times. `rms_sigma`: RMS position error expected from the covariances of
        the priors [length]; None without priors.
        """
        return {
            "times": self.times,
            "identities": len(self.identities),
            "mean_occluders": self.occluders / self.times if self.times else None,
            "rms_sigma": (self.spread / self.occluders) ** 0.5 if self.occluders else None,
        }
