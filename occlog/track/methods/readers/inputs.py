"""Inputs of the methods that take reads: windows of a recording, readers of the scene, path losses.

Reads of some time as one observation: which readers read a tag in a window, how often, how strongly.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.errors import InputError, UsageError, abridged, did_you_mean, option
from occlog.io.files.timing.utc import time_words
from occlog.io.formats.models.motion_models import PathLossSpec, model_losses, read_path_loss
from occlog.io.open import input_losses, load_scene, open_input
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene, TagReader
from occlog.records.tables import Bearings, Reads
from occlog.settings import METRES, configure
from occlog.track.request import ReadsRequest

from .config import RefineConfig, RssiConfig, VirtualConfig
from .refine import RefineBearings
from .rssi import PathLoss, TagFilterModel
from .virtual_sensors import ReaderRegions, virtual_sensors


@dataclass(frozen=True, eq=False)
class Windows:
    """W observation windows of tags by R readers, in time order; windows in which no reader read the tag are absent."""

    t_ns: Ints  # (W,) mean time of the reads
    target_id: Ints  # (W,)
    count: Ints  # (W, R) reads
    rssi: Floats  # (W, R) mean strength [dBm]; NaN: no read tells it

    def __len__(self) -> int:
        return len(self.t_ns)

    def take(self, rows: Ints | Bools | slice) -> Windows:
        """Return the windows selected by a mask, a slice or indices."""
        return Windows(self.t_ns[rows], self.target_id[rows], self.count[rows], self.rssi[rows])


def windows_of(
    chunks: Iterable[Reads], readers: Sequence[str], window_ns: int, targets: Sequence[int] = ()
) -> Iterator[Windows]:
    """Generate reads grouped by time window and tag, in time order; the result does not depend on the chunks.

    Args:
        chunks: reads in the order of time.
        readers: names of the readers to use; they are the columns.
        window_ns: length of a window [ns], > 0; the first one begins at the first read.
        targets: tags to keep; none: all.

    Raises:
        InputError: times go back from one chunk to the next.
    """
    first: int | None = None
    last = 0
    rest = Reads.empty()
    for chunk in chunks:
        if not len(chunk):
            continue
        if first is None:
            first = int(chunk.t_ns[0])
        elif chunk.t_ns[0] < last:
            raise InputError(
                f"reads: time {time_words(chunk.t_ns[0])} is earlier than the preceding "
                f"{time_words(last)}; sort by t_ns",
                id="unsorted-times",
            )
        last = int(chunk.t_ns[-1])
        kept = np.isin(chunk.sensor, list(readers))
        if targets:
            kept &= np.isin(chunk.target_id, targets)
        rows = Reads.concat([rest, chunk.take(kept)])
        # The last window may go on in the next chunk
        begun = first + (last - first) // window_ns * window_ns
        cut = int(np.searchsorted(rows.t_ns, begun))
        yield _collected(rows.take(slice(0, cut)), readers, first, window_ns)
        rest = rows.take(slice(cut, None))
    if first is not None:
        yield _collected(rest, readers, first, window_ns)


def _collected(rows: Reads, readers: Sequence[str], first: int, window_ns: int) -> Windows:
    """Return reads grouped by time window and tag, in the order of time.

    Args:
        rows: reads of whole windows.
        readers: names of the readers, the columns.
        first: time at which the first window begins [ns].
        window_ns: length of a window [ns].
    """
    n = len(readers)
    if not len(rows):
        none = np.zeros(0, dtype=np.int64)
        return Windows(none, none, np.zeros((0, n), dtype=np.int64), np.zeros((0, n)))
    index_of = {name: k for k, name in enumerate(readers)}
    reader = np.array([index_of[name] for name in rows.sensor.tolist()], dtype=np.int64)
    number = (rows.t_ns - first) // window_ns
    pairs = np.column_stack([number, rows.target_id.astype(np.int64)])
    unique, group = np.unique(pairs, axis=0, return_inverse=True)
    group = group.ravel()
    size = len(unique)
    cell = group * n + reader
    count = np.bincount(cell, minlength=size * n)
    finite = np.isfinite(rows.rssi)
    heard = np.bincount(cell[finite], minlength=size * n)
    total = np.bincount(cell[finite], weights=rows.rssi[finite], minlength=size * n)
    mean = np.where(heard > 0, total / np.maximum(heard, 1), np.nan)
    # Mean times, relative to the first read: float64 cannot hold ns since 1970 exactly
    away = np.bincount(group, weights=(rows.t_ns - first).astype(np.float64), minlength=size)
    t_ns = first + np.round(away / np.bincount(group, minlength=size)).astype(np.int64)
    order = np.lexsort((unique[:, 1], t_ns))
    found = Windows(t_ns, unique[:, 1], count.reshape(size, n), mean.reshape(size, n))
    return found.take(order)


WINDOW_NS = NS
"""Window of reads where none is given."""
REMEDY = "make a recording with reads by `occlog ingest` (readers, reads)"


class ReadsInput:
    """Inputs of a run that tracks tags: a stream of windows of reads, readers, scene and models.

    Attributes:
        scene: scene with the sensors, in its own unit.
        readers: readers in use.
        window_ns: length of a window [ns].
        first_ns: time of the first read [ns].
        losses: what was lost when the reads, and the path losses, were made.
    """

    def __init__(self, request: ReadsRequest) -> None:
        """Open the request's reads, scene and path losses.

        InputError if there are no reads of the chosen tags and readers, UsageError for a window of 0 s or less.
        """
        self.request = request
        opened = open_input(request.bearings, Reads, remedy=REMEDY)
        self.scene: Scene = load_scene(request.scene, opened.scene, request.bearings)
        self._opened = opened
        self._sights = None if request.refine_bearings is None else open_input(request.refine_bearings, Bearings)
        made = (*input_losses([opened, self._sights]), *model_losses([request.path_loss]))
        self.losses: tuple[Loss, ...] = tuple(dict.fromkeys(made))
        self.readers = choose_readers(self.scene, request)
        self.window_ns = WINDOW_NS if request.window_ns is None else request.window_ns
        if self.window_ns <= 0:
            raise UsageError(
                f"{option('window')}: a window of 0 s holds too few reads; give one above 0 s", id="invalid-setting"
            )
        self._known = None if request.path_loss is None else self._path_loss(request.path_loss)
        self._chunks = self._checked(opened.rows(Reads))
        first = next(self._chunks, None)
        if first is None:
            raise InputError(
                f"{request.bearings}: holds no RFID reads of the chosen tags and readers; choose others "
                f"({option('target')}, {option('cameras')}, {option('without')})",
                id="empty-input",
            )
        self.first_ns = int(first.t_ns[0])
        self._chunks = chain([first], self._chunks)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the readers used."""
        return tuple(r.name for r in self.readers)

    def windows(self) -> Iterator[Windows]:
        """Generate the windows of the selected readers and tags, chunk by chunk."""
        return windows_of(self._chunks, self.names, self.window_ns)

    def _checked(self, chunks: Iterator[Reads]) -> Iterator[Reads]:
        """Generate rows of the selected readers and tags; InputError for a reader missing in the scene."""
        known = tuple(r.name for r in self.scene.readers)
        for chunk in chunks:
            strange = np.flatnonzero(~np.isin(chunk.sensor, known))
            if len(strange):
                name = str(chunk.sensor[strange[0]])
                raise InputError(
                    f"{self.request.bearings}: reader {name!r} is not in the scene; "
                    f"{did_you_mean(name, known, 'it has')}",
                    id="unknown-sensor",
                )
            kept = np.isin(chunk.sensor, self.names)
            if self.request.targets:
                kept &= np.isin(chunk.target_id, self.request.targets)
            if kept.any():
                yield chunk.take(kept)

    def _path_loss(self, path: Path) -> PathLossSpec:
        """Return the content of the path-loss file.

        UsageError for another unit than the scene's, InputError for missing readers.
        """
        spec = read_path_loss(path)
        if spec.length_unit != self.scene.length_unit:
            raise UsageError(
                f"{path}: lengths are in {spec.length_unit}, but the scene's in "
                f"{self.scene.length_unit}; fit path losses in this scene (`occlog fit-readers`)",
                id="unit-mismatch",
            )
        known = {r.name for r in spec.readers}
        if (missing := next((r.name for r in self.readers if r.name not in known), None)) is not None:
            raise InputError(
                f"{path}: has no path loss of reader {missing}; fit it to reads of all readers, or "
                f"exclude this reader ({option('without')})",
                id="unknown-sensor",
            )
        return spec

    def virtual(self) -> tuple[VirtualConfig, ReaderRegions, Floats]:
        """Return settings of method `virtual`, its virtual sensors, and (R,) strengths from which a read counts [dBm].

        InputError if the range of a reader is not known.
        """
        given = dict(self.request.settings)
        config = configure(VirtualConfig.in_unit(self.scene.length_unit), given)
        positions = np.array([r.position for r in self.readers])
        if self._known is not None:
            refuse_twice(given, ("reader_range", "min_rssi_dbm", "detection_probability", "false_alarm_probability"))
            reach = self._known.coverage.range
            covers = self._known.coverage
            values = {"detection_probability": covers.detection, "false_alarm_probability": covers.stray}
            config = configure(config, {**values, "reader_range": reach})
            thresholds = path_loss_of(self._known, self.readers).strength_at(reach)
            ranges = np.full(len(positions), reach)
        else:
            ranges = np.array([self._range(r, config.reader_range) for r in self.readers])
            thresholds = np.full(len(positions), -np.inf if config.min_rssi_dbm is None else config.min_rssi_dbm)
        return config, virtual_sensors(positions[:, :2], ranges, self.scene.room), thresholds

    def _range(self, reader: TagReader, usual: float | None) -> float:
        """Return the reading range of a reader [length]: its own, else `usual`; InputError if both are unknown."""
        if np.isfinite(reader.range):
            return reader.range
        if usual is None:
            raise InputError(
                f"{self.request.bearings}: how far reader {reader.name} reads is not known; state "
                f"range in the scene, set reader_range, or give {option('path_loss')} of `occlog "
                "fit-readers`",
                id="missing-value",
            )
        return usual

    def rssi(self) -> tuple[RssiConfig, TagFilterModel]:
        """Return settings and model of method `rssi`; values of a path-loss file replace the settings."""
        given = dict(self.request.settings)
        config = configure(RssiConfig.in_unit(self.scene.length_unit), given)
        config = configure(config, {"particles": config.n_particles})
        if self._known is not None:
            spec = self._known
            refuse_twice(given, ("power", *FITTED.values()))
            values = {setting: getattr(spec, name) for name, setting in FITTED.items()}
            config = configure(config, values)
            model = path_loss_of(spec, self.readers)
        else:
            model = PathLoss(
                positions=np.array([r.position for r in self.readers]),
                power=np.array([config.power if r.power is None else r.power for r in self.readers]),
                exponent=config.path_loss_exponent,
                noise_db=config.noise_db,
                shadow_db=config.shadow_db,
                shadow_s=config.shadow_s,
                height=config.tag_height,
                metre=metre_of(self.scene.length_unit),
            )
        tag_model = TagFilterModel(
            model=model,
            ranges=np.array([r.range for r in self.readers]),
            room=self.scene.surroundings,
            particles=config.n_particles,
            speed=config.sigma_velocity,
            turn_s=config.velocity_time_constant_s,
            detection=config.detection_probability,
            stray=config.false_alarm_probability,
        )
        return config, tag_model

    def lines_of_sight(self, config: RefineConfig) -> RefineBearings | None:
        """Return the bearings of the cameras that refine positions; None if no camera does.

        UsageError for bearings without such a camera, or for too few cameras.
        """
        if config.refine is None:
            if self._sights is not None:
                raise UsageError(
                    f"{option('refine_bearings')} is of cameras that refine positions; name them with "
                    f"{option('set.refine')}NAME,...",
                    id="not-applicable",
                )
            return None
        cameras = tuple(self._camera(name) for name in dict.fromkeys(config.refine))
        if config.refine_method != "rays" and len(cameras) != 2:
            raise UsageError(
                f"{option('refine_method')} {config.refine_method} requires exactly two cameras to refine, got "
                f"{len(cameras)}; name two, or use {option('refine_method')} rays",
                id="too-few-sensors",
            )
        remedy = f"give bearings of the cameras that refine ({option('refine_bearings')})"
        bearings = (self._sights or self._opened).rows(Bearings, remedy=remedy)
        return RefineBearings(Bearings.concat(bearings), cameras, config.max_frame_age_s, config.gate, config.tag_speed)

    def _camera(self, name: str) -> Camera:
        """Return the camera of that name; UsageError if it has no pose in the scene."""
        known = tuple(c.name for c in self.scene.cameras if c.placed)
        if name not in known:
            raise UsageError(
                f"refine: no camera {name!r} with a pose in the scene; cameras: {abridged(known)}",
                id="unknown-sensor",
            )
        return self.scene.camera(name)

    def parameters(self, config: VirtualConfig | RssiConfig) -> dict[str, object]:
        """Return all parameters that influence the result, for the provenance."""
        return {
            "method": self.request.method,
            "sensors": sorted(self.names),
            "targets": list(self.request.targets),
            "window_ns": self.window_ns,
            "path_loss": None if self.request.path_loss is None else self.request.path_loss.name,
            **asdict(config),
        }


def choose_readers(scene: Scene, request: ReadsRequest) -> tuple[TagReader, ...]:
    """Return the selected readers of the scene.

    UsageError for an unknown name or an empty selection, InputError for a scene without readers.
    """
    known = tuple(r.name for r in scene.readers)
    if not known:
        raise InputError(
            f"{request.bearings}: its scene has no readers; give a scene that has ({option('scene')})",
            id="too-few-sensors",
        )
    for name in (*request.cameras, *request.without):
        if name not in known:
            raise UsageError(
                f"no reader {name!r} in the scene; {did_you_mean(name, known, 'it has')}", id="unknown-sensor"
            )
    chosen = tuple(
        r for r in scene.readers if (not request.cameras or r.name in request.cameras) and r.name not in request.without
    )
    if not chosen:
        raise UsageError("no reader is left; omit fewer of them", id="too-few-sensors")
    return chosen


FITTED = {
    "exponent": "path_loss_exponent",
    "noise_db": "noise_db",
    "shadow_db": "shadow_db",
    "shadow_s": "shadow_s",
    "height": "tag_height",
}
"""Numbers of a file of path losses, and the settings of method `rssi` that they replace."""


def refuse_twice(given: Mapping[str, object], names: tuple[str, ...]) -> None:
    """Raise UsageError if one of `names`, which the path-loss file states, is among the settings `given`, too."""
    if (twice := next((n for n in names if n in given), None)) is not None:
        raise UsageError(
            f"{option('path_loss')} and {option(f'set.{twice}')} state the same quantity; give one of them",
            id="conflicting-options",
        )


def path_loss_of(spec: PathLossSpec, readers: tuple[TagReader, ...]) -> PathLoss:
    """Return the path-loss model of a file's content for these readers, which it must all have."""
    power = {r.name: r.power for r in spec.readers}
    return PathLoss(
        positions=np.array([r.position for r in readers]),
        power=np.array([power[r.name] for r in readers]),
        exponent=spec.exponent,
        noise_db=spec.noise_db,
        shadow_db=spec.shadow_db,
        shadow_s=spec.shadow_s,
        height=spec.height,
        metre=metre_of(spec.length_unit),
    )


def metre_of(length_unit: str) -> float:
    """Return the length of one metre in `length_unit`; 1 for a unit that is not known."""
    return 1.0 / METRES.get(length_unit, 1.0)
