"""Path losses by least squares, shadowing by maximum likelihood, and the range with the least error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.path_loss import NEAREST_M
from occlog.errors import option
from occlog.track.methods.readers.rssi import PathLoss, no_shadowing, predict_shadowing, update_shadowing
from occlog.track.methods.readers.virtual_sensors import locate, virtual_sensors

SEARCH = 120
"""Steps of the search for the shadowing."""
MIN_LOSS = 0.1
"""Smallest exponent: nearer to 0 strengths say nothing of distances."""


class Losses(NamedTuple):
    """Least-squares fit of signal strengths against log distance: a power for each of R readers, and one exponent."""

    power: Floats  # (R,) [dBm]
    error: Floats  # (R,) standard errors as if the noise were white; NaN of a reader without reads
    exponent: float
    exponent_error: float
    residual_db: float  # standard deviation of the residuals


class TagWindows(NamedTuple):
    """T windows of reads of one tag in one recording by R readers, with the tag's true positions."""

    t_s: Floats  # (T,) from the first window on
    xy: Floats  # (T, 2)
    reads: Ints  # (T, R)
    rssi: Floats  # (T, R) mean strengths [dBm]; NaN: none


class Coverage(NamedTuple):
    """Range of readers with the least error of virtual sensors, and the probabilities of a read at this range.

    `detection` is that of a reader in range, `stray` that of one out of range; `rms` is the position error [length].
    """

    range: float
    detection: float
    stray: float
    rms: float


def fit_losses(reader: Ints, distance_m: Floats, rssi: Floats, readers: int) -> Losses:
    """Return a power for each reader and a common path loss exponent, fitted to signal strengths by least squares.

    A reader without reads has the mean power of the others.

    Args:
        reader: (n,) numbers of the readers, 0 to R - 1.
        distance_m: (n,) distances between tag and reader [m].
        rssi: (n,) strengths [dBm].
        readers: number R of readers.

    Raises:
        ValueError: fewer reads than unknowns, or strengths that do not fall with distance.
    """
    present = np.unique(reader)
    if len(rssi) < len(present) + 3:
        raise ValueError(
            f"{len(rssi)} reads of {len(present)} readers are too few to fit path losses; at "
            f"least {len(present) + 3} are needed (number of readers + 3): give longer recordings"
        )
    design = np.zeros((len(rssi), readers + 1))
    design[np.arange(len(rssi)), reader] = 1.0
    design[:, -1] = -10.0 * np.log10(np.maximum(distance_m, NEAREST_M))
    used = np.append(present, readers)
    solution, _, rank, _ = np.linalg.lstsq(design[:, used], rssi, rcond=None)
    if rank < len(used) or not solution[-1] >= MIN_LOSS:
        raise ValueError(
            "signal strengths do not fall with the distance to the reader; check that the true "
            "positions are those of the tags"
        )
    residual = rssi - design[:, used] @ solution
    variance = float(residual @ residual) / (len(rssi) - len(used))
    spread = np.sqrt(variance * np.diag(np.linalg.inv(design[:, used].T @ design[:, used])))
    power, error = np.full(readers, float(solution[:-1].mean())), np.full(readers, np.nan)
    power[present], error[present] = solution[:-1], spread[:-1]
    return Losses(power, error, float(solution[-1]), float(spread[-1]), float(np.sqrt(variance)))


def fit_shadowing(model: PathLoss, sequences: Sequence[TagWindows]) -> PathLoss:
    """Return the path loss model with noise, shadowing and its correlation time of maximum likelihood.

    Args:
        model: model with positions, powers and exponent; its noise and shadowing are the start of the search.
        sequences: windows with true positions.
    """

    def cost(x: Floats) -> float:
        noise, shadow, forget = np.exp(x)
        tried = model._replace(noise_db=float(noise), shadow_db=float(shadow), shadow_s=float(forget))
        return -sum(_log_likelihood(tried, each) for each in sequences)

    start = np.log([model.noise_db, model.shadow_db, model.shadow_s])
    found = minimize(cost, start, method="Nelder-Mead", options={"maxiter": SEARCH, "xatol": 1e-3, "fatol": 1e-2})
    noise, shadow, forget = (float(v) for v in np.exp(found.x))
    return model._replace(noise_db=noise, shadow_db=shadow, shadow_s=forget)


def _log_likelihood(model: PathLoss, tag: TagWindows) -> float:
    """Return the log likelihood of one tag's strengths at its true positions, shadowing integrated out."""
    expected = model.expected(tag.xy)
    known, total = no_shadowing(model, 1), 0.0
    for row, t_s in enumerate(tag.t_s):
        if row:
            known = predict_shadowing(model, known, float(t_s - tag.t_s[row - 1]))
        known, part = update_shadowing(model, known, expected[row : row + 1], tag.rssi[row], tag.reads[row])
        total += float(part[0])
    return total


def choose_range(
    model: PathLoss, sequences: Sequence[TagWindows], ranges: Sequence[float], room: Floats | None
) -> Coverage:
    """Return the reading range with the least RMS error of positions by virtual sensors, of those to try.

    A virtual sensor is a region of the floor that exactly the same readers cover. A reader detects a tag with a mean
    strength of at least that expected at the range. The probabilities that it does so in range and out of it are shares
    over the windows, with one success and one failure more, so that none is 0 or 1.

    Args:
        model: path loss model of the readers.
        sequences: windows with true positions.
        ranges: ranges to try [length].
        room: (K, 2) polygon; None: no walls.

    Raises:
        ValueError: no read is as strong as expected at any of the ranges.
    """
    xy = np.concatenate([s.xy for s in sequences])
    count, rssi = np.concatenate([s.reads for s in sequences]), np.concatenate([s.rssi for s in sequences])
    positions = model.positions[:, :2]
    away = np.sqrt(((xy[:, None, :] - positions) ** 2).sum(axis=2))
    best: Coverage | None = None
    for reach in ranges:
        detected: Bools = (count > 0) & (np.where(np.isnan(rssi), np.inf, rssi) >= model.strength_at(reach))
        inside = away <= reach
        detection = _share(detected[inside])
        stray = _share(detected[~inside])
        regions = virtual_sensors(positions, np.full(len(positions), reach), room)
        kept = detected.any(axis=1)
        if not kept.any():
            continue
        found = locate(regions, detected[kept], detection, stray)
        # Windows in which no reader detects the tag have the mean of the positions in range as an estimate
        middle = regions.area @ regions.centroid / regions.area.sum()
        estimate = np.broadcast_to(middle, xy.shape).copy()
        estimate[kept] = found.xy
        rms = float(np.sqrt(((estimate - xy) ** 2).sum(axis=1).mean()))
        if best is None or rms < best.rms:
            best = Coverage(float(reach), detection, stray, rms)
    if best is None:
        raise ValueError(
            "no read is as strong as the fitted path loss expects at any of the ranges tried; "
            f"give longer {option('ranges')}"
        )
    return best


def _share(detected: Bools) -> float:
    """Return the share of True, with one success and one failure more."""
    return float((np.count_nonzero(detected) + 1) / (detected.size + 2))


def usual_ranges(positions: Floats) -> Floats:
    """Return (10,) equally spaced candidate ranges: half to twice the median nearest-neighbour distance of readers.

    `positions` (R, 2) are those of the readers. ValueError for a single one, or if they stand at one position.
    """
    if len(positions) < 2:
        raise ValueError(f"one reader alone does not determine the range; give {option('ranges')} to try")
    away = np.sqrt(((positions[:, None, :] - positions[None, :, :]) ** 2).sum(axis=2))
    np.fill_diagonal(away, np.inf)
    usual = float(np.median(away.min(axis=1)))
    if not usual > 0.0:
        raise ValueError(
            "all readers stand at one position, so no range to try follows from their distances; "
            f"give {option('ranges')}"
        )
    return usual * np.linspace(0.5, 2.0, 10)
