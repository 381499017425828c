"""Directions of arrival in a frame of spectra, as peaks of a spatial spectrum by pyroomacoustics.

Each direction has a standard deviation from the Cramer-Rao bound of the array (`sharpness`). Directions are unit
vectors towards the source in the array's frame. A plane wave from u reaches microphone m earlier by p_m . u / c, so
that its spectrum there has the phase omega p_m . u / c.
"""

from __future__ import annotations

import importlib
import math
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import InputError, UsageError, option
from occlog.records.scene import MicrophoneArray
from occlog.settings import METRES

from .config import ALGORITHMS, DoaConfig

FLAT = 1e-3
"""Extent across, as a share of the greatest, below which microphones are in a plane or a line."""
MIN_COHERENCE, MAX_COHERENCE = 1e-3, 0.999


def extents(microphones: Floats) -> tuple[int, Floats]:
    """Number of dimensions spanned by microphones (n, 3), 0 to 3, and the unit direction (3,) of least extent."""
    centred = microphones - microphones.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=True)
    sizes = np.pad(sizes, (0, max(0, 3 - len(sizes))))
    rank = int((sizes > FLAT * max(float(sizes[0]), 1e-300)).sum()) if sizes[0] > 0 else 0
    return rank, np.asarray(axes[2], dtype=np.float64)


def direction(azimuth: Floats, elevation: Floats) -> Floats:
    """(n, 3) unit vectors of directions with azimuths and elevations (n,) [rad]."""
    c = np.cos(elevation)
    return np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)], axis=-1)


def spectra(samples: Floats, length: int, hop: int) -> np.ndarray:
    """(M, length/2 + 1, S) Hann-windowed spectra of samples (n, M) of M channels in S windows of `length` samples.

    S = 0 for fewer samples than `length`. `hop` is the number of samples from one window to the next.
    """
    M = samples.shape[1]
    if len(samples) < length:
        return np.empty((M, length // 2 + 1, 0), dtype=np.complex128)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    cut = np.lib.stride_tricks.sliding_window_view(samples, length, axis=0)[::hop]  # (S, M, length)
    return np.asarray(np.fft.rfft(cut * window, axis=2).transpose(1, 2, 0))


def levels(X: np.ndarray, bins: np.ndarray) -> Floats:
    """(S,) mean power over microphones of the spectra X (M, F, S) in the frequency bins `bins`; 1: full-scale sine."""
    n = 2 * (X.shape[1] - 1)
    # Parseval, with the Hann window's mean square of 3/8 and the sine's of 1/2, on one side of the spectrum.
    full = n**2 * (3.0 / 8.0) * 0.5 / 2.0
    return np.asarray((np.abs(X[:, bins, :]) ** 2).sum(axis=1).mean(axis=0) / full, dtype=np.float64)


def coherence(X: np.ndarray, bins: np.ndarray, omega: Floats, microphones: Floats, u: Floats, c: float) -> float:
    """Coherence of M channels with a plane wave: 1 for a single wave, about 0 for independent noise.

    It is the mean, over pairs of microphones, bins and spectra, of the cosine of the phase residual.

    Args:
        X: (M, F, S) spectra.
        bins: (B,) frequency bins to use.
        omega: (B,) their angular frequencies [rad/s].
        microphones: (M, 3) positions in the array's frame.
        u: (3,) unit vector towards the source.
        c: speed of sound, in the unit of the positions per second.
    """
    phase = X[:, bins, :]
    size = np.abs(phase)
    phase = np.where(size > 0.0, phase / np.maximum(size, 1e-300), 0.0)
    steer = np.exp(-1j * omega[None, :] * (microphones @ u / c)[:, None])
    M = len(microphones)
    aligned = np.abs((phase * steer[:, :, None]).sum(axis=0)) ** 2
    return float((aligned.mean() - (np.abs(phase) ** 2).sum(axis=0).mean()) / (M * (M - 1)))


def sharpness(
    omega: Floats, snapshots: float, microphones: Floats, azimuth: float, elevation: float, c: float, agreement: float
) -> Floats:
    """(2, 2) Cramer-Rao bound of (azimuth, elevation) [rad^2] from phases with Gaussian errors.

    A coherence g of pairs of microphones corresponds to a phase variance of -ln g per microphone. Infinite on the
    diagonal for an angle that the array does not determine.

    Args:
        omega: (B,) angular frequencies [rad/s].
        snapshots: number of independent spectra.
        microphones: (M, 3) positions in the array's frame.
        azimuth: azimuth of the direction in the array's frame [rad].
        elevation: elevation above the array's xy plane [rad].
        c: speed of sound, in the unit of the positions per second.
        agreement: coherence g, limited to [`MIN_COHERENCE`, `MAX_COHERENCE`].
    """
    sa, ca, se, ce = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    slopes = np.array([[-sa * ce, ca * ce, 0.0], [-ca * se, -sa * se, ce]])
    centred = microphones - microphones.mean(axis=0)
    moves = centred @ slopes.T / c  # (M, 2) seconds per radian
    variance = -np.log(min(max(agreement, MIN_COHERENCE), MAX_COHERENCE))
    information = snapshots * float((omega**2).sum()) * moves.T @ moves / variance
    out = np.full((2, 2), np.inf)
    scale = np.trace(information)
    if np.linalg.det(information) > 1e-12 * scale**2:
        return np.asarray(np.linalg.inv(information), dtype=np.float64)
    informed = np.diag(information) > 1e-9 * scale
    out[informed, informed] = 1.0 / np.diag(information)[informed]
    return out


FACTOR = 1.6
"""Ratio of errors to their bound in simulated rooms, see docs/how-to/sound.md."""
FLOOR = math.radians(0.5)
"""Least standard deviation: no array is built and placed better."""
INDEPENDENT, MAX_INDEPENDENT = 1.0 / 3.0, 1.5
"""Share of spectra that are independent (windows overlap, bins are correlated), and how many a frame has at
most: reflections stay the same all through a frame."""
SHRINK = 0.1
"""A planar array measures the angle to its plane by how much slower the wave crosses it; error of that in rooms."""
POINTS_A_LOBE = 4.0
MAX_SOURCES = 10
"""Directions a frame where their number is found."""
MAX_POINTS = 200_000
"""Directions that are tried at most."""


class ArrayDirection(NamedTuple):
    """Direction of arrival towards a source in the array's frame [rad], with standard deviations [rad].

    Elevation and its standard deviation are NaN where not measured; the confidence is the coherence of the phases, 0 to
    1.
    """

    azimuth: float
    elevation: float  # NaN: not measured
    sigma_azimuth: float
    sigma_elevation: float  # NaN: not measured
    confidence: float


class Band(NamedTuple):
    """B frequency bins of a spectrum of `length` samples that are used, with their angular frequencies [rad/s].

    `rate` is the number of samples per second.
    """

    rate: int
    length: int  # of a spectrum, samples
    bins: Ints
    omega: Floats  # [rad/s]


class DirectionGrid(NamedTuple):
    """Grid of candidate directions in the array's frame: E elevations by A azimuths [rad].

    `allowed` (E, A) masks one of each pair of directions that a flat array cannot distinguish.
    """

    azimuth: Floats  # (A,) ascending, all around
    elevation: Floats  # (E,)
    allowed: Bools  # (E, A) a flat array gives one of the two directions that it cannot distinguish


class Locator(NamedTuple):
    """What the estimation of directions with one array of M microphones needs, constant over frames.

    Attributes:
        engine: algorithm of pyroomacoustics.
        microphones: (M, 3) positions of the microphones about their mean.
        normal: (3,) unit normal of a flat array; None: the array is not flat.
        band: frequencies that are used.
        grid: candidate directions.
        speed: speed of sound [length/s].
        config: settings.
    """

    engine: Any
    microphones: Floats
    normal: Floats | None
    band: Band
    grid: DirectionGrid
    speed: float
    config: DoaConfig


def library() -> ModuleType:
    """Import pyroomacoustics.doa; UsageError if it is not installed."""
    try:
        return importlib.import_module("pyroomacoustics.doa")
    except ImportError as error:
        raise UsageError(
            "occlog listen requires the package pyroomacoustics, which is not installed; pip install pyroomacoustics",
            id="missing-package",
        ) from error


def make_band(rate: int, config: DoaConfig) -> Band:
    """Select the frequency bins of the band; UsageError if it has fewer than three.

    `rate` is the number of samples per second; the spectrum's length is the next power of two to the window's.
    """
    length = 1 << max(math.ceil(math.log2(config.window_s * rate)), 3)
    frequency = np.arange(length // 2 + 1) * rate / length
    bins = np.flatnonzero((frequency >= config.low_hz) & (frequency <= config.high_hz) & (frequency > 0))
    bins = bins[bins < length // 2]
    if len(bins) < 3:
        raise UsageError(
            f"listen: the band {config.low_hz:g} to {config.high_hz:g} Hz has {len(bins)} frequencies of a recording "
            f"at {rate} Hz, and 3 are needed; give a wider {option('band')} or a longer {option('window')}",
            id="invalid-setting",
        )
    return Band(rate, length, bins, 2.0 * np.pi * frequency[bins])


def locator(array: MicrophoneArray, rate: int, unit: str, config: DoaConfig) -> Locator:
    """Prepare locating with one array.

    Args:
        array: array with its microphones.
        rate: samples per second.
        unit: unit of lengths in the scene.
        config: algorithm, band and grid.

    Raises:
        InputError: fewer than three microphones, all in one line, or spread over more than sound crosses in a window.
        UsageError: pyroomacoustics is missing, the band or the grid is unsuitable for the array, or the algorithm finds
            fewer sources than `config.max_sources`.
    """
    doa, band, speed = library(), make_band(rate, config), speed_of_sound(config, unit)
    _check_extent(array, band, speed, unit)
    rank, _ = extents(array.microphones) if len(array.microphones) else (0, np.zeros(3))
    if rank < 2:
        raise InputError(
            f"scene: array {array.name} has {len(array.microphones)} microphones"
            + (", all in one line" if len(array.microphones) > 1 else "")
            + "; an azimuth requires three that are not in a line: add `microphones`",
            id="too-few-sensors",
        )
    if config.max_sources >= len(array.microphones) and config.algorithm != "srp":
        raise UsageError(
            f"listen: {config.algorithm} finds fewer sources than microphones ({len(array.microphones)} in "
            f"{array.name}), not {config.max_sources}; give a smaller {option('max_sources')}",
            id="invalid-setting",
        )
    grid = make_grid(array, band, speed, config)
    ways = (
        {"dim": 2, "azimuth": grid.azimuth}
        if array.planar
        else {
            "dim": 3,
            "azimuth": grid.azimuth,
            "colatitude": np.pi / 2 - grid.elevation,
        }
    )
    make = getattr(doa, ALGORITHMS[config.algorithm])
    centred = array.microphones - array.microphones.mean(axis=0)
    engine = make(centred.T, rate, band.length, c=speed, num_src=max(config.max_sources, 1), **ways)
    normal = extents(array.microphones)[1] if rank == 2 else None
    return Locator(engine, centred, normal, band, grid, speed, config)


def speed_of_sound(config: DoaConfig, unit: str) -> float:
    """Speed of sound [scene units/s], of the settings or 343 m/s; UsageError if neither applies to the unit."""
    if config.speed_of_sound is not None:
        return config.speed_of_sound
    if unit not in METRES:
        raise UsageError(
            f"listen: the scene's lengths are in {unit}, which is no known unit; give {option('speed_of_sound')} in "
            "lengths of the scene per second",
            id="missing-unit",
        )
    return 343.0 / METRES[unit]


def _check_extent(array: MicrophoneArray, band: Band, speed: float, unit: str) -> None:
    """InputError if the travel time across an array exceeds the window, so that spectra are unrelated.

    `speed` is that of sound, in `unit` per second.
    """
    window = band.length / band.rate
    extent = float(np.hypot.reduce(np.ptp(array.microphones, axis=0))) if len(array.microphones) else 0.0
    if not extent <= speed * window:
        raise InputError(
            f"scene: array {array.name}: microphones spread over {extent:g} {unit}, but a window of {window:g} s "
            f"allows {speed * window:.3g} {unit} (travel time of sound); correct `microphones`, or give a longer "
            f"{option('window')}"
        )


def make_grid(array: MicrophoneArray, band: Band, speed: float, config: DoaConfig) -> DirectionGrid:
    """Create the grid of directions: a few per lobe of the array at the top of the band, 1 to 5 degrees apart.

    The settings may state the step. `speed` is that of sound, in the unit of the microphones' positions per second.
    UsageError if the grid is too large.
    """
    span = float(np.ptp(array.microphones, axis=0).max())
    lobe = np.degrees(2.0 * np.pi * speed / (float(band.omega[-1]) * span))
    step = config.grid_deg if config.grid_deg is not None else float(np.clip(lobe / POINTS_A_LOBE, 1.0, 5.0))
    A = max(round(360.0 / step), 12)
    azimuth = np.asarray(-np.pi + 2.0 * np.pi / A * np.arange(A), dtype=np.float64)
    if array.planar:
        return DirectionGrid(azimuth, np.zeros(1), np.ones((1, A), dtype=np.bool_))
    E = max(round(90.0 / step), 6)
    elevation = np.pi / 2 - (np.arange(2 * E) + 0.5) * np.pi / (2 * E)  # no pole, and the horizon in the middle
    rank, normal = extents(array.microphones)
    allowed = np.ones((2 * E, A), dtype=np.bool_)
    if rank == 2:
        normal = normal * np.sign(normal[np.argmax(np.abs(normal))])
        if abs(normal[2]) > 0.9999:
            elevation, allowed = elevation[: E + 1], allowed[: E + 1]
        a, e = np.meshgrid(azimuth, elevation)
        allowed = direction(a, e) @ normal > -1e-9
    if allowed.size > MAX_POINTS:
        raise UsageError(
            f"listen: a grid of {step:g} degrees has {allowed.size} directions, at most {MAX_POINTS} can be searched; "
            f"give a larger step: {option('grid')}",
            id="problem-too-large",
        )
    return DirectionGrid(azimuth, elevation, allowed)


def locate(at: Locator, X: np.ndarray) -> list[ArrayDirection]:
    """Directions of arrival in the array's frame, by decreasing confidence (coherence of the phases, 0 to 1).

    Peaks of the algorithm's map over the grid, refined by parabolas; those with a confidence below
    `config.min_confidence` are omitted.

    Args:
        at: algorithm, array, grid and settings.
        X: (M, F, S) complex spectra of M microphones at F frequencies in S snapshots.
    """
    config, grid = at.config, at.grid
    # Map of the algorithm over the grid (SRP-PHAT, MUSIC, ...)
    at.engine.locate_sources(X, num_src=max(config.max_sources, 1), freq_bins=at.band.bins)
    chart = np.asarray(at.engine.grid.values, dtype=np.float64).reshape(grid.allowed.shape)
    heard = []
    # Peaks, refined by parabolas; confidence is the coherence of the phases
    for row, column in peaks(chart, grid, config):
        azimuth, elevation = refined(chart, grid, row, column)
        u = direction(np.array(azimuth), np.array(elevation))
        agreement = coherence(X=X, bins=at.band.bins, omega=at.band.omega, microphones=at.microphones, u=u, c=at.speed)
        if agreement >= config.min_confidence:
            heard.append(_with_uncertainty(at, azimuth, elevation, agreement, X.shape[2]))
    return sorted(heard, key=lambda h: -h.confidence)


def _with_uncertainty(
    at: Locator, azimuth: float, elevation: float, agreement: float, snapshots: int
) -> ArrayDirection:
    """Direction with its standard deviations, from the Cramer-Rao bound with the factor `FACTOR`.

    They are at least `FLOOR`, and at most that of a uniform distribution over the circle.

    Args:
        at: array, band and grid.
        azimuth: azimuth in the array's frame [rad].
        elevation: elevation in the array's frame [rad].
        agreement: coherence of the channels with it.
        snapshots: number of spectra that it is from.
    """
    count = float(np.clip(snapshots * INDEPENDENT, 1.0, MAX_INDEPENDENT))
    flat = len(at.grid.elevation) == 1
    # Without a third dimension the elevation is taken for known.
    microphones = at.microphones * np.array([1.0, 1.0, 0.0]) if flat else at.microphones
    bound = sharpness(
        omega=at.band.omega,
        snapshots=count,
        microphones=microphones,
        azimuth=azimuth,
        elevation=elevation,
        c=at.speed,
        agreement=agreement,
    )
    spread = FACTOR**2 * np.diag(bound) + FLOOR**2
    if at.normal is not None and not flat:
        spread = spread + _off_plane(azimuth, elevation, at.normal)
    # No direction is known worse than not at all.
    sigma = np.minimum(np.sqrt(spread), np.pi / np.sqrt(3.0))
    return ArrayDirection(
        azimuth=azimuth,
        elevation=math.nan if flat else elevation,
        sigma_azimuth=float(sigma[0]),
        sigma_elevation=math.nan if flat else float(sigma[1]),
        confidence=min(max(agreement, 0.0), 1.0),
    )


def _off_plane(azimuth: float, elevation: float, normal: Floats) -> Floats:
    """(2,) variances [rad^2] of azimuth and elevation from the uncertain angle of a direction to a flat array's plane.

    The array measures that angle by the slowness of the wave across it, with the error `SHRINK`. `normal` (3,) is
    the unit normal of the plane, in the array's frame like the direction [rad].
    """
    u = direction(np.array(azimuth), np.array(elevation))
    out = float(abs(u @ normal))
    towards = normal - (normal @ u) * u
    size = float(np.linalg.norm(towards))
    if size < 1e-9:
        return np.zeros(2)
    angle = SHRINK / max(out, SHRINK)
    across = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.cross(u, across)
    level = max(math.cos(elevation), 1e-3)
    return np.array([(angle * (towards @ across) / size / level) ** 2, (angle * (towards @ up) / size) ** 2])


def peaks(chart: Floats, grid: DirectionGrid, config: DoaConfig) -> list[tuple[int, int]]:
    """Rows and columns of the highest local maxima of a map of directions, highest first.

    They are allowed by the grid, high enough (`min_peak`), separated by `min_separation_deg`, and at most as many
    as the settings state. `chart` (E, A) has the power at each elevation and azimuth of the grid.
    """
    E = len(chart)
    padded = np.pad(np.pad(chart, ((1, 1), (0, 0)), constant_values=-np.inf), ((0, 0), (1, 1)), mode="wrap")
    around = [
        padded[1 + i : 1 + i + E, 1 + j : padded.shape[1] - 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j
    ]
    top = (chart >= np.max(around, axis=0)) & grid.allowed
    middle, high = float(np.median(chart)), float(chart[grid.allowed].max())
    top &= chart >= middle + config.min_peak * (high - middle)
    rows, columns = np.nonzero(top)
    order = np.argsort(-chart[rows, columns], kind="stable")
    most = config.max_sources or MAX_SOURCES
    kept: list[tuple[int, int]] = []
    units: list[Floats] = []
    for k in order.tolist():
        u = direction(grid.azimuth[columns[k]], grid.elevation[rows[k]])
        near = math.cos(math.radians(config.min_separation_deg))
        if all(float(u @ v) <= near for v in units):
            kept.append((int(rows[k]), int(columns[k])))
            units.append(u)
        if len(kept) == most:
            break
    return kept


def refined(chart: Floats, grid: DirectionGrid, row: int, column: int) -> tuple[float, float]:
    """Azimuth (in [-pi, pi)) and elevation [rad] of a local maximum, refined by parabolas through its neighbours.

    Args:
        chart: (E, A) power at each elevation and azimuth.
        grid: directions of the grid.
        row: row of the maximum in `chart`.
        column: column of the maximum.
    """
    A = len(grid.azimuth)
    line = chart[row, [(column - 1) % A, column, (column + 1) % A]]
    azimuth = grid.azimuth[column] + _top(line) * (2.0 * np.pi / A)
    elevation = float(grid.elevation[row])
    if 0 < row < len(chart) - 1:
        elevation += _top(chart[row - 1 : row + 2, column]) * float(grid.elevation[1] - grid.elevation[0])
    return float((azimuth + np.pi) % (2.0 * np.pi) - np.pi), elevation


def _top(y: Floats) -> float:
    """Position of the maximum of a parabola through `y` (3,) at -1, 0, 1, limited to +-1/2; 0 if it has none."""
    bend = float(y[0] - 2.0 * y[1] + y[2])
    return float(np.clip(0.5 * (y[0] - y[2]) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0
