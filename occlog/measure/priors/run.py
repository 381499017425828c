"""What `occlog priors` does: read, find occluders, write."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from occlog import console
from occlog.errors import InputError, UsageError, option
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import check_unit, load_scene, losses_of, open_input
from occlog.records.columns import Table
from occlog.records.tables import Bearings, Doa, Hulls, Occluders, Tracks, Truth, Views
from occlog.scans.grouping import nearest
from occlog.settings import configure

from .config import AcousticConfig, HullConfig, KalmanConfig
from .from_positions import kalman_priors, virtual_priors
from .from_sound import acoustic_priors
from .from_views import hull_priors

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene

T = TypeVar("T", bound=Table)
S = TypeVar("S", Views, Bearings)
Result = tuple[dict[str, object], tuple["Loss", ...]]


class Cameras(NamedTuple):
    """Names of cameras to use; none: all but those left out."""

    only: tuple[str, ...]
    without: tuple[str, ...]

    def chosen(self, scene: Scene) -> list[str]:
        """Names of cameras with a pose; UsageError for one that the scene does not have, or if under two are left."""
        names = tuple(c.name for c in scene.cameras)
        for name in (*self.only, *self.without):
            if name not in names:
                raise UsageError(f"no camera {name!r} in the scene; {nearest(name, names)}")
        placed = [c.name for c in scene.cameras if c.placed]
        used = [n for n in placed if n not in self.without and (not self.only or n in self.only)]
        if len(used) < 2:
            raise UsageError(f"{len(used)} cameras with a pose are left; a visual hull needs at least 2")
        return used


@dataclass(frozen=True)
class KalmanRequest:
    """Positions, and what to make of them."""

    positions: Path
    scene: Path | None
    settings: Mapping[str, object]  # of `KalmanConfig`, as far as they were given
    measured: bool  # they are real measurements
    without: tuple[int, ...]  # identities that are left out
    seed: int


@dataclass(frozen=True)
class HullRequest:
    """Views, and what to make of them."""

    views: Path
    bearings: Path | None
    scene: Path | None
    cameras: Cameras
    settings: Mapping[str, object]  # of `HullConfig`, as far as they were given


class Source:
    """A table in a file of either kind, as a stream, with the scene and what had been lost before."""

    def __init__(self, path: Path, scene: Path | None) -> None:
        """Open; nothing but headers is read yet."""
        self.path = path
        self.opened = open_input(path)
        self.losses = self.opened.losses
        recorded = self.opened.scene
        self.scene = None if scene is None and recorded is None else load_scene(scene, recorded, path)
        if self.scene is not None and self.opened.made_in_a_scene:
            check_unit(self.opened, self.scene.length_unit)

    @property
    def unit(self) -> str:
        """Of lengths."""
        return self.opened.length_unit or "m"

    def need_scene(self) -> Scene:
        """The scene; UsageError if none was given."""
        return self.scene if self.scene is not None else load_scene(None, None, self.path)

    def chunks(self, table: type[T]) -> Iterator[T]:
        """All rows of a table; InputError if the file does not hold them or has none."""
        return _not_empty(self.opened.rows(table), self.path)


def _not_empty(chunks: Iterable[T], path: Path) -> Iterator[T]:
    rows = 0
    for chunk in chunks:
        rows += len(chunk)
        yield chunk
    if rows == 0:
        raise InputError(f"{path}: has no rows; nothing can be found from it")


def run_kalman(request: KalmanRequest, output: Path, overwrite: bool, quiet: bool) -> Result:
    """Positions to priors; the summary and what had been lost before."""
    path, measured = request.positions, request.measured
    source = Source(path, request.scene)
    unit = source.scene.length_unit if source.scene is not None else source.unit
    tracks = source.opened.recording is None and source.opened.has(Tracks)
    if tracks and not measured:
        raise UsageError(f"{path}: tracks are measurements, not the truth; add {option('measured')}")
    defaults = KalmanConfig.in_unit(unit)
    config = configure(replace(defaults, sigma=0.0) if tracks else defaults, request.settings)
    if measured and config.sigma == 0 and not tracks:
        raise UsageError(
            f"{option('measured')} positions need a {option('sigma')} above 0; leave out "
            f"{option('measured')} if they are exact"
        )
    if measured:
        rows: Iterator[Tracks] | Iterator[Truth] = (
            console.progress(source.chunks(Tracks), "priors", quiet=quiet)
            if tracks
            else console.progress(source.chunks(Truth), "priors", quiet=quiet)
        )
        priors = kalman_priors(rows, config, without=request.without)
    else:
        truth = console.progress(source.chunks(Truth), "priors", quiet=quiet)
        left = (c.take(~np.isin(c.target_id, request.without)) for c in truth)
        priors = virtual_priors(left, config.sigma, config.q, request.seed)
    parameters = {"source": "kalman", "measured": measured, "without": request.without, **asdict(config)}
    provenance = _provenance(parameters, [path, request.scene], source.losses, request.seed)
    tally = PriorsTally()
    with TableWriter(output, Occluders, provenance, overwrite=overwrite, length_unit=unit) as writer:
        for table in priors:
            writer.write(table)
            tally.add(table)
        if not tally.identities:
            raise InputError(f"{path}: no row is of a moving occluder; priors need rows of the role occluder")
    return {"occluders": str(output), "source": "kalman", "sigma": config.sigma, **tally.summary()}, source.losses


def run_hull(request: HullRequest, output: Path, hulls: Path | None, overwrite: bool, quiet: bool) -> Result:
    """Views to priors; the summary and what had been lost before."""
    path, scene, bearings = request.views, request.scene, request.bearings
    source = Source(path, scene)
    place = source.need_scene()
    used = request.cameras.chosen(place)
    config = configure(HullConfig.in_unit(place.length_unit), request.settings)
    views = _of_cameras(console.progress(source.chunks(Views), "hull", quiet=quiet), used)
    looked = None if bearings is None else Source(bearings, scene)
    frames = None if looked is None else _of_cameras(looked.chunks(Bearings), used)
    losses = losses_of([source.opened, None if looked is None else looked.opened])
    parameters = {"source": "hull", "cameras": used, **asdict(config)}
    provenance = _provenance(parameters, [path, scene, bearings], losses, None)
    tally, candidates, moments = PriorsTally(), 0, 0
    with ExitStack() as stack:
        outputs = [(output, Occluders)] + ([(hulls, Hulls)] if hulls is not None else [])
        writers = [
            stack.enter_context(TableWriter(p, t, provenance, overwrite=overwrite, length_unit=place.length_unit))
            for p, t in outputs
        ]
        for part in hull_priors(views, place, config, frames):
            for writer, table in zip(writers, (part.occluders, part.hulls), strict=False):
                writer.write(table)
            tally.add(part.occluders)
            candidates, moments = candidates + part.candidates, moments + part.moments
        if not moments:
            raise InputError(f"{path}: no row is of the chosen cameras; choose others")
    summary = {"occluders": str(output), "source": "hull", "cameras": len(used), **tally.summary()}
    return {**summary, "candidates_a_moment": candidates / moments}, losses


def run_acoustic(
    path: Path, scene: Path | None, values: Mapping[str, object], output: Path, overwrite: bool, quiet: bool
) -> Result:
    """Directions of arrival to priors; the summary and what had been lost before."""
    source = Source(path, scene)
    place = source.need_scene()
    config = configure(AcousticConfig.in_unit(place.length_unit), values)
    chunks = console.progress(source.chunks(Doa), "acoustic", quiet=quiet)
    provenance = _provenance({"source": "acoustic", **asdict(config)}, [path, scene], source.losses, None)
    tally = PriorsTally()
    with TableWriter(output, Occluders, provenance, overwrite=overwrite, length_unit=place.length_unit) as writer:
        for table in acoustic_priors(chunks, place, config):
            writer.write(table)
            tally.add(table)
    return {"occluders": str(output), "source": "acoustic", **tally.summary()}, source.losses


def _of_cameras(chunks: Iterable[S], names: list[str]) -> Iterator[S]:
    for chunk in chunks:
        yield chunk.take(np.isin(chunk.sensor, names))


def _provenance(
    parameters: dict[str, object], paths: list[Path | None], losses: tuple[Loss, ...], seed: int | None
) -> Provenance:
    return Provenance("priors", parameters, seed, hash_inputs([p for p in paths if p is not None]), losses)


class PriorsTally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.rows = 0
        self.occluders = 0
        self.times = 0
        self.identities: set[int] = set()
        self.spread = 0.0

    def add(self, table: Occluders) -> None:
        """Count some more rows."""
        there = table.occluder_id >= 0
        self.rows += len(table)
        self.times += len(np.unique(table.t_ns))
        self.occluders += int(there.sum())
        self.identities.update(table.occluder_id[there].tolist())
        self.spread += float(np.sum(table.cov_xx[there] + table.cov_yy[there]))

    def summary(self) -> dict[str, object]:
        """The figures; `rms_spread` is the RMS error that the priors expect of their means."""
        return {
            "times": self.times,
            "identities": len(self.identities),
            "occluders_a_time": self.occluders / self.times if self.times else None,
            "rms_spread": (self.spread / self.occluders) ** 0.5 if self.occluders else None,
        }
