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
from occlog.errors import InputError, option
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
from .grouping import Scan, ScanMeasurements, nearest, sensor_names

MIN_NEGATIVE_SIGMAS = 5.0
"""Standard deviations by which noise may bring a range below 0, or a difference beyond the distance of its stations."""
STRONGEST_DBM = 20.0
"""Maximum plausible signal strength [dBm]; stronger values are refused."""
MIN_DIFFERENCES, MAX_IMPOSSIBLE_SHARE = 5, 0.5
"""Minimum number of differences for the check, and the share of them that may be beyond their stations: single ones
are false."""


class RangeDifferenceCheck:
    """Counts range differences longer than the distance of their stations, over a stream."""

    def __init__(self) -> None:
        """Start without range differences."""
        self._all = self._beyond = 0
        self._first = ""

    def add(self, table: Measurements, row: Ints, packed: RangeMeasurements) -> None:
        """Count range differences, and those that exceed the distance of their stations; see `check_plausible`.

        Args:
            table: measurements.
            row: (m,) row in the table of each packed measurement.
            packed: m of them.
        """
        differs = packed.kind == DIFFERENCE
        rise = np.sqrt(packed.rise2) + np.sqrt(packed.other_rise2)
        separation = np.hypot(*(packed.position - packed.other).T) + rise
        beyond = np.flatnonzero(differs & (np.abs(packed.value) > separation + MIN_NEGATIVE_SIGMAS * packed.sigma))
        if len(beyond) and not self._beyond:
            n = int(beyond[0])
            where = _where(table, int(row[n]))
            self._first = f"that {where} is {packed.value[n]:.4g}, and these are {separation[n]:.4g} apart"
        self._all, self._beyond = self._all + int(np.count_nonzero(differs)), self._beyond + len(beyond)

    def refuse(self) -> None:
        """InputError if there are too many of them."""
        if self._all >= MIN_DIFFERENCES and self._beyond > MAX_IMPOSSIBLE_SHARE * self._all:
            raise InputError(
                f"measurements: {self._beyond} of {self._all} differences are longer than their stations are apart: "
                f"{self._first}; check the units of times and stations, and {option('propagation_speed')}",
                id="unit-mismatch",
            )


def _where(table: Measurements, n: int) -> str:
    return f"of {str(table.sensor[n])!r} at {time_words(table.t_ns[n])}"


def check_plausible(
    table: Measurements, row: Ints, packed: RangeMeasurements, differences: RangeDifferenceCheck | None = None
) -> None:
    """InputError, with station and time, for implausible measurements.

    Args:
        table: the measurements, or a part of them that has all of each time.
        row: (m,) rows of the table that the packed measurements are of.
        packed: m measurements.
        differences: counts those of a part, for whoever has all parts to refuse them; None: this is the whole.
    """
    with np.errstate(invalid="ignore"):
        strong = np.flatnonzero(table.rssi > STRONGEST_DBM)
    if len(strong):
        raise InputError(
            f"measurements: the signal strength {_where(table, int(strong[0]))} is {table.rssi[strong[0]]:g} dBm, and "
            f"received signals are below {STRONGEST_DBM:g}; are signs missing?"
        )
    low = np.flatnonzero((packed.kind == RANGE) & (packed.value < -MIN_NEGATIVE_SIGMAS * packed.sigma))
    if len(low):
        n = int(low[0])
        raise InputError(
            f"measurements: the range {_where(table, int(row[n]))} is {packed.value[n]:g}, "
            f"{-packed.value[n] / packed.sigma[n]:.0f} standard deviations below 0; if it is a "
            "difference of ranges, name its column range_difference"
        )
    found = RangeDifferenceCheck() if differences is None else differences
    found.add(table, row, packed)
    if differences is None:
        found.refuse()
    _refuse_copies(table, row, packed)


def _refuse_copies(table: Measurements, row: Ints, packed: RangeMeasurements) -> None:
    """InputError for a duplicate range or difference, which would count twice.

    Args:
        table: measurements.
        row: (m,) row in the table of each packed measurement.
        packed: m of them.
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
    """White noise and correlated shadowing of signal strengths."""

    noise_db: float = NOISE_DB  # standard deviation of the white noise
    shadow_db: float = SHADOW_DB  # of the shadowing
    shadow_s: float = SHADOW_S  # time in which it is forgotten, > 0


LastReads = MutableMapping[tuple[str, int], int]
"""Times [ns] of the last strength by station and target."""


def sigmas(shadowing: SignalErrors, since_s: Floats) -> Floats:
    """(n,) standard deviations [dB] of reads for a filter that assumes white errors.

    Args:
        shadowing: how errors are.
        since_s: (n,) times since the last read of the same station and target [s]; inf: there was none.
    """
    share = np.maximum(since_s / (2.0 * shadowing.shadow_s), MIN_INTERVAL_SHARE / 2.0)
    return np.asarray(np.sqrt(shadowing.noise_db**2 + shadowing.shadow_db**2 / np.tanh(share)))


def with_sigmas(table: Measurements, shadowing: SignalErrors, last: LastReads | None) -> Measurements:
    """Table with a standard deviation for each strength.

    Args:
        table: in the order of time.
        shadowing: how errors are.
        last: last reads of earlier parts of the table; those of this part are put in.  None: every read counts in full.
    """
    own = np.flatnonzero(np.isfinite(table.rssi))
    if not len(own):
        return table
    since = np.full(len(own), np.inf) if last is None else _since(table, own, last)
    sigma = table.sigma_rssi.copy()
    sigma[own] = np.where(np.isfinite(sigma[own]), sigma[own], sigmas(shadowing, since))
    return replace(table, sigma_rssi=sigma)


def _since(table: Measurements, own: Ints, last: LastReads) -> Floats:
    """(n,) time since the last strength of the same station and target [s]; inf if there was none.

    Args:
        table: measurements.
        own: (n,) its rows with a strength.
        last: time of the last strength by station and target, of earlier chunks; updated.
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
    """A fitted path loss model of signal strengths."""

    power: Mapping[str, float]  # of each station, strength at 1 m [dBm]
    exponent: float
    shadowing: SignalErrors
    height: float  # of the tags


class StationModel(NamedTuple):
    """The S sensors of a scene (direction sensors first), with the parameters needed for distances."""

    names: tuple[str, ...]
    position: Floats  # (S, 3); NaN where it is not known
    power: Floats  # (S,) strength at 1 m [dBm]
    metre: float  # in units of length


def station_names(scene: Scene) -> tuple[str, ...]:
    """Names of all sensors of a scene: direction sensors in order, then readers."""
    return (*sensor_names(scene), *(r.name for r in scene.readers))


def make_stations(scene: Scene, config: DistanceMeasurementConfig, radio: Radio | None = None) -> StationModel:
    """Sensors of a scene for distance measurements.

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
    """Convert tag reads to signal strengths; reads without a strength are omitted."""
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
    """Packs distance measurements, and joins them with the scans of directions, in the order of time."""

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
            chunks: measurements in the order of time; where they are cut does not matter.
            scene: must have the stations.
            config: what the table does not say.
            radio: a fitted path loss; None: as the scene and the settings say.
            with_times: each scan stands alone, so that it does not matter how long shadowing lasts.
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
        """Generate all scans in the order of time: of directions, of measurements, or of both within the window.

        Args:
            scans: of directions.
            sensors: names of the stations to use; None: all.  A difference needs both of its stations.
            targets: to use; None: all.
            window_ns: a scan and measurements at most this far apart are one scan, of the time of the later.

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
        """Generate scans of measurements only.

        Args:
            sensors: names of those to use; None: all.
            targets: identities of those to use; None: all.
            window_ns: rows up to this much after the first are one scan [ns].
        """
        rest: Measurements | None = None
        last: LastReads | None = None if self._with_times else {}
        for chunk in self._chunks:
            if rest is not None and len(rest) and len(chunk) and chunk.t_ns[0] < rest.t_ns[-1]:
                raise InputError(
                    f"measurements: time {time_words(chunk.t_ns[0])} comes after {time_words(rest.t_ns[-1])}; "
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
        """Generate a scan for each pair of starts."""
        if starts[-1] == 0:
            return
        row, distances = pack(table.take(slice(0, starts[-1])), self._stations, self._config, self._radio)
        for first, last in pairwise(starts):
            own = (row >= first) & (row < last)
            measured = ScanMeasurements(table.target_id[row[own]], distances.take(own))
            self._passed.append((int(table.t_ns[last - 1]), measured))
            yield Scan.of(int(table.t_ns[last - 1]), [])._replace(measured=measured)

    def passed(self, until_ns: int) -> list[tuple[int, ScanMeasurements]]:
        """Times [ns] and measurements up to `until_ns`, since the last call."""
        n = sum(t_ns <= until_ns for t_ns, _ in self._passed)
        out, self._passed = self._passed[:n], self._passed[n:]
        return out


def with_strengths(
    table: Measurements, config: DistanceMeasurementConfig, radio: Radio | None, last: LastReads | None
) -> Measurements:
    """Return the table with standard deviations of all signal strengths.

    They are from `config.sigma_rssi`, or else from the shadowing of `radio`; `last` as in `with_sigmas`.
    """
    if config.sigma_rssi is not None:
        own = np.where(np.isfinite(table.rssi), _filled(table.sigma_rssi, config.sigma_rssi), table.sigma_rssi)
        return replace(table, sigma_rssi=own)
    return with_sigmas(table, SignalErrors() if radio is None else radio.shadowing, last)


def _starts(t_ns: Ints, window_ns: int) -> list[int]:
    """First rows of the scans in rising times `t_ns` (n,); the last scan may continue in the next chunk.

    A row belongs to a scan up to `window_ns` after its first; 0: if it has the same time.
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
    """Pack all measurements of a table, sorted by row; a row may have several.

    Args:
        table: in the order of time.
        at: the stations.
        config: standard deviations and other properties that the table does not state.
        radio: a fitted path loss; None: that of the scene and the settings.
        differences: counts implausible range differences, to be refused at the end; None: they are refused here.

    Returns:
        (m,) rows of the table, and the m measurements.

    Raises:
        InputError: as `DistanceMeasurementFeed.joined`.
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
    """Kind, values (n,) and standard deviations (n,) of one column for `RangeMeasurements`; NaN: not stated.

    Args:
        name: of the column.
        table: n rows.
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
    return sigma if usual is None else np.where(np.isfinite(sigma), sigma, usual)


def _numbers(names: np.ndarray, at: StationModel, column: str) -> Ints:
    """(n,) indices in `at` of the stations `names` (n,); InputError for one that is missing, or has no position.

    `column` is the name of their column, for messages.
    """
    found, inverse = np.unique(names, return_inverse=True)
    for name in found.tolist():
        if name not in at.names:
            raise InputError(
                f"measurements: no station {name!r} in the scene ({column}); {nearest(name, at.names)}",
                id="unknown-sensor",
            )
        if not np.isfinite(at.position[at.names.index(name), :2]).all():
            raise InputError(
                f"measurements: station {name!r} has no position in the scene; add it", id="unknown-sensor"
            )
    return np.array([at.names.index(name) for name in found.tolist()], dtype=np.int64)[inverse]


def _rise2(at: StationModel, station: Ints, reference: Ints, height: float | None) -> Floats:
    """(S,) squared heights of the S stations above the targets; InputError if needed and unknown.

    Args:
        at: the stations.
        station: indices of those in use.
        reference: indices of those in use as references.
        height: of the targets; None: not stated, so that all must be in the plane z = 0 (0 for all).
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
