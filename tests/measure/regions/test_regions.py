from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.regions.regions import gather


def slow_cells(mask: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """The definition: for each square of the grid the times of its pixels by numpy."""
    rows, corners = [], []
    for top in range(0, mask.shape[0], side):
        for left in range(0, mask.shape[1], side):
            y, x = np.nonzero(mask[top : top + side, left : left + side])
            if len(x):
                x, y = x + left, y + top
                dx, dy = x - x.mean(), y - y.mean()
                rows.append([len(x), x.mean(), y.mean(), (dx * dx).sum(), (dx * dy).sum(), (dy * dy).sum()])
                corners.append([left, top])
    return np.array(rows).reshape(-1, 6), np.array(corners, dtype=np.int64).reshape(-1, 2)


@pytest.mark.parametrize(("height", "width", "side"), [(12, 16, 4), (13, 19, 4), (7, 5, 16), (9, 9, 1), (11, 23, 3)])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.7, 1.0])
def test_cells_are_the_moments_of_their_pixels(height: int, width: int, side: int, share: float) -> None:
    rng = np.random.default_rng(height * width)
    mask = np.where(rng.random((height, width)) < share, 255, 0).astype(np.uint8)
    cells, corners = gather(mask, side)
    want, want_corners = slow_cells(mask, side)
    np.testing.assert_array_equal(corners, want_corners)
    np.testing.assert_allclose(cells, want, atol=1e-9)


def test_all_cells_together_have_the_moments_of_all_pixels() -> None:
    rng = np.random.default_rng(5)
    mask = np.where(rng.random((40, 60)) < 0.3, 255, 0).astype(np.uint8)
    cells, _ = gather(mask, 4)
    y, x = np.nonzero(mask)
    n, cx, cy = cells[:, 0], cells[:, 1], cells[:, 2]
    assert n.sum() == len(x)
    np.testing.assert_allclose([(n @ cx) / n.sum(), (n @ cy) / n.sum()], [x.mean(), y.mean()])
    mx, my = x.mean(), y.mean()
    np.testing.assert_allclose((cells[:, 3] + n * (cx - mx) ** 2).sum(), ((x - mx) ** 2).sum())
    np.testing.assert_allclose((cells[:, 4] + n * (cx - mx) * (cy - my)).sum(), ((x - mx) * (y - my)).sum())
