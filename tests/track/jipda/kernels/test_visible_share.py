"""What covers whom: against people drawn at random from where they may be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from occlog.core.plane import inside_polygon
from occlog.records.scene import Camera, camera_rotation
from occlog.track.methods.jipda.kernels.body_box import pack_views
from occlog.track.methods.jipda.kernels.visibility import (
    COLUMNS,
    ROWS,
    cells_unoccluded_by,
    centre_deviation,
    in_view,
    inside_image,
    normal_cdf,
    occlude_by_static,
    visibility,
    visible_feet,
)

BOXES = np.array([[100.0, 100.0, 160.0, 280.0], [130.0, 120.0, 200.0, 330.0]])


def clear(existence: float = 1.0, nearer: float = 2.0, spread: float = 12.0) -> np.ndarray:
    """Cells of person 0, with person 1 nearer by so much."""
    cells = np.ones((ROWS, COLUMNS))
    depth = np.array([10.0, 10.0 - nearer])
    cells_unoccluded_by(
        0, BOXES, depth, np.array([5.0, spread]), np.array([0.3, 0.4]), np.array([1.0, existence]), cells
    )
    return cells


@pytest.mark.parametrize(("existence", "nearer"), [(1.0, 2.0), (0.6, 2.0), (1.0, 0.3), (1.0, -0.4)])
def test_cells_are_as_clear_as_people_drawn_at_random_leave_them(existence: float, nearer: float) -> None:
    rng, n = np.random.default_rng(0), 200_000
    shift = rng.normal(0.0, np.hypot(5.0, 12.0), n)
    before = (rng.random(n) < existence) & (rng.normal(nearer, 0.5, n) > 0.0)
    cells = clear(existence, nearer)
    for row in range(ROWS):
        v = 100.0 + 180.0 * (row + 0.5) / ROWS
        for column in range(COLUMNS):
            u = 100.0 + 60.0 * (column + 0.5) / COLUMNS
            held = before & (130.0 + shift < u) & (u < 200.0 + shift) & (120.0 < v < 330.0)
            assert cells[row, column] == pytest.approx(1.0 - held.mean(), abs=0.005)


def test_no_one_covers_those_who_are_clearly_nearer() -> None:
    assert clear(nearer=-5.0).min() == 1.0


def test_several_cover_independently() -> None:
    boxes = np.vstack([BOXES[0], BOXES[1], BOXES[1]])
    cells = np.ones((ROWS, COLUMNS))
    cells_unoccluded_by(0, boxes, np.array([10.0, 8.0, 8.0]), np.array([5.0, 12.0, 12.0]), np.array([0.3, 0.4, 0.4]),
                np.array([1.0, 0.6, 0.6]), cells)  # fmt: skip
    np.testing.assert_allclose(cells, clear(0.6) ** 2, atol=1e-12)


def test_somebody_behind_the_camera_covers_no_one() -> None:
    cells = np.ones((ROWS, COLUMNS))
    cells_unoccluded_by(0, BOXES, np.array([10.0, -1.0]), np.ones(2), np.ones(2), np.ones(2), cells)
    assert cells.min() == 1.0


def test_the_share_inside_the_image_counts_cells() -> None:
    cells = np.empty((ROWS, COLUMNS))
    assert inside_image(np.array([-50.0, 10.0, 50.0, 100.0]), 640.0, 480.0, cells) == pytest.approx(
        3 / COLUMNS, abs=0.21
    )
    assert inside_image(np.array([10.0, 10.0, 50.0, 100.0]), 640.0, 480.0, cells) == 1.0
    assert inside_image(np.array([700.0, 10.0, 750.0, 100.0]), 640.0, 480.0, cells) == 0.0


def test_a_cell_is_in_the_image_if_its_middle_is_on_a_pixel() -> None:
    """Pixels reach from -0.5 to the size - 0.5; cells of a box that is as wide as 5 and as high as 6."""
    cells = np.empty((ROWS, COLUMNS))
    for shift in ((0.0, 0.0), (-2.0, 3.0), (637.0, 476.0), (-1.0, -1.0), (636.0, 475.0)):
        box = np.array([-1.0, -1.0, 4.0, 5.0]) + np.tile(shift, 2)
        u, v = shift[0] - 0.5 + np.arange(COLUMNS), shift[1] - 0.5 + np.arange(ROWS)
        wanted = np.outer((v >= -0.5) & (v <= 479.5), (u >= -0.5) & (u <= 639.5))
        assert inside_image(box, 640.0, 480.0, cells) == wanted.mean()
        np.testing.assert_array_equal(cells, wanted)


def test_a_person_is_in_view_up_to_the_range() -> None:
    camera = Camera("a", np.array([1.0, 2.0, 2.5]), camera_rotation(0.0, 0.0, 0.0), np.ones(2), np.zeros(2), (640, 480))
    views, cells = pack_views([camera])._replace(range=np.array([5.0])), np.empty((ROWS, COLUMNS))
    inside, outside = np.array([10.0, 10.0, 50.0, 90.0]), np.array([700.0, 10.0, 750.0, 100.0])
    assert in_view(views, 0, 4.0, 6.0, inside, cells)
    assert in_view(views, 0, -2.0, -2.0, inside, cells)
    assert not in_view(views, 0, 4.0, 6.0 + 1e-9, inside, cells)
    assert not in_view(views, 0, 4.0, 6.0, outside, cells)


def test_visibility_is_the_mean_of_cells_that_border_occluders_and_people_leave() -> None:
    camera = Camera("a", np.array([0.0, 0.0, 2.5]), camera_rotation(0.0, 0.0, 0.0), np.ones(2), np.zeros(2), (150, 400))
    state, cells = np.array([4.0, 0.2, 0.0, 0.0, 1.8, 0.6]), np.empty((ROWS, COLUMNS))
    args = BOXES, np.array([10.0, 8.0]), np.array([5.0, 12.0]), np.array([0.3, 0.4]), np.array([1.0, 0.6])
    got = visibility(pack_views([camera], [(PILLAR, 2.0)]), 0, state, 0, *args, cells)
    border = np.where(100.0 + 60.0 * (np.arange(COLUMNS) + 0.5) / COLUMNS <= 149.5, 1.0, 0.0)
    np.testing.assert_allclose(cells, border * behind((4.0, 0.2), 2.0) * clear(0.6))
    assert got == pytest.approx(cells.mean())
    assert visible_feet(cells) == pytest.approx(cells[-1].mean())


def test_the_deviation_of_a_centre_is_that_of_the_mean_of_left_and_right() -> None:
    half = np.random.default_rng(0).normal(size=(4, 4))
    spread, mean = half @ half.T, np.array([0.5, 0.0, 0.5, 0.0])
    assert centre_deviation(spread) == pytest.approx(np.sqrt(mean @ spread @ mean))
    assert centre_deviation(-np.eye(4) * 1e-20) == 0.0


def test_the_distribution_function_is_the_normal_one() -> None:
    assert normal_cdf(0.0) == pytest.approx(0.5)
    assert normal_cdf(1.0) == pytest.approx(0.841344746, abs=1e-9)
    for z, low, high in ((6.01, 0.0, 1.0), (5.99, norm.cdf(-5.99), norm.cdf(5.99))):
        assert normal_cdf(-z) == pytest.approx(low, rel=1e-6)
        assert normal_cdf(z) == pytest.approx(high, abs=1e-17)


PILLAR = np.array([[1.8, -0.35], [2.2, -0.3], [2.25, 0.2], [1.85, 0.25]])


def behind(position: tuple[float, float], top: float, polygon: np.ndarray = PILLAR) -> np.ndarray:
    """Cells of a person, 1.8 m and 0.6 m, that a camera at the origin, 2.5 m high, sees past an occluder."""
    camera = Camera("a", np.array([0.0, 0.0, 2.5]), camera_rotation(0.0, 0.0, 0.0), np.ones(2), np.zeros(2), (9, 9))
    cells = np.ones((ROWS, COLUMNS))
    occlude_by_static(pack_views([camera], [(polygon, top)]), 0, *position, 1.8, 0.6, cells)
    return cells


@pytest.mark.parametrize("position", [(4.0, 0.0), (4.0, 0.4), (5.0, -0.9), (3.0, 0.3), (1.5, 0.0), (-4.0, 0.0)])
@pytest.mark.parametrize("top", [1.2, 2.0, np.inf])
def test_a_static_occluder_hides_what_points_on_the_sight_lines_meet(position: tuple[float, float], top: float) -> None:
    cells, along = behind(position, top), np.linspace(0.0, 1.0, 4001)[:, None]
    away = np.hypot(*position)
    right = np.array([position[1], -position[0]]) / away
    for column in range(COLUMNS):
        foot = np.array(position) + 0.6 * ((column + 0.5) / COLUMNS - 0.5) * right
        inside = inside_polygon(along * foot, PILLAR)
        for row in range(ROWS):
            rise = 2.5 + along[:, 0] * (1.8 * (1.0 - (row + 0.5) / ROWS) - 2.5)
            met = (inside & (rise < top)).any()
            assert cells[row, column] == (0.0 if met else 1.0)


@pytest.mark.parametrize(("chance", "hidden"), [(0.9e-3, False), (1.1e-3, True)])
def test_who_is_nearer_or_across_with_less_than_a_thousandth_hides_nothing(chance: float, hidden: bool) -> None:
    cells, depth = np.ones((ROWS, COLUMNS)), np.array([10.0, 5.0])
    cells_unoccluded_by(
        0, BOXES[[0, 0]], depth, np.full(2, 1e-6), np.full(2, 0.1), np.array([1.0, chance]), cells
    )  # fmt: skip
    assert (cells < 1.0).any() == hidden
    # The right edge of the other is left of the middle of the first column by as many deviations
    cells, boxes = np.ones((ROWS, COLUMNS)), BOXES[[0, 0]] + [[0.0] * 4, [-54.0 + 5.0 * norm.ppf(chance), 0.0] * 2]
    cells_unoccluded_by(0, boxes, depth, np.array([3.0, 4.0]), np.full(2, 0.1), np.ones(2), cells)
    assert (cells < 1.0).any() == hidden


def test_who_ends_at_the_middle_of_a_row_does_not_hide_it() -> None:
    """Rows of a box of 60 px have their middles at 5, 15, .. 55 px; the positions in the image are certain."""
    boxes = np.array([[0.0, 0.0, 50.0, 60.0], [12.0, 15.0, 99.0, 35.0]])
    cells, wanted = np.ones((ROWS, COLUMNS)), np.ones((ROWS, COLUMNS))
    cells_unoccluded_by(0, boxes, np.array([10.0, 5.0]), np.zeros(2), np.full(2, 0.1), np.ones(2), cells)
    wanted[2, 1:] = 0.0
    np.testing.assert_array_equal(cells, wanted)


def test_a_static_occluder_hides_what_stands_in_it_and_ends_where_it_is_lower_than_the_line_of_sight() -> None:
    """At (3, 0) the middle column's lines of sight fall from 2.5 m; a wall of 0.2 m, from 1 m to 2 m away."""
    wall = np.array([[1.0, -1.0], [2.0, -1.0], [2.0, 1.0], [1.0, 1.0]])
    heights = 1.8 * (1.0 - (np.arange(ROWS) + 0.5) / ROWS)
    lowest = 2.5 + (heights - 2.5) * 2.0 / 3.0
    for row in range(ROWS):
        for top, seen in ((lowest[row] - 1e-6, 1.0), (lowest[row] + 1e-6, 0.0)):
            assert behind((3.0, 0.0), top, wall)[row, 2] == seen
    # Who stands in it is hidden up to its top
    np.testing.assert_array_equal(behind((1.5, 0.0), 1.0, wall)[:, 2], heights > 1.0)


def test_each_static_occluder_hides_with_its_own_corners_and_height() -> None:
    camera = Camera("a", np.array([0.0, 0.0, 2.5]), camera_rotation(0.0, 0.0, 0.0), np.ones(2), np.zeros(2), (9, 9))
    others = [(PILLAR - [0.0, -0.5], 1.2), (PILLAR[:3], 2.0), (PILLAR - [0.0, 0.4], 1.0)]
    cells = np.ones((ROWS, COLUMNS))
    occlude_by_static(pack_views([camera], others), 0, 4.0, 0.3, 1.8, 0.6, cells)
    alone = [behind((4.0, 0.3), top, polygon) for polygon, top in others]
    np.testing.assert_array_equal(cells, np.prod(alone, axis=0))
    assert len({one.tobytes() for one in (*alone, cells)}) == 4


@pytest.mark.parametrize("turn", range(4))
def test_an_occluder_around_the_camera_hides_nothing_and_one_around_the_person_all(turn: int) -> None:
    """With corners beside the camera and beside the person, at exactly their coordinates."""
    around = np.roll([[1.0, 0.0], [0.0, 1.0], [-1.5, 0.0], [0.0, -2.0]], turn, axis=0)
    assert behind((4.0, 0.0), np.inf, around).min() == 1.0
    np.testing.assert_array_equal(behind((4.0, 0.0), np.inf, around + np.array([4.0, 0.0]))[:, 2], 0.0)
