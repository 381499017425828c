"""Run of `occlog fit-readers`: read reads and true positions, fit, write."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.numerics.interpolate import interpolate_positions
from occlog.errors import InputError, UsageError, option
from occlog.io.formats.models.motion_models import CoverageSpec, PathLossSpec, ReaderLoss, write_path_loss
from occlog.io.open import Opened, input_losses, load_scene, open_input
from occlog.records.scene import Scene, TagReader
from occlog.records.tables import Reads, Truth
from occlog.runner import Job
from occlog.settings import configure
from occlog.track.methods.readers.inputs import metre_of, windows_of
from occlog.track.methods.readers.rssi import PathLoss

from .config import FitReadersConfig
from .estimate import TagWindows, choose_range, fit_losses, fit_shadowing, usual_ranges
from .request import FitReadersRequest

if TYPE_CHECKING:
    from occlog.records.losses import Loss

MIN_WINDOWS = 20
"""Fewer windows with a true position say little."""
START_SHADOW_DB, START_SHADOW_S = 3.0, 5.0
"""Initial value of the search for the shadowing."""


class _FitSamples:
    """Signal strengths with distances, and windows of reads with true positions, collected over recordings."""

    def __init__(self, readers: tuple[TagReader, ...], config: FitReadersConfig, metre: float) -> None:
        self.readers, self.config, self.metre = readers, config, metre
        self.reader: list[Ints] = []
        self.distance: list[Floats] = []
        self.rssi: list[Floats] = []
        self.segments: list[TagWindows] = []
        self.without = 0

    def add(self, opened: Opened) -> None:
        """Add the reads of one recording, with the true positions of the tags.

        InputError for a reader that the scene does not have, or a tag without true positions.
        """
        reads, truth = opened.read(Reads), opened.read(Truth)
        names = [r.name for r in self.readers]
        unknown = np.flatnonzero(~np.isin(reads.sensor, names))
        if len(unknown):
            raise InputError(
                f"{opened.path}: reader {reads.sensor[unknown[0]]} is not in the scene; give a scene "
                f"with all readers ({option('scene')})",
                id="unknown-sensor",
            )
        gap_ns = round(self.config.max_gap_s * NS)
        for target in np.unique(reads.target_id).tolist():
            own, path = reads.take(reads.target_id == target), truth.take(truth.target_id == target)
            if not len(path):
                raise InputError(
                    f"{opened.path}: the truth has no target {target}, of which there are reads; add its "
                    "true positions",
                    id="disjoint-inputs",
                )
            positions = np.column_stack([path.x, path.y])
            self._strengths(own, *interpolate_positions(own.t_ns, path.t_ns, positions, gap_ns))
            self._windows(own, path, positions, gap_ns)

    def _strengths(self, reads: Reads, xy: Floats, good: np.ndarray) -> None:
        """Add the strengths of single reads, with their distances from the readers to the true positions.

        Args:
            reads: n reads of one tag.
            xy: (n, 2) true positions at the times of the reads.
            good: (n,) whether the position is known; other reads are only counted.
        """
        usable = good & np.isfinite(reads.rssi)
        index_of = {r.name: k for k, r in enumerate(self.readers)}
        number = np.array([index_of[name] for name in reads.sensor[usable].tolist()], dtype=np.int64)
        at = np.array([r.position for r in self.readers])[number]
        drop = at[:, 2] - self.config.tag_height
        distance = np.sqrt(((xy[usable] - at[:, :2]) ** 2).sum(axis=1) + drop**2)
        self.reader.append(number)
        self.distance.append(distance / self.metre)
        self.rssi.append(reads.rssi[usable])
        self.without += int(np.count_nonzero(~good))

    def _windows(self, reads: Reads, truth: Truth, positions: Floats, gap_ns: int) -> None:
        """Add the windows of one tag's reads that have a true position.

        Args:
            reads: reads of the tag.
            truth: n true states of the tag.
            positions: (n, 2) its true positions.
            gap_ns: longest gap between two true positions that is interpolated [ns].
        """
        names = [r.name for r in self.readers]
        for part in windows_of([reads], names, round(self.config.window_s * NS)):
            xy, good = interpolate_positions(part.t_ns, truth.t_ns, positions, gap_ns)
            if good.any():
                kept = part.take(good)
                seconds = (kept.t_ns - kept.t_ns[0]) / NS
                self.segments.append(TagWindows(seconds, xy[good], kept.count, kept.rssi))


def run_fit_readers(request: FitReadersRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Fit path losses, shadowing and coverage to the request's recordings, and write them.

    Return the figures of the summary, and the losses recorded in the inputs. InputError if the reads do not suffice.
    """
    inputs = [open_input(path, Reads) for path in request.recordings]
    for opened in inputs:
        opened.require(Truth, remedy="add true positions of the tags by `occlog ingest` (truth)")
    scene = _common_scene(request, inputs)
    config = configure(FitReadersConfig.in_unit(scene.length_unit), request.settings)
    metre = metre_of(scene.length_unit)
    collected = _FitSamples(scene.readers, config, metre)
    for opened in job.progress(inputs, "read"):
        collected.add(opened)
    where = ", ".join(str(p) for p in request.recordings)
    windows = sum(len(s.t_s) for s in collected.segments)
    if windows < MIN_WINDOWS:
        raise InputError(
            f"{where}: {windows} windows of reads have a true position, at least {MIN_WINDOWS} are needed; give more "
            f"recordings, or a longer {option('max_gap')}",
            id="insufficient-data",
        )
    positions = np.array([r.position for r in scene.readers])
    reader, rssi = np.concatenate(collected.reader), np.concatenate(collected.rssi)
    try:
        # Path losses by least squares over single reads
        losses = fit_losses(reader, np.concatenate(collected.distance), rssi, len(positions))
        model = PathLoss(
            positions=positions,
            power=losses.power,
            exponent=losses.exponent,
            noise_db=losses.residual_db,
            shadow_db=START_SHADOW_DB,
            shadow_s=START_SHADOW_S,
            height=config.tag_height,
            metre=metre,
        )
        # Shadowing by maximum likelihood over windows
        model = fit_shadowing(model, collected.segments)
        # Range of the virtual sensors by the least error
        ranges = usual_ranges(positions[:, :2]) if config.ranges is None else np.asarray(config.ranges)
        coverage = choose_range(model, collected.segments, ranges.tolist(), scene.room)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    reads = np.bincount(reader, minlength=len(positions))
    figures: dict[str, object] = {
        "reads": len(rssi),
        "windows": windows,
        "reads_without_truth": collected.without,
        "exponent_error": losses.exponent_error,
        "residual_db": losses.residual_db,
        "coverage_rms": coverage.rms,
    }
    spec = PathLossSpec(
        length_unit=scene.length_unit,  # type: ignore[arg-type]
        height=config.tag_height,
        exponent=model.exponent,
        noise_db=model.noise_db,
        shadow_db=model.shadow_db,
        shadow_s=model.shadow_s,
        window_s=config.window_s,
        readers=[
            ReaderLoss(name=r.name, power=float(p), error=float(e) if n else None, reads=int(n))
            for r, p, e, n in zip(scene.readers, losses.power, losses.error, reads, strict=True)
        ],
        coverage=CoverageSpec(range=coverage.range, detection=coverage.detection, stray=coverage.stray),
        fit=figures,
    )
    lost = input_losses(inputs)
    write_path_loss(request.output, spec, job.provenance(asdict(config), lost), overwrite=job.overwrite)
    silent = [r.name for r, n in zip(scene.readers, reads, strict=True) if not n]
    if silent:
        job.note(f"warning: without a read, so with the mean power of the others: {', '.join(silent)}")
    shown = {
        "path_loss": str(request.output),
        "exponent": model.exponent,
        "power_mean": float(losses.power.mean()),
        "noise_db": model.noise_db,
        "shadow_db": model.shadow_db,
        "shadow_s": model.shadow_s,
        "range": coverage.range,
        "detection": coverage.detection,
        "stray": coverage.stray,
    }
    return {**shown, **figures}, lost


def _common_scene(request: FitReadersRequest, inputs: list[Opened]) -> Scene:
    """Return the scene of all recordings: that of the request, or of the first recording.

    UsageError if positions of readers or units differ between recordings, InputError without readers.
    """
    scene = load_scene(request.scene, inputs[0].scene, request.recordings[0])
    if not scene.readers:
        raise InputError(
            f"{request.recordings[0]}: its scene has no readers; give a scene that has ({option('scene')})",
            id="too-few-sensors",
        )
    wanted = _layout(scene)
    for opened in inputs:
        if opened.scene is not None and request.scene is None and _layout(opened.scene) != wanted:
            raise UsageError(
                f"{opened.path}: its readers or its length unit are not those of {inputs[0].path}; "
                f"fit each alone, or give one scene of all ({option('scene')})",
                id="incompatible-inputs",
            )
    return scene


def _layout(scene: Scene) -> tuple[object, ...]:
    """Return the length unit, and sorted names with positions of the readers of a scene, to compare scenes."""
    return (scene.length_unit, *sorted((r.name, *r.position.tolist()) for r in scene.readers))
