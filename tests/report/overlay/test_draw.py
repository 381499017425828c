"""What is drawn over frames is where it should be, in the target's colour, and stays readable."""

import numpy as np
import pytest

from occlog.report.overlay import draw
from occlog.report.overlay.draw import BAR, FrameDrawing, Outline, TruePosition, colour_of, draw_shot, tile

GREY = np.full((120, 160, 3), 90, dtype=np.uint8)


def near(picture, x, y, colour, within=2):
    """Whether the colour is within some pixels of a place (x, y) of the image below the bar."""
    y, x = round(y) + BAR, round(x)
    patch = picture[max(y - within, 0) : y + within + 1, max(x - within, 0) : x + within + 1].astype(int)
    return bool((np.abs(patch - colour).max(axis=2) < 40).any())


@pytest.mark.parametrize("scale", [1.0, 2.0, 3.0])
def test_an_ellipse_is_drawn_around_its_rim(scale):
    e = np.array([80.0, 70.0, 30.0, 12.0, 0.5])
    picture = draw_shot(GREY, FrameDrawing("a", [Outline(e, 2)]), scale)
    assert picture.shape == (BAR + 120 * scale, 160 * scale, 3)
    for t in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        u, v = 30 * np.cos(t), 12 * np.sin(t)
        x, y = 80 + u * np.cos(0.5) - v * np.sin(0.5), 70 + u * np.sin(0.5) + v * np.cos(0.5)
        assert near(picture, scale * (x + 0.5) - 0.5, scale * (y + 0.5) - 0.5, colour_of(2))
    assert near(picture, scale * 80.5, scale * 70.5, (90, 90, 90), 0)


def drawn(shot, scale=1.0):
    """(H, W) which pixels of the image below the bar are not those of the frame."""
    return (draw_shot(GREY, shot, scale)[BAR:] != 90).any(axis=2)


def test_dashes_leave_gaps_and_help_makes_lines_thick():
    e = np.array([80.0, 60.0, 30.0, 30.0, 0.0])
    area = {
        name: drawn(FrameDrawing("a", [Outline(e, 0, *flags)]))[50:].sum()
        for name, flags in (
            ("plain", ()),
            ("dashed", (True,)),
            ("strong", (False, True)),
            ("wrong", (False, False, "x")),
        )
    }
    assert 0.4 * area["plain"] < area["dashed"] < 0.8 * area["plain"]
    assert area["strong"] > 1.1 * area["plain"]
    assert area["wrong"] > 1.8 * area["plain"]


def test_true_places_are_crosses_or_boxes_and_missed_ones_red():
    box = np.array([40.0, 30.0, 20.0, 40.0])
    picture = draw_shot(GREY, FrameDrawing("a", positions=[TruePosition(box, 1)]), 1.0)
    assert near(picture, 50, 50, colour_of(1), 1)
    assert not near(picture, 40, 50, colour_of(1))
    assert near(
        draw_shot(GREY, FrameDrawing("a", positions=[TruePosition(box, 1)], boxed=True), 1.0), 40, 50, colour_of(1), 1
    )
    assert near(
        draw_shot(GREY, FrameDrawing("a", positions=[TruePosition(box, 1, 1.0, True)]), 1.0), 40, 50, draw.ALARM, 1
    )
    seen, hidden = (drawn(FrameDrawing("a", positions=[TruePosition(box, 1, v)], boxed=True)).sum() for v in (1.0, 0.1))
    assert hidden < 0.9 * seen


def test_links_lines_and_notes():
    link = np.array([[20.0, 20.0], [60.0, 20.0]])
    line = np.array([[-500.0, 60.0], [500.0, 60.0]])
    picture = draw_shot(GREY, FrameDrawing("a", links=[link], lines=[(3, line)], notes=["target 7: no tracker"]), 1.0)
    assert near(picture, 40, 20, draw.WHITE, 1)
    assert near(picture, 5, 60, colour_of(3), 1)
    assert near(picture, 155, 60, colour_of(3), 1)
    assert near(picture, 30, 108, draw.ALARM, 12)


def test_numbers_do_not_hide_one_another(monkeypatch):
    spots = []
    label = draw.label
    monkeypatch.setattr(draw, "label", lambda *args: (label(*args), spots.append(list(args[-1])))[0])
    e = np.array([80.0, 60.0, 20.0, 20.0, 0.0])
    draw_shot(GREY, FrameDrawing("a", [Outline(e + np.eye(5)[0] * k, k) for k in range(4)]), 1.0)
    taken = spots[-1]
    assert len(taken) == 4
    assert not any(draw._overlap(a, b) for i, a in enumerate(taken) for b in taken[:i])
    assert all(0 <= left < right <= 160 and 0 <= top < bottom <= 120 for left, top, right, bottom in taken)


def test_what_is_far_outside_has_its_number_at_the_edge_and_nothing_else():
    far = np.array([1e9, -1e9, 1e4, 5.0, 0.3])
    line = np.array([[-1e12, 0.0], [1e12, 5.0]])
    picture = draw_shot(GREY, FrameDrawing("a", [Outline(far, 1, False, True, "on 2")]), 2.0)
    rows, columns = np.nonzero((picture != draw_shot(GREY, FrameDrawing("a"), 2.0)).any(axis=2))
    assert rows.max() < BAR + 24
    assert columns.max() == picture.shape[1] - 1
    crossed = draw_shot(GREY, FrameDrawing("a", lines=[(1, line)]), 2.0)
    assert crossed.shape == picture.shape


def test_grey_frames_and_small_scales():
    picture = draw_shot(GREY[..., 0], FrameDrawing("a"), 0.5)
    assert picture.shape == (BAR + 60, 80, 3)
    assert (picture[BAR:] == 90).all()


def test_tiles_are_in_rows_and_of_even_size():
    pictures = [np.full((31, 21, 3), 50 * (k + 1), dtype=np.uint8) for k in range(3)]
    whole = tile(pictures, 2)
    assert whole.shape[0] % 2 == whole.shape[1] % 2 == 0
    assert (whole[:31, :21] == 50).all()
    assert (whole[:31, 25:46] == 100).all()
    assert (whole[35:66, :21] == 150).all()
