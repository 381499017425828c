"""Spectra of a microphone array's signals, coherence with a plane wave, and the bound of a direction's error.

Directions are unit vectors towards the source in the array's frame.  A plane wave from u
reaches microphone m earlier by p_m . u / c, so that its spectrum there has the phase
omega p_m . u / c.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

FLAT = 1e-3
"""Extent across, as a share of the greatest, below which microphones are in a plane or a line."""
LEAST_COHERENCE, MOST_COHERENCE = 1e-3, 0.999


def extents(microphones: Floats) -> tuple[int, Floats]:
    """Number of dimensions in which microphones (n, 3) spread, and the direction (3,) in which they spread least."""
    centred = microphones - microphones.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=True)
    sizes = np.pad(sizes, (0, max(0, 3 - len(sizes))))
    rank = int((sizes > FLAT * max(float(sizes[0]), 1e-300)).sum()) if sizes[0] > 0 else 0
    return rank, np.asarray(axes[2], dtype=np.float64)


def direction(azimuth: Floats, elevation: Floats) -> Floats:
    """(n, 3) unit vectors."""
    c = np.cos(elevation)
    return np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)], axis=-1)


def spectra(samples: Floats, length: int, hop: int) -> np.ndarray:
    """(M, length/2 + 1, S) Hann-windowed spectra of (n, M) samples; S is 0 for fewer samples than `length`."""
    M = samples.shape[1]
    if len(samples) < length:
        return np.empty((M, length // 2 + 1, 0), dtype=np.complex128)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    cut = np.lib.stride_tricks.sliding_window_view(samples, length, axis=0)[::hop]  # (S, M, length)
    return np.asarray(np.fft.rfft(cut * window, axis=2).transpose(1, 2, 0))


def levels(X: np.ndarray, bins: np.ndarray) -> Floats:
    """(S,) power of each of `spectra` in some bins, mean over microphones; 1 of a full-scale sine in them."""
    n = 2 * (X.shape[1] - 1)
    # Parseval, with the Hann window's mean square of 3/8 and the sine's of 1/2, on one side of the spectrum.
    full = n**2 * (3.0 / 8.0) * 0.5 / 2.0
    return np.asarray((np.abs(X[:, bins, :]) ** 2).sum(axis=1).mean(axis=0) / full, dtype=np.float64)


def coherence(X: np.ndarray, bins: np.ndarray, omega: Floats, microphones: Floats, u: Floats, c: float) -> float:
    """How well phases agree with a plane wave: 1 of one wave, about 0 of independent noise.

    Mean over pairs of microphones, bins and spectra of the cosine of the phase that is left.

    Args:
        X: (M, F, S) spectra.
        bins: (B,) bins to use.
        omega: (B,) their angular frequencies [rad/s].
        microphones: (M, 3).
        u: (3,) direction.
        c: speed of sound.
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

    A coherence g of pairs is a phase variance of -ln g a microphone.  Infinite where an angle is not told.

    Args:
        omega: (B,) angular frequencies [rad/s].
        snapshots: number of independent spectra.
        microphones: (M, 3).
        azimuth: of the direction [rad], array frame.
        elevation: above the array's xy plane [rad].
        c: speed of sound.
        agreement: coherence, see above.
    """
    sa, ca, se, ce = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    slopes = np.array([[-sa * ce, ca * ce, 0.0], [-ca * se, -sa * se, ce]])
    centred = microphones - microphones.mean(axis=0)
    moves = centred @ slopes.T / c  # (M, 2) seconds per radian
    variance = -np.log(min(max(agreement, LEAST_COHERENCE), MOST_COHERENCE))
    information = snapshots * float((omega**2).sum()) * moves.T @ moves / variance
    out = np.full((2, 2), np.inf)
    scale = np.trace(information)
    if np.linalg.det(information) > 1e-12 * scale**2:
        return np.asarray(np.linalg.inv(information), dtype=np.float64)
    told = np.diag(information) > 1e-9 * scale
    out[told, told] = 1.0 / np.diag(information)[told]
    return out
