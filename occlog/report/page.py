"""Puts a report together: figures, tables and words into one page, and the main ones into one picture."""

from __future__ import annotations

import json

import numpy as np

from occlog.records.tables import UNLABELLED
from occlog.report.content.looks import MOST_SENSORS, MOST_TARGETS
from occlog.report.content.metrics_in_words import groups, number
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.drawing.html import script, template
from occlog.report.drawing.plot import Plot, plot
from occlog.report.drawing.style import COLOURS, DARK, house_style, label
from occlog.report.plots.accuracy import axes_of, draw_accuracy, of_target
from occlog.report.plots.filterplot import draw_filter
from occlog.report.plots.floorplan import (
    MOST_MOVING_OCCLUDERS,
    bold_from,
    draw_floorplan,
    moments,
    outside,
    plan_limits,
)
from occlog.report.plots.peopleplot import draw_crowd, draw_seen_by
from occlog.report.plots.selectionplot import cameras_of, draw_selection
from occlog.report.plots.sensortable import sensor_rows
from occlog.report.plots.sightplot import draw_sight
from occlog.report.plots.visibility import draw_visibility, sensors, watched
from occlog.report.replay.build import Replay, replay
from occlog.report.replay.thumbnails import Thumbnails

from .summary import check_counts, check_rows, headline, plural, row_counts, verdict_heading

WIDTH = 8.4
SCRIPTS = ("plan.js", "time.js", "replay.js")


def build_page(data: ReportInput, images: Thumbnails | None = None) -> str:
    """The page of a run as HTML: self-contained, with a script of its own and no other.

    Args:
        data: the run.
        images: of the cameras, beside the moments of the run.
    """
    with house_style():
        plots = _plots(data)
    return _render(data, plots, replay(data, images))


def _plots(data: ReportInput) -> list[Plot]:
    out = [floorplan(data), *_everybody(data)]
    if data.relabelled:
        for target in data.compared[:MOST_TARGETS]:
            out += _accuracy(data, target)
    else:
        for target in data.targets[:MOST_TARGETS]:
            out += _accuracy(data, target) or _sight(data, target)
    out += [_visibility(data, target) for target in watched(data)[:MOST_TARGETS]]
    out += [_selection(data, target) for target in list(data.selections)[:MOST_TARGETS]]
    return out + _filter(data)


def floorplan(data: ReportInput) -> Plot:
    """The floor plan, to be called inside `house_style`."""
    size = np.diff(plan_limits(data), axis=0)[0]
    height = float(np.clip(WIDTH * 0.88 * size[1] / size[0] + 1.0, 3.4, 8.4))
    words = ["Seen from above, x and y to the same scale."]
    if data.scene is not None and data.scene.room is None:
        words.append("The scene states no room.")
    if data.scene is not None and any(not c.placed for c in data.scene.cameras):
        names = ", ".join(label(c.name) for c in data.scene.cameras if not c.placed)
        words.append(f"Not drawn, as their pose is not known: {names}.")
    if data.truth is not None:
        moving = len(np.unique(data.truth.target_id[data.truth.role == "occluder"]))
        if moving > MOST_MOVING_OCCLUDERS:
            words.append(f"The {moving} moving occluders are not drawn.")
    if data.occluders is not None and (n := len(moments(data.occluders.t_ns[data.occluders.occluder_id >= 0]))):
        words.append(f"Moving occluders are drawn as the tracker knew them at {plural(n, 'moment')}.")
    if (since := bold_from(data)) is not None:
        recent = TimeAxis(since, data.time.end_ns).told
        words.append(f"The paths are long: the last {recent} are bold, what came before is faint.")
    if (gone := outside(data)) > 0:
        whose = " of those that are drawn lie" if data.drawn("tracks") else ""
        words.append(f"{plural(gone, 'estimate')}{whose} outside the drawing.")
    words += [said] if (said := data.drawn("tracks", "truth")) else []
    return plot("plan", "Floor plan", " ".join(words), (WIDTH, height), lambda f: draw_floorplan(f, data))


def _everybody(data: ReportInput) -> list[Plot]:
    """Who was there, and who saw them."""
    tracks, people = data.everybody, data.people
    if tracks is None or people is None:
        return []
    drawn = len(people.drawn)
    words = [f"{number(float(f'{people.mean:.3g}'))} people at a time, {number(people.most)} at most"]
    words.append(f"probability that they are there: {number(round(people.existence, 3))} on average")
    if data.events is not None:
        words.append(", ".join(plural(data.figures.events.get(kind, 0), kind) for kind in ("birth", "death", "doubt")))
    caption = "; ".join(words) + "."
    if drawn < people.identities:
        caption += f" The {drawn} identities that are there longest are drawn, of {number(people.identities)}."
    caption += _drawn(data, "tracks", "truth", "events")
    size = (WIDTH, 2.4 + 0.16 * drawn)
    who = plot("people", "Who was there", caption, size, lambda f: draw_crowd(f, data, tracks, people))
    names = people.cameras
    if not names:
        return [who]
    caption = f"In {number(round(100.0 * people.several, 1))} % of the estimates several cameras see the person."
    if len(names) > MOST_SENSORS:
        caption += f" The first {MOST_SENSORS} of {len(names)} cameras are drawn."
    size = (WIDTH, 1.15 + 0.27 * min(len(names), MOST_SENSORS))
    seen = plot("seenby", "Which camera saw them", caption, size, lambda f: draw_seen_by(f, data, people))
    return [who, seen]


def _drawn(data: ReportInput, *names: str) -> str:
    """What is drawn of tables, as the end of a caption; nothing where all of them is."""
    said = data.drawn(*names)
    return f" {said[:-1]}; figures are of all." if said else ""


def _whose(data: ReportInput, target: int) -> str:
    return "" if len(data.targets) <= 1 else f", target {target}"


def _accuracy(data: ReportInput, target: int) -> list[Plot]:
    errors = data.errors
    if errors is None or not (errors.target_id == target).any():
        return []
    unit, found = label(data.unit), data.figures.errors
    caption = f"RMSE {number(found.rmse(target))} {unit}, largest error {number(found.worst(target))} {unit}"
    if data.bound is not None:
        _, bound = data.beside_bound(target)
        caption += f"; the posterior Cramér–Rao bound on the RMSE is {number(bound)} {unit}" if bound > 0 else ""
    axes, largest = (
        axes_of(of_target(errors, target)),
        ", and the largest errors between them" if data.drawn("errors") else "",
    )
    if "z" in axes:
        caption = f"On the ground: {caption}. The lowest row is the height"
    if said := data.drawn("errors", "bound"):
        caption += f". {said[:-1]}{largest}; figures are of all"
    whose = f", {data.whose_errors(target)}" if data.relabelled else _whose(data, target)
    heading = f"Error and bound over time{whose}"
    size = (WIDTH, 5.6 if axes == "xy" else 6.7)
    return [plot(f"error{target}", heading, caption + ".", size, lambda f: draw_accuracy(f, data, errors, target))]


def _sight(data: ReportInput, target: int) -> list[Plot]:
    """What can be said without truth."""
    if target not in data.residuals or not data.residuals[target].any:
        return []
    words = ["There is no truth to compare with."]
    off, found, unit = data.residuals[target], data.sight[target], label(data.unit)
    if found.rows:
        words.append(
            f"Above: distance of the track from where the sight lines of at least two sensors meet, RMS "
            f"{number(found.rms)} {unit}, 95 % below {number(found.high)} {unit}. Below:"
        )
    words.append("measured minus expected direction of each sighting, in degrees.")
    if watched(data) == (UNLABELLED,):
        words.append("The bearings name no target, so those nearest to the track are shown.")
    if off.every > 1:
        words.append(f"Drawn: one in {off.every} of these and the largest ones between them; figures are of all.")
    text = " ".join(words).replace(". m", ". M")
    name, size = f"sight{target}", (WIDTH, 4.6 if found.rows else 2.9)
    return [
        plot(name, f"Track and sight lines{_whose(data, target)}", text, size, lambda f: draw_sight(f, data, target))
    ]


def _visibility(data: ReportInput, target: int) -> Plot:
    looked = data.looked
    assert looked is not None  # `watched` names no target without bearings
    rows = min(len(sensors(data)), MOST_SENSORS)
    caption = "A bar is blue as far up as the target was seen in the frames of that time."
    if len(sensors(data)) > rows:
        caption += f" The first {rows} of {len(sensors(data))} sensors are drawn."
    size = (WIDTH, 1.15 + 0.27 * rows)
    heading = f"What each sensor saw{data.whose_bearings(target)}"
    return plot(f"seen{target}", heading, caption, size, lambda f: draw_visibility(f, data, looked, target))


def _selection(data: ReportInput, target: int) -> Plot:
    own = data.selections[target]
    caption = (
        f"Blue while a camera was selected, with its share of the time; {plural(own.count, 'selection')}. "
        f"Expected of them: {number(own.expected)} {data.unit} RMS"
        + (f"; {own.what} in those scans: {number(own.found)} {data.unit}." if own.what else ".")
    )
    if len(own.chosen) < own.count:
        caption += f" Drawn: one selection in {data.whole['diagnostics'].every}; figures are of all."
    size = (WIDTH, 0.95 + 0.27 * min(len(cameras_of(data, own)), MOST_SENSORS))
    heading = f"Selected cameras{_whose(data, target)}"
    return plot(f"selected{target}", heading, caption, size, lambda f: draw_selection(f, data, own))


def _filter(data: ReportInput) -> list[Plot]:
    diagnostics, fared = data.diagnostics, data.fared
    if diagnostics is None or fared is None:
        return []
    fallbacks = sum(found.rows for found in fared.fallbacks.values())
    steps, drawn = plural(fared.rows, "step"), "diagnostics"
    heading = "Filter"
    if fared.particles:
        lowest = number(round(fared.lowest, 1))
        caption = f"Lowest effective sample size {lowest}; {plural(fallbacks, 'fallback')} in {steps}."
    elif data.tracks is not None and len(data.tracks):
        heading, median, drawn = "Certainty", number(data.figures.deviation), "tracks"
        caption = f"Median standard deviation of the position {median} {data.unit}; {fallbacks} of {steps} flagged."
    else:
        return []
    if fared.doubtful:
        caption += f" Doubtful: {fared.doubtful} of {steps} ({', '.join(fared.doubts)})."
    caption += _drawn(data, drawn)
    return [plot("filter", heading, caption, (WIDTH, 2.7), lambda f: draw_filter(f, data, diagnostics))]


def _render(data: ReportInput, plots: list[Plot], moments: Replay | None) -> str:
    return template("report.html.j2").render(
        title=data.title,
        unit=data.unit,
        start=data.time.start,
        headline=headline(data),
        judged=data.tracks is not None or bool(data.verdicts),
        verdict=verdict_heading(data.verdicts),
        plausible=data.plausible,
        findings=data.findings,
        checks=check_rows(data.verdicts),
        check_counts=check_counts(data.verdicts),
        groups=groups(data.metrics, data.unit),
        rows=row_counts(data),
        sensors=sensor_rows(data),
        plots=plots,
        left_out=data.targets[MOST_TARGETS:],
        losses=data.losses,
        provenance=_provenance(data.provenance),
        replay=moments,
        script=script(*SCRIPTS),
        light=COLOURS,
        dark=DARK,
    )


def _provenance(values: object) -> str:
    return json.dumps(values, indent=2, sort_keys=True, ensure_ascii=False, default=str) if values else ""
