"""Small tables that plug-ins are tried with: two people who walk past two cameras.

The walk that plug-ins are tried with: one target past three sensors, and possible events on its path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from occlog.array_types import NS, Floats
from occlog.plugins.interface import MetricInput, TargetScan
from occlog.records.columns import LENGTHS, ColumnTable
from occlog.records.declared.views import ViewTracks
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Bearings, Boxes, Errors, Tracks, Truth, Views

T = TypeVar("T", bound=ColumnTable)
START_NS = 1_790_000_000 * NS + 123_456_000
STEP_NS = NS // 4
N_STEPS = 30
SCENE = Scene(arrays=(MicrophoneArray("north", np.array([0.0, 40.0, 0.0]), planar=True),))


def _moments(start_ns: int) -> tuple[Any, Any]:
    """Return times [ns] and identities (3 and 8) of rows for two targets at `N_STEPS` times; (2 * N_STEPS,) each."""
    times = start_ns + STEP_NS * np.arange(N_STEPS, dtype=np.int64)
    return np.repeat(times, 2), np.tile([3, 8], N_STEPS)


def _places(target: Any, seconds: Any) -> Any:
    """Return the true positions (n, 2) [m] of rows.

    Args:
        target: (n,) identities.
        seconds: (n,) time after the start [s].
    """
    return np.column_stack([-6.0 + 0.8 * seconds + 0.1 * target, 4.0 + np.sin(seconds) - target])


def _rows(table: type[T], **values: Any) -> T:
    """Return a table of class `table` with the given columns; missing ones are NaN, 0 or empty texts."""
    count = len(values["t_ns"])
    for c in table.columns():
        if c.name not in values and not c.optional:
            absent: Any = "" if c.kind == "U" else np.nan if c.dtype.kind == "f" else 0
            shape = (count, c.width) if c.width > 0 else (count,)
            values[c.name] = np.full(shape, absent)
    return table.of(**values)


def truth(start_ns: int = START_NS, *, scale: float = 1.0, shift: tuple[float, float] = (0.0, 0.0)) -> Truth:
    """Return the true positions of two targets (identities 3 and 8) at `N_STEPS` times.

    Args:
        start_ns: first time [ns].
        scale: units of length per metre in the result.
        shift: offset of x and y [m], applied before scaling.
    """
    t_ns, target = _moments(start_ns)
    xy = scale * (_places(target, (t_ns - start_ns) / NS) + shift)
    return _rows(Truth, t_ns=t_ns, target_id=target, role=np.full(len(t_ns), "target"), x=xy[:, 0], y=xy[:, 1])


def tracks(start_ns: int = START_NS, *, scale: float = 1.0, shift: tuple[float, float] = (0.0, 0.0)) -> Tracks:
    """Return estimates of the two targets of `truth` with noise of 0.3 m; target 8 is missing at 3 of 10 times.

    Args:
        start_ns: first time [ns].
        scale: units of length per metre in the result.
        shift: offset of x and y [m], applied before scaling.
    """
    t_ns, target = _moments(start_ns)
    xy = _places(target, (t_ns - start_ns) / NS) + np.random.default_rng(1).normal(0.0, 0.3, (len(t_ns), 2)) + shift
    variance = np.full(len(t_ns), 0.09 * scale**2)
    whole = _rows(
        Tracks,
        t_ns=t_ns,
        target_id=target,
        x=scale * xy[:, 0],
        y=scale * xy[:, 1],
        vx=np.full(len(t_ns), 0.8 * scale),
        vy=np.zeros(len(t_ns)),
        cov_xx=variance,
        cov_yy=variance,
        cov_xy=np.zeros(len(t_ns)),
    )
    return whole.take((target == 3) | (np.arange(len(t_ns)) // 2 % 10 < 7))


def errors(found: Tracks, true: Truth) -> Errors:
    """Return the error (estimate minus truth) of each row of `found`, paired with `true` by time and identity.

    Every row of `found` must have a true position; otherwise KeyError is raised.
    """
    index_of = {(t, k): n for n, (t, k) in enumerate(zip(true.t_ns.tolist(), true.target_id.tolist(), strict=True))}
    pairs = zip(found.t_ns.tolist(), found.target_id.tolist(), strict=True)
    row = np.array([index_of[pair] for pair in pairs], dtype=np.int64)
    off = np.column_stack([found.x - true.x[row], found.y - true.y[row]])
    return _rows(
        Errors,
        t_ns=found.t_ns,
        target_id=found.target_id,
        x=found.x,
        y=found.y,
        truth_x=true.x[row],
        truth_y=true.y[row],
        error_x=off[:, 0],
        error_y=off[:, 1],
        error=np.hypot(*off.T),
        nees=(off**2).sum(axis=1) / found.cov_xx,
    )


def compared(
    start_ns: int = START_NS, *, scale: float = 1.0, shift: tuple[float, float] = (0.0, 0.0), unit: str = "m"
) -> MetricInput:
    """Return tracks, truth and errors of the two sample targets, as the input of a metric.

    Args:
        start_ns: first time [ns].
        scale: units of length per metre in the tables.
        shift: offset of x and y [m], applied before scaling.
        unit: name of the unit of length.
    """
    found, true = tracks(start_ns, scale=scale, shift=shift), truth(start_ns, scale=scale, shift=shift)
    return MetricInput(found, true, errors(found, true), unit)


def _bearings() -> Bearings:
    t_ns, target = _moments(START_NS)
    seen = np.arange(len(t_ns)) % 7 != 0
    angle = np.where(seen, 0.01 * np.arange(len(t_ns)) - 0.2, np.nan)
    sigma = np.where(seen, 0.02, np.nan)
    sensor = np.full(len(t_ns), "north")
    return _rows(Bearings, t_ns=t_ns, sensor=sensor, target_id=target, seen=seen, bearing=angle, sigma=sigma)


def _image_rows(table: type[T], **values: Any) -> T:
    t_ns, target = _moments(START_NS)
    number = np.tile([0, 1], N_STEPS)
    return _rows(
        table, t_ns=t_ns, sensor=np.full(len(t_ns), "cam1"), frame=np.repeat(np.arange(N_STEPS), 2), target_id=target,
        **{name: value(number, np.repeat(np.arange(N_STEPS), 2)) for name, value in values.items()},
    )  # fmt: skip


EDGES: Mapping[str, Callable[[Any, Any], Any]] = {
    "left_px": lambda number, frame: 40.0 + 200.0 * number + 3.0 * frame,
    "top_px": lambda number, frame: 100.0 + 5.0 * number + 0.5 * frame,
    "width_px": lambda number, frame: 40.0 + 0.0 * number + 0.1 * frame,
    "height_px": lambda number, frame: 110.0 + 2.0 * number + 0.2 * frame,
}


def _boxes() -> Boxes:
    return _image_rows(Boxes, box=lambda number, _: number, confidence=lambda number, _: 0.9 - 0.1 * number, **EDGES)


def _views() -> Views:
    return _image_rows(
        Views,
        cluster=lambda number, _: number,
        x_px=lambda number, frame: 60.0 + 200.0 * number + 3.0 * frame,
        y_px=lambda number, frame: 155.0 + 5.0 * number + 0.5 * frame,
        cov_xx_px=lambda number, _: 100.0 + 0.0 * number,
        cov_xy_px=lambda number, _: 0.0 * number,
        cov_yy_px=lambda number, _: 700.0 + 0.0 * number,
        area_px=lambda number, _: 4000.0 + 0.0 * number,
        **EDGES,
    )


def _view_tracks() -> ViewTracks:
    return _image_rows(
        ViewTracks,
        x_px=lambda number, frame: 60.0 + 200.0 * number + 3.0 * frame,
        y_px=lambda number, frame: 155.0 + 5.0 * number + 0.5 * frame,
        a_px=lambda number, _: 20.0 + number,
        b_px=lambda number, _: 55.0 + number,
        rho=lambda number, _: 0.1 * number,
        cov_xx_px=lambda number, _: 4.0 + 0.0 * number,
        cov_xy_px=lambda number, _: 0.0 * number,
        cov_yy_px=lambda number, _: 4.0 + 0.0 * number,
    )


SAMPLES: dict[str, Callable[[], ColumnTable]] = {
    "tracks": tracks,
    "truth": truth,
    "bearings": _bearings,
    "boxes": _boxes,
    "views": _views,
    "view_tracks": _view_tracks,
}
"""A maker of each table by its name."""


def with_gaps(rows: T) -> T:
    """Return a copy of the rows with NaN in every numeric column that allows it."""
    if isinstance(rows, Boxes):
        return rows.with_columns(confidence=np.full(len(rows), np.nan))
    unknown = [c.name for c in rows.columns() if c.nan is not None and c.dtype.kind == "f"]
    columns = {name: np.full_like(getattr(rows, name), np.nan) for name in unknown}
    if isinstance(rows, Bearings):
        columns["seen"] = np.zeros(len(rows), dtype=np.bool_)
    return rows.with_columns(**columns)


def moved(rows: T, row: int) -> T:
    """Return a copy of the rows with changed measurements in the row of index `row`: 0.01 rad, or 0.5 m or px more."""
    columns = {c.name: np.array(getattr(rows, c.name)) for c in rows.columns()}
    for c in rows.columns():
        if c.unit in ("m", "px", "rad") and not c.width:
            columns[c.name][row] += 0.01 if c.unit == "rad" else 0.5
    return type(rows).of(**columns)


def with_names(rows: T, name: str) -> T:
    """Return a copy of the rows in which every row has the sensor `name`."""
    return rows.with_columns(sensor=np.full(len(rows), name))


def in_unit(rows: T, factor: float) -> T:
    """Return a copy of the rows with lengths (and their powers) in another unit; `factor`: units per metre."""
    scaled = {c.name: getattr(rows, c.name) * factor ** LENGTHS[c.unit] for c in rows.columns() if c.unit in LENGTHS}
    return rows.with_columns(**scaled)


NAMES = ("north", "east", "west")
PLACES = np.array([[0.0, 40.0], [45.0, -5.0], [-40.0, 0.0]])  # [m]
WALK_START_NS = 1_790_000_000 * NS  # in 2026
WALK_STEP_NS = NS // 2
SIGMA_RAD = float(np.radians(1.0))
WALK_STEPS = 40


@dataclass(frozen=True)
class SampleWalk:
    """Sample walk of one target past three sensors, all of which see it at all times by default.

    Attributes:
        n_steps: number of time steps.
        start_ns: time of the first step [ns].
        sensors: indices in `NAMES` of the sensors that observe, in the order of rows.
        turn: anticlockwise rotation of the world about its origin [rad].
        shift: (2,) translation of the world after the rotation [m].
        scale: units of length per metre.
    """

    n_steps: int = WALK_STEPS
    start_ns: int = WALK_START_NS
    sensors: tuple[int, ...] = (0, 1, 2)
    turn: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0

    def at(self, xy: Floats) -> Floats:
        """Return positions (..., 2) of the plain walk in the world of this one: rotated, shifted and scaled.

        `xy`: positions [m]; the result is in this walk's unit of length.
        """
        c, s = np.cos(self.turn), np.sin(self.turn)
        return np.asarray(self.scale * (xy @ np.array([[c, s], [-s, c]]) + np.array(self.shift)))

    @property
    def truth(self) -> Floats:
        """(n_steps, 2) true positions of the target, in the walk's unit of length."""
        t = np.arange(self.n_steps) * (WALK_STEP_NS / NS)
        return self.at(np.column_stack([-10.0 + 0.5 * t, 5.0 + 2.0 * np.sin(0.3 * t)]))

    @property
    def scene(self) -> Scene:
        """Scene of the walk's three microphone arrays."""
        positions = self.at(PLACES)
        arrays = (MicrophoneArray(n, np.array([*xy, 0.0]), planar=True) for n, xy in zip(NAMES, positions, strict=True))
        return Scene(arrays=tuple(arrays), length_unit="m" if self.scale == 1.0 else "cm")

    def __iter__(self) -> Iterator[TargetScan]:
        """Generate the scan of each time step: true bearings with noise of `SIGMA_RAD`.

        The noise of a sensor does not depend on which other sensors observe.
        """
        noise = np.random.default_rng(5)
        positions, own = self.at(PLACES), list(self.sensors)
        for n, xy in enumerate(self.truth):
            away = xy - positions[own]
            error = noise.normal(0.0, SIGMA_RAD, len(NAMES))[own]
            bearing = np.arctan2(away[:, 1], away[:, 0]) + error
            yield TargetScan(
                t_ns=self.start_ns + n * WALK_STEP_NS,
                sensors=tuple(NAMES[k] for k in own),
                places=positions[own].copy(),
                bearings=(bearing + np.pi) % (2 * np.pi) - np.pi,
                sigma=np.full(len(own), SIGMA_RAD),
            )


PLAIN = SampleWalk()
FEW = replace(PLAIN, n_steps=12)


def blind(scan: TargetScan) -> TargetScan:
    """Return a copy of the scan in which all its sensors observe, but none detects the target (bearings are NaN)."""
    unknown = np.full(len(scan.bearings), np.nan)
    return scan._replace(bearings=unknown, sigma=unknown.copy())


def without_sensors(scan: TargetScan) -> TargetScan:
    """Return a copy of the scan without any sensor or bearing, as in a time step in which no sensor observes."""
    return scan._replace(sensors=(), places=np.zeros((0, 2)), bearings=np.zeros(0), sigma=np.zeros(0))


def later(scan: TargetScan, seconds: float) -> TargetScan:
    """Return a copy of the scan with a time that is later by `seconds` (earlier if negative)."""
    return scan._replace(t_ns=scan.t_ns + round(seconds * NS))
