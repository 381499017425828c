"""The page of a plan: map, figures in words, rankings; one offline file without scripts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import NamedTuple

from markupsafe import Markup

from occlog.report.drawing.html import template
from occlog.report.drawing.style import COLOURS, DARK, house_style, new_figure, raw_svg
from occlog.report.drawing.svg import page_svg

from .picture import MapPicture, draw_maps, size_of

HEADING = "Expected error and coverage"
RANKINGS = {
    "added": "Added one after the other, each time the one that helps most",
    "candidates": "One more sensor, the best place first",
    "without": "One sensor less, the least needed first",
}


class PageInput(NamedTuple):
    """What is on the page."""

    drawn: MapPicture
    summary: Mapping[str, object]
    warnings: tuple[str, ...]
    provenance: Mapping[str, object]


def plan_page(what: PageInput) -> str:
    """The page as HTML."""
    unit = what.drawn.scene.length_unit
    words = "Seen from above, x and y to the same scale; the colours of the errors are on a logarithmic scale."
    with house_style():
        canvas = new_figure(*size_of(what.drawn))
        draw_maps(canvas, what.drawn)
        svg = Markup(page_svg(raw_svg(canvas), "plan", HEADING, words))
    rankings = {title: what.summary[name] for name, title in RANKINGS.items() if what.summary.get(name)}
    return template("plan.html.j2").render(
        title="What to expect of these sensors",
        heading=HEADING,
        unit=unit,
        figures=_figures(what.summary, unit),
        svg=svg,
        caption=words,
        rankings=rankings,
        warnings=what.warnings,
        provenance=json.dumps(what.provenance, indent=2, sort_keys=True, ensure_ascii=False, default=str),
        light=COLOURS,
        dark=DARK,
    )


def _figures(summary: Mapping[str, object], unit: str) -> list[tuple[str, str]]:
    """Names and values of the figures, in words."""
    number = {name: value for name, value in summary.items() if isinstance(value, int | float)}
    out = [
        (f"expected error over the floor, RMSE [{unit}]", f"{number[f'rmse_{unit}']:.3f}"),
        (f"its standard error [{unit}]", f"{number[f'rmse_error_{unit}']:.3f}"),
        (f"mean of the map [{unit}]", f"{number[f'mean_{unit}']:.3f}"),
        (f"worst place [{unit}]", f"{number[f'worst_{unit}']:.3f}"),
    ]
    if "share_within" in number:
        out.append((f"share below {number[f'within_{unit}']:g} {unit}", f"{number['share_within']:.1%}"))
    names = {
        "seen_by_2": "seen by two or more sensors",
        "seen_by_1": "by one",
        "seen_by_0": "by none",
        "no_fix": "without a fix",
    }
    out += [(words, f"{number[name]:.1%}") for name, words in names.items()]
    return [*out, ("people beside the target", str(summary["people"])), ("sensors", str(summary["sensors"]))]
