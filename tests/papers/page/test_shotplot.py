"""Pictures of frames with trackers on them, alone and on the page."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.papers.page import Chart, ExperimentPage, build_reproduction, picture_png
from occlog.papers.plots import EpipolarLine, FigureImage, Mark, Shots, bright, draw_shots, ends_of


def shots() -> Shots:
    image = np.full((24, 32, 3), 90, dtype=np.uint8)
    marks = (
        Mark(0, np.array([10.0, 8.0, 5.0, 4.0, 0.3]), good=True),
        Mark(1, np.array([20.0, 8.0, 5.0, 4.0, 0.0]), good=False),
    )
    links = ((np.array([10.0, 8.0]), np.array([20.0, 8.0])),)
    shot = FigureImage("frame 3", image, marks, links, (EpipolarLine(0, np.array([0.0, 1.0, -8.0])),))
    return Shots("Frames", "one frame", ("BMCT <1>", "MIPF"), ((shot, shot), (shot,)))


@pytest.mark.parametrize(
    ("line", "ends"),
    [
        ([0.0, 1.0, -5.0], [[-0.5, 5.0], [9.5, 5.0]]),
        ([1.0, 0.0, -3.0], [[3.0, -0.5], [3.0, 7.5]]),
        ([1.0, -1.0, 0.0], [[-0.5, -0.5], [7.5, 7.5]]),
        ([0.0, 1.0, 9.0], None),
    ],
)
def test_lines_end_at_the_edges_of_the_image(line, ends) -> None:
    got = ends_of(np.array(line), 10, 8)
    if ends is None:
        assert got is None
    else:
        np.testing.assert_allclose(got, ends)


def test_trackers_have_colours_of_their_targets_and_wrong_ones_a_cross() -> None:
    axes = draw_shots(shots()).axes[0]
    assert [t.get_text() for t in axes.texts if t.get_text() in ("0", "1 ×")] == ["0", "1 ×"]
    assert len(axes.patches) == 2
    assert axes.patches[0].get_linestyle() in ("-", "solid")
    assert axes.patches[1].get_linestyle() not in ("-", "solid")
    assert bright(0) != bright(1)


@pytest.mark.drawn
def test_the_page_holds_the_picture_and_says_what_it_shows() -> None:
    picture = picture_png(shots())
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    assert picture == picture_png(shots())
    chart = Chart("fig7", "What happens", "frame", "rate", [], "")
    part = ExperimentPage(chart, "2 runs.", [], [["series", "values"]], {"frames": shots()})
    page = build_reproduction("A paper", [part], "Made by hand.")
    assert "Made by hand." in page
    assert 'src="data:image/png;base64,' in page
    assert 'alt="Frames: BMCT &lt;1&gt;, MIPF"' in page
    assert "img-src data:" in page
