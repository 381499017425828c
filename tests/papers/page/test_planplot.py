"""Floor plans side by side."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.papers.plots import EstimatedPath, PlanFigure, PlanPanel, draw_plan, plan_limits, plan_png
from occlog.papers.rahimi.example import sparse_scene
from occlog.report.drawing import house_style


def made_up(panels: int, far: float = 4.0) -> PlanFigure:
    truth = np.column_stack([np.linspace(-3.0, 3.0, 20), np.zeros(20)])
    seen = np.arange(20) % 2 == 0
    own = tuple(
        PlanPanel(
            f"number {k}", truth, seen, (EstimatedPath("one", truth + 0.1), EstimatedPath("other", far * truth / 3.0))
        )
        for k in range(panels)
    )
    return PlanFigure("Title", "caption", sparse_scene(known_range=True), own)


def test_a_panel_for_each_drawing_and_one_legend() -> None:
    with house_style():
        figure = draw_plan(made_up(4))
    shown = [a for a in figure.axes if a.get_visible()]
    assert [a.get_title(loc="left") for a in shown] == [f"number {k}" for k in range(4)]
    assert len({(a.get_xlim(), a.get_ylim()) for a in shown}) == 1
    words = [t.get_text() for t in figure.legends[0].get_texts()]
    assert words == ["camera, optical axis", "field of view", "true path", "its start", "one", "other"]


def test_dots_are_where_the_target_was_seen() -> None:
    with house_style():
        axes = draw_plan(made_up(1)).axes[0]
    dots = [line for line in axes.lines if line.get_marker() == "."]
    assert [len(line.get_xdata()) for line in dots] == [10, 10]


def test_paths_far_away_do_not_shrink_the_room() -> None:
    near, far = plan_limits(made_up(1)), plan_limits(made_up(1, far=1000.0))
    np.testing.assert_allclose(near, [[-5.4, -5.4], [5.4, 5.4]])
    np.testing.assert_allclose(far, [[-6.9, -5.4], [6.9, 5.4]])


@pytest.mark.drawn
def test_the_same_picture_has_the_same_bytes() -> None:
    assert plan_png(made_up(2)) == plan_png(made_up(2))
