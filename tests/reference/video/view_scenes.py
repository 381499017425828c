"""View tracks of targets that walk among calibrated cameras, made from the truth."""

import numpy as np

from occlog.records.declared.views import ViewTracks

TICK = 40_000_000


def walks(steps, targets=2):
    """(T, n, 3) places of targets that walk about in a room of 4 x 4, their middles at about 0.9."""
    t = np.arange(steps)[:, None] * 0.04
    phase = np.arange(targets) * 2.0
    return np.stack(
        [1.5 * np.cos(0.5 * t + phase), 1.2 * np.sin(0.7 * t + phase), 0.9 + 0.02 * np.sin(3 * t + phase)], 2
    )


def view_tracks(cameras, places, rng, sigma=2.0, delay_ns=0):
    """A row for each time, camera and target; camera number k speaks `k delay_ns` later.

    Args:
        cameras: with poses.
        places: (T, n, 3).
        rng: of the noise.
        sigma: its standard deviation [px], as the rows state it.
        delay_ns: between cameras.
    """
    parts = []
    steps, n = places.shape[:2]
    for k, camera in enumerate(cameras):
        rows = steps * n
        pixels = camera.project(places.reshape(-1, 3)) + rng.normal(0, sigma, (rows, 2))
        blank, one = np.full(rows, ""), np.ones(rows)
        parts.append(
            ViewTracks.of(
                t_ns=np.repeat(np.arange(steps) * TICK + k * delay_ns, n),
                sensor=np.full(rows, camera.name),
                frame=np.repeat(np.arange(steps), n),
                target_id=np.tile(np.arange(n, dtype=np.int32), steps),
                x_px=pixels[:, 0],
                y_px=pixels[:, 1],
                a_px=40 * one,
                b_px=12 * one,
                rho=-0.5 * np.pi * one,
                cov_xx_px=max(sigma, 0.1) ** 2 * one,
                cov_xy_px=0 * one,
                cov_yy_px=max(sigma, 0.1) ** 2 * one,
                similarity=one,
                ess=np.nan * one,
                likelihood_mode=np.full(rows, "bmct"),
                counterpart=blank,
                neighbours=blank,
                assisting_views=blank,
                lifecycle=blank,
            )
        )
    return ViewTracks.merge(parts)
