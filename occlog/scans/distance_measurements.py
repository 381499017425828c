"""Ranges, signal strengths and time differences: packed for the methods, and joined with the scans of directions.

A time difference becomes a difference of ranges by the speed of propagation, which must be stated. A signal strength
becomes the logarithm of a distance by the log-distance path loss. Heights of stations are used if the height of the
targets is stated; otherwise stations at different heights are refused. Implausible measurements are refused: negative
ranges, too strong signals, too long differences, duplicates. A strength has white noise and shadowing with
correlation exp(-dt / shadow_s), while filters assume white errors. The mean of many reads at intervals dt has the
variance (1 + r) / (1 - r) = coth(dt / 2 shadow_s) times that of independent ones, with r = exp(-dt / shadow_s): the
shadowing variance of a read is multiplied by this factor, dt being the time since the last read of the same target by
the same station.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, MutableMapping
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.geometry.path_loss import log_distance
from occlog.core.geometry.radio_defaults import NOISE_DB, SHADOW_DB, SHADOW_S
from occlog.errors import InputError, did_you_mean, option
from occlog.filtering.likelihood.distances import (
    DIFFERENCE,
    LOGARITHM,
    PLAIN,
    RANGE,
    RangeMeasurements,
    concat,
    no_measurements,
)
from occlog.io.files.timing.utc import time_words
from occlog.records.declared.sensors import DIFFERENCES, VALUES, Measurements
from occlog.records.scene import Scene
from occlog.records.tables import Reads
from occlog.settings import METRES

from .config import DistanceMeasurementConfig
from .grouping import Scan, ScanMeasurements, sensor_names

MIN_NEGATIVE_SIGMAS = 5.0
"""Standard deviations by which noise may bring a range below 0, or a difference beyond the distance of its stations."""
STRONGEST_DBM = 20.0
"""Maximum plausible signal strength [dBm]; stronger values are refused."""
MIN_DIFFERENCES, MAX_IMPOSSIBLE_SHARE = 5, 0.5
"""Minimum number of differences for the check, and the share of them that may be beyond their stations: single ones
are false."""


class RangeDifferenceCheck:
    """Counts range differences, and those longer than the distance of their two stations, over a stream of parts."""

    def __init__(self) -> None:
        """Start without range differences."""
        self._all = self._beyond = 0
        self._first = ""

    def add(self, table: Measurements, row: Ints, packed: RangeMeasurements) -> None:
        """Count range differences, and those that exceed the distance of their stations by more than noise explains.

        Args:
            table: measurements.
            row: (m,) row in the table of each packed measurement.
            packed: the m packed measurements.
        """
        differs = packed.kind == DIFFERENCE
        rise = np.sqrt(packed.rise2) + np.sqrt(packed.other_rise2)
        separation = np.hypot(*(packed.position - packed.other).T) + rise
        beyond = np.flatnonzero(differs & (np.abs(packed.value) > separation + MIN_NEGATIVE_SIGMAS * packed.sigma))
        if len(beyond) and not self._beyond:
            n = int(beyond[0])
            where = _where(table, int(row[n]))
            self._first = f"that {where} is {packed.value[n]:.4g}, the distance {separation[n]:.4g}"
        self._all, self._beyond = self._all + int(np.count_nonzero(differs)), self._beyond + len(beyond)

    def refuse(self) -> None:
        """Raise InputError if more than half of the range differences so far are impossible.

        Fewer than 5 are not judged.
        """
        if self._all >= MIN_DIFFERENCES and self._beyond > MAX_IMPOSSIBLE_SHARE * self._all:
            raise InputError(
                f"measurements: {self._beyond} of {self._all} range differences exceed the distance of their "
                f"stations: {self._first}; check the units of times and stations, and {option('propagation_speed')}",
                id="unit-mismatch",
            )


def _where(table: Measurements, n: int) -> str:
    """Return the station and time of row `n` as text for a message."""
    return f"of {str(table.sensor[n])!r} at {time_words(table.t_ns[n])}"


def check_plausible(
    table: Measurements, row: Ints, packed: RangeMeasurements, differences: RangeDifferenceCheck | None = None
) -> None:
    """Raise InputError, with station and time, for implausible measurements.

    These are signals stronger than `STRONGEST_DBM`, negative ranges, too many too long differences, and duplicates.

    Args:
        table: the measurements, or a part of them that has all of each time.
        row: (m,) row in the table of each packed measurement.
        packed: the m packed measurements.
        differences: counter of too long differences of all parts, which its owner refuses; None: this is the whole.
    """
    with np.errstate(invalid="ignore"):
        strong = np.flatnonzero(table.rssi > STRONGEST_DBM)
    if len(strong):
        raise InputError(
            f"measurements: the signal strength {_where(table, int(strong[0]))} is {table.rssi[strong[0]]:g} dBm, "
            f"above the limit of {STRONGEST_DBM:g} dBm; add missing minus signs"
        )
    low = np.flatnonzero((packed.kind == RANGE) & (packed.value < -MIN_NEGATIVE_SIGMAS * packed.sigma))
    if len(low):
        n = int(low[0])
        raise InputError(
            f"measurements: the range {_where(table, int(row[n]))} is {packed.value[n]:g}, "
            f"{-packed.value[n] / packed.sigma[n]:.0f} standard deviations below 0; name a column of range "
            "differences range_difference"
        )
    found = RangeDifferenceCheck() if differences is None else differences
    found.add(table, row, packed)
    if differences is None:
        found.refuse()
    _refuse_copies(table, row, packed)


def _refuse_copies(table: Measurements, row: Ints, packed: RangeMeasurements) -> None:
    """Raise InputError for a duplicate range or difference, which would count twice.

    Args:
        table: measurements.
        row: (m,) row in the table of each packed measurement.
        packed: the m packed measurements.
    """
    exact = np.flatnonzero(packed.kind != LOGARITHM)  # two of whole dBm may well be equal
    own = row[exact]
    keys = (table.t_ns[own], packed.station[exact], table.target_id[own], packed.kind[exact], packed.value[exact])
    keys = (*keys, *packed.other[exact].T)
    order = np.lexsort(keys)
    same = np.ones(max(len(order) - 1, 0), dtype=np.bool_)
    for key in keys:
        same &= key[order][1:] == key[order][:-1]
    if same.any():
        n = int(own[order][1:][same][0])
        raise InputError(
            f"measurements: a value of {str(table.sensor[n])!r} at {time_words(table.t_ns[n])} occurs twice, and "
            "would count as two measurements; remove one of the rows",
            id="duplicate-row",
        )


MIN_INTERVAL_SHARE = 1e-3
"""Shares of the time of shadowing below which no time between two reads counts."""


class SignalErrors(NamedTuple):
    """Errors of signal strengths: white noise, and shadowing that is correlated in time."""

    noise_db: float = NOISE_DB  # standard deviation of the white noise
    shadow_db: float = SHADOW_DB  # of the shadowing
    shadow_s: float = SHADOW_S  # time in which it is forgotten, > 0


LastReads = MutableMapping[tuple[str, int], int]
"""Times [ns] of the last strength by station and target."""


def sigmas(shadowing: SignalErrors, since_s: Floats) -> Floats:
    """Return (n,) standard deviations [dB] of strengths for a filter that assumes white errors.

    The shadowing is correlated in time: the sooner a read follows the last one, the less new information it has, and
    the larger is its standard deviation.

    Args:
        shadowing: noise and shadowing of the strengths.
        since_s: (n,) times since the last read of the same station and target [s]; inf: there was none.
    """
    share = np.maximum(since_s / (2.0 * shadowing.shadow_s), MIN_INTERVAL_SHARE / 2.0)
    return np.asarray(np.sqrt(shadowing.noise_db**2 + shadowing.shadow_db**2 / np.tanh(share)))


def with_sigmas(table: Measurements, shadowing: SignalErrors, last: LastReads | None) -> Measurements:
    """Return the table with a standard deviation for each signal strength that does not state its own.

    Args:
        table: measurements in the order of time.
        shadowing: noise and shadowing of the strengths.
        last: times of the last reads of earlier parts of the table, updated in place; None: every read counts as a
            first.
    """
    own = np.flatnonzero(np.isfinite(table.rssi))
    if not len(own):
        return table
    since = np.full(len(own), np.inf) if last is None else _since(table, own, last)
    sigma = table.sigma_rssi.copy()
    sigma[own] = np.where(np.isfinite(sigma[own]), sigma[own], sigmas(shadowing, since))
    return replace(table, sigma_rssi=sigma)


def _since(table: Measurements, own: Ints, last: LastReads) -> Floats:
    """Return (n,) times since the last strength of the same station and target [s]; inf if there was none.

    Args:
        table: measurements.
        own: (n,) indices of the rows with a strength.
        last: time of the last strength by station and target, of earlier parts; updated in place.
    """
    since = np.full(len(own), np.inf)
    names, station = np.unique(table.sensor[own], return_inverse=True)
    order = np.lexsort((table.t_ns[own], table.target_id[own], station))
    t_ns, key = table.t_ns[own][order], np.column_stack([station, table.target_id[own]])[order]
    fresh = np.append(True, (key[1:] != key[:-1]).any(axis=1))
    since[order[1:]] = np.where(fresh[1:], np.inf, np.diff(t_ns) / NS)
    for k in np.flatnonzero(fresh).tolist():
        earlier = last.get((str(names[key[k, 0]]), int(key[k, 1])))
        since[order[k]] = np.inf if earlier is None else (int(t_ns[k]) - earlier) / NS
    for k in np.flatnonzero(np.append(fresh[1:], True)).tolist():
        last[str(names[key[k, 0]]), int(key[k, 1])] = int(t_ns[k])
    return since


WORDS = {"range": "range", "rssi": "signal strength", "tdoa": "time difference", "range_difference": "difference"}


class Radio(NamedTuple):
    """A fitted path loss model of signal strengths: power of each station, exponent, errors, height of tags."""

    power: Mapping[str, float]  # of each station, strength at 1 m [dBm]
    exponent: float
    shadowing: SignalErrors
    height: float  # of the tags


class StationModel(NamedTuple):
    """The S sensors of a scene as stations: names, positions, powers, and the length of one metre."""

    names: tuple[str, ...]
    position: Floats  # (S, 3); NaN where it is not known
    power: Floats  # (S,) strength at 1 m [dBm]
    metre: float  # in units of length


def station_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of all sensors of a scene: cameras, microphone arrays, then readers."""
    return (*sensor_names(scene), *(r.name for r in scene.readers))


def make_stations(scene: Scene, config: DistanceMeasurementConfig, radio: Radio | None = None) -> StationModel:
    """Return the sensors of a scene as stations for distance measurements.

    The powers of a fitted `radio` have priority over those in the scene, and these over `config.rssi_power`.
    """
    unknown = np.full(3, math.nan)
    positions = [c.position if c.placed else unknown for c in scene.cameras] + [a.position for a in scene.arrays]
    positions += [r.position for r in scene.readers]
    names = station_names(scene)
    own = {r.name: r.power for r in scene.readers if r.power is not None} | ({} if radio is None else dict(radio.power))
    power = np.array([own.get(name, config.rssi_power) for name in names])
    metre = 1.0 / METRES.get(scene.length_unit, 1.0)
    return StationModel(names, np.array(positions, dtype=np.float64).reshape(-1, 3), power, metre)


def measurements_of_reads(chunks: Iterable[Reads]) -> Iterator[Measurements]:
    """Generate tag reads as measurements of signal strength, chunk by chunk; reads without a strength are omitted."""
    for chunk in chunks:
        measured = chunk.take(np.isfinite(chunk.rssi))
        nan = np.full(len(measured), np.nan)
        yield Measurements.of(
            t_ns=measured.t_ns,
            sensor=measured.sensor,
            target_id=measured.target_id,
            range=nan,
            sigma_range=nan,
            rssi=measured.rssi,
            sigma_rssi=nan,
        )


class DistanceMeasurementFeed:
    """Stream of distance measurements, packed and joined with the scans of directions, in the order of time.

    `names` are the stations; `RangeMeasurements.station` is an index into them.
    """

    def __init__(
        self,
        chunks: Iterable[Measurements],
        scene: Scene,
        config: DistanceMeasurementConfig,
        radio: Radio | None = None,
        *,
        with_times: bool = False,
    ) -> None:
        """Start before the first chunk.

        Args:
            chunks: measurements in the order of time; their division does not matter.
            scene: must have the stations.
            config: what the table does not state.
            radio: a fitted path loss; None: that of the scene and the settings.
            with_times: the method models errors in time, so that every read has the full standard deviation of a single
                one.
        """
        self._with_times = with_times
        self._chunks, self._config, self._radio = chunks, config, radio
        self._stations = make_stations(scene, config, radio)
        self.names = self._stations.names
        """Names of the stations, as `RangeMeasurements.station` counts them."""
        self._passed: list[tuple[int, ScanMeasurements]] = []

    def joined(
        self,
        scans: Iterator[Scan],
        sensors: Collection[str] | None = None,
        targets: Collection[int] | None = None,
        window_ns: int = 0,
    ) -> Iterator[Scan]:
        """Generate all scans in the order of time: of directions, of distances, or of both if within the window.

        Args:
            scans: scans of directions.
            sensors: names of the stations to use; None: all. A difference needs both of its stations.
            targets: identities of the targets to use; None: all.
            window_ns: a scan and measurements at most this far apart [ns] are one scan, of the time of the later.

        Raises:
            InputError: a station is not in the scene or has no position there, a value lacks its standard deviation or
                what else it needs, or times go back.
        """
        own = self._scans(sensors, targets, window_ns)
        one, other = next(scans, None), next(own, None)
        while one is not None or other is not None:
            if one is not None and other is not None and abs(one.t_ns - other.t_ns) <= window_ns:
                yield one._replace(t_ns=max(one.t_ns, other.t_ns), measured=other.measured)
                one, other = next(scans, None), next(own, None)
            elif other is None or (one is not None and one.t_ns < other.t_ns):
                assert one is not None
                yield one
                one = next(scans, None)
            else:
                yield other
                other = next(own, None)

    def _scans(
        self, sensors: Collection[str] | None, targets: Collection[int] | None, window_ns: int
    ) -> Iterator[Scan]:
        """Generate scans of distance measurements only.

        Args:
            sensors: names of the stations to use; None: all.
            targets: identities of the targets to use; None: all.
            window_ns: rows up to this much after the first are one scan [ns].
        """
        rest: Measurements | None = None
        last: LastReads | None = None if self._with_times else {}
        for chunk in self._chunks:
            if rest is not None and len(rest) and len(chunk) and chunk.t_ns[0] < rest.t_ns[-1]:
                raise InputError(
                    f"measurements: time {time_words(chunk.t_ns[0])} is earlier than the preceding "
                    f"{time_words(rest.t_ns[-1])}; "
                    "sort by t_ns",
                    id="unsorted-times",
                )
            keep = np.ones(len(chunk), dtype=np.bool_)
            if sensors is not None:
                # Names that the scene does not have are refused later; a difference is of two stations
                left_out = [name for name in self.names if name not in sensors]
                keep &= ~np.isin(chunk.sensor, left_out) & ~np.isin(chunk.reference, left_out)
            if targets is not None:
                keep &= np.isin(chunk.target_id, list(targets))
            some = with_strengths(chunk.take(keep), self._config, self._radio, last)
            table = some if rest is None else Measurements.concat([rest, some])
            if not len(table):
                continue
            starts = _starts(table.t_ns, window_ns)
            yield from self._packed(table, starts)
            # The last scan may go on in the next chunk.
            rest = table.take(slice(starts[-1], None))
        if rest is not None and len(rest):
            yield from self._packed(rest, [0, len(rest)])

    def _packed(self, table: Measurements, starts: list[int]) -> Iterator[Scan]:
        """Generate a scan of the rows between each two consecutive `starts`, at the time of its last row.

        The scans are also stored for `passed`.
        """
        if starts[-1] == 0:
            return
        row, distances = pack(table.take(slice(0, starts[-1])), self._stations, self._config, self._radio)
        for first, last in pairwise(starts):
            own = (row >= first) & (row < last)
            measured = ScanMeasurements(table.target_id[row[own]], distances.take(own))
            self._passed.append((int(table.t_ns[last - 1]), measured))
            yield Scan.of(int(table.t_ns[last - 1]), [])._replace(measured=measured)

    def passed(self, until_ns: int) -> list[tuple[int, ScanMeasurements]]:
        """Return times [ns] and measurements of the scans up to `until_ns` that no earlier call has returned."""
        n = sum(t_ns <= until_ns for t_ns, _ in self._passed)
        out, self._passed = self._passed[:n], self._passed[n:]
        return out


def with_strengths(
    table: Measurements, config: DistanceMeasurementConfig, radio: Radio | None, last: LastReads | None
) -> Measurements:
    """Return the table with standard deviations of all signal strengths that do not state their own.

    Args:
        table: measurements in the order of time.
        config: settings; `sigma_rssi` is used if set.
        radio: fitted path loss with noise and shadowing; None: the defaults.
        last: times of the last reads of earlier parts, updated in place; None: every read counts as a first.
    """
    if config.sigma_rssi is not None:
        own = np.where(np.isfinite(table.rssi), _filled(table.sigma_rssi, config.sigma_rssi), table.sigma_rssi)
        return replace(table, sigma_rssi=own)
    return with_sigmas(table, SignalErrors() if radio is None else radio.shadowing, last)


def _starts(t_ns: Ints, window_ns: int) -> list[int]:
    """Return the first rows of the scans in nondecreasing times `t_ns` (n,); the last scan may go on in the next chunk.

    A row belongs to a scan up to `window_ns` after its first row; 0: if it has the same time.
    """
    if window_ns == 0:
        return [0, *(np.flatnonzero(np.diff(t_ns)) + 1).tolist()]
    starts = [0]
    for row, t in enumerate(t_ns.tolist()):
        if t - t_ns[starts[-1]] > window_ns:
            starts.append(row)
    return starts


def pack(
    table: Measurements,
    at: StationModel,
    config: DistanceMeasurementConfig,
    radio: Radio | None = None,
    differences: RangeDifferenceCheck | None = None,
) -> tuple[Ints, RangeMeasurements]:
    """Return the measurements of a table in the form of the likelihood, sorted by row; a row may have several.

    Args:
        table: measurements in the order of time.
        at: the stations.
        config: standard deviations and other properties that the table does not state.
        radio: a fitted path loss; None: that of the scene and the settings.
        differences: counter of too long range differences, which its owner refuses; None: they are refused here.

    Returns:
        (m,) rows of the table, and the m measurements.

    Raises:
        InputError: a station is not in the scene or has no position, a value lacks its standard deviation or what else
            it needs, or is implausible.
    """
    table = with_strengths(table, config, radio, {})
    station = _numbers(table.sensor, at, "sensor")
    differs = np.isfinite(table.tdoa) | np.isfinite(table.range_difference)
    reference = station.copy()
    reference[differs] = _numbers(table.reference[differs], at, "reference")
    height = config.tag_height if config.tag_height is not None or radio is None else radio.height
    rise2 = _rise2(at, station, reference, height)
    how = (
        config.measured_loss_threshold,
        config.nlos_probability,
        math.nan if config.nlos_bias is None else config.nlos_bias,
    )
    parts, rows = [no_measurements(*how)], [np.empty(0, dtype=np.int64)]
    for name in (*VALUES, *PLAIN):
        own = np.flatnonzero(np.isfinite(getattr(table, name)))
        if not len(own):
            continue
        kind, value, sigma = _as_length(name, table.take(own), at, station[own], config, radio)
        if (silent := ~np.isfinite(sigma)).any():
            usual = "sigma_range" if name == "range" else "sigma_range_difference"
            remedy = "" if name in PLAIN else f", or give {option(usual)}"
            raise InputError(
                f"measurements: the {WORDS.get(name, name)} of {str(table.sensor[own][silent][0])!r} at "
                f"{time_words(table.t_ns[own][silent][0])} has no standard deviation; give a column "
                f"sigma_{name}{remedy}",
                id="missing-column",
            )
        other = reference[own] if name in DIFFERENCES else station[own]
        parts.append(
            RangeMeasurements(
                bias=config.range_bias,
                kind=np.full(len(own), kind, dtype=np.int64),
                value=value,
                sigma=sigma,
                position=at.position[station[own], :2],
                rise2=rise2[station[own]],
                other=at.position[other, :2],
                other_rise2=rise2[other],
                station=station[own],
                bend=how[0],
                late=how[1],
                detour=how[2],
            )
        )
        rows.append(own)
    row = np.concatenate(rows)
    order = np.argsort(row, kind="stable")
    packed = concat(parts).take(order)
    check_plausible(table, row[order], packed, differences)
    return row[order], packed


def _as_length(
    name: str,
    table: Measurements,
    at: StationModel,
    station: Ints,
    config: DistanceMeasurementConfig,
    radio: Radio | None,
) -> tuple[int, Floats, Floats]:
    """Return kind, values (n,) and standard deviations (n,) of one column for `RangeMeasurements`; NaN: not stated.

    Times become lengths by the speed of propagation, strengths logarithms of lengths by the path loss. InputError for
    times without that speed.

    Args:
        name: name of the column.
        table: n rows with a value in it.
        at: all stations.
        station: (n,) index of each row's station.
        config: speed of propagation, default standard deviations and the path loss.
        radio: fitted path loss; None: that of `config`.
    """
    value: Floats = getattr(table, name)
    sigma: Floats = getattr(table, f"sigma_{name}")
    if name in PLAIN:
        return PLAIN[name], value, sigma
    if name == "range":
        return RANGE, value, _filled(sigma, config.sigma_range)
    if name == "range_difference":
        return DIFFERENCE, value, _filled(sigma, config.sigma_range_difference)
    if name == "tdoa":
        if config.speed is None:
            raise InputError(
                "measurements: time differences in seconds require the speed of propagation: give "
                f"{option('propagation_speed')} sound, light or metres per second",
                id="missing-unit",
            )
        speed = config.speed * at.metre
        return DIFFERENCE, value * speed, _filled(sigma * speed, config.sigma_range_difference)
    exponent = config.rssi_exponent if radio is None else radio.exponent
    value, sigma = log_distance(value, sigma, at.power[station], exponent)
    return LOGARITHM, value + math.log(at.metre), sigma


def _filled(sigma: Floats, usual: float | None) -> Floats:
    """Return standard deviations with `usual` in place of those not stated (NaN); unchanged if it is None."""
    return sigma if usual is None else np.where(np.isfinite(sigma), sigma, usual)


def _numbers(names: np.ndarray, at: StationModel, column: str) -> Ints:
    """Return (n,) indices in `at` of the stations `names` (n,); InputError for one that is missing, or has no position.

    `column` is the name of their column, for messages.
    """
    found, inverse = np.unique(names, return_inverse=True)
    for name in found.tolist():
        if name not in at.names:
            raise InputError(
                f"measurements: no station {name!r} (column {column}) in the scene; "
                f"{did_you_mean(name, at.names, 'it has')}",
                id="unknown-sensor",
            )
        if not np.isfinite(at.position[at.names.index(name), :2]).all():
            raise InputError(
                f"measurements: station {name!r} has no position in the scene; add its position", id="unknown-sensor"
            )
    return np.array([at.names.index(name) for name in found.tolist()], dtype=np.int64)[inverse]


def _rise2(at: StationModel, station: Ints, reference: Ints, height: float | None) -> Floats:
    """Return (S,) squared heights of the stations over the targets; InputError if needed and unknown.

    Args:
        at: the S stations.
        station: indices of the stations in use.
        reference: indices of the stations in use as references.
        height: height of the targets; None: not stated, so that all stations in use must have z = 0 (0 for all).
    """
    used: Bools = np.isin(np.arange(len(at.names)), np.concatenate([station, reference]))
    z = np.where(used, at.position[:, 2], 0.0)
    if height is None:
        if (used.any() and np.ptp(z[used]) > 0.0) or (z[used] != 0.0).any():
            raise InputError(
                "measurements: stations have heights (z), so that distances are in space; state the height of the "
                f"targets: {option('tag_height')}",
                id="missing-value",
            )
        return np.zeros(len(z))
    return np.asarray((z - height) ** 2)
