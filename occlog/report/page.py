"""Puts a report together: figures, tables and words into one page, and the main ones into one picture."""

from __future__ import annotations

import json

import numpy as np

from occlog.records.tables import UNLABELLED
from occlog.report.content.metrics_in_words import groups, number
from occlog.report.content.model import ReportInput
from occlog.report.drawing.html import script, template
from occlog.report.drawing.plot import Plot, plot
from occlog.report.drawing.style import COLOURS, DARK, house_style, label
from occlog.report.plots.accuracy import axes_of, draw_accuracy
from occlog.report.plots.filterplot import deviation, draw_filter, has_particles
from occlog.report.plots.floorplan import (
    MOST_MOVING_OCCLUDERS,
    bold_from,
    draw_floorplan,
    moments,
    outside,
    plan_limits,
)
from occlog.report.plots.peopleplot import MOST_PEOPLE, crowd, draw_crowd, draw_seen_by, seeing
from occlog.report.plots.selectionplot import cameras_of, draw_selection, expected_and_found, selected_targets, spans
from occlog.report.plots.sensortable import sensor_rows
from occlog.report.plots.sightplot import draw_sight
from occlog.report.plots.visibility import MOST_ROWS, draw_visibility, sensors, watched
from occlog.report.replay.build import Replay, replay
from occlog.report.replay.thumbnails import Thumbnails
from occlog.track.plausibility.verdict import plausible

from .summary import headline, plural, rms, row_counts, with_bound

WIDTH = 8.4
SCRIPTS = ("plan.js", "time.js", "replay.js")
MOST_TARGETS = 6
"""More targets than these are in the tables and the floor plan, but get no figures of their own."""


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
    for target in data.targets[:MOST_TARGETS]:
        out += _accuracy(data, target) or _sight(data, target)
    out += [_visibility(data, target) for target in watched(data)[:MOST_TARGETS]]
    out += [_selection(data, target) for target in selected_targets(data.diagnostics)[:MOST_TARGETS]]
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
        recent = number(float(f"{(data.time.end_ns - since) / data.time.ns_per_unit:.3g}"))
        words.append(f"The paths are long: the last {recent} {data.time.unit} are bold, what came before is faint.")
    if (gone := outside(data)) > 0:
        whose = " of those that are drawn lie" if "tracks" in data.whole else ""
        words.append(f"{plural(gone, 'estimate')}{whose} outside the drawing.")
    words += [said] if (said := data.drawn("tracks", "truth")) else []
    return plot("plan", "Floor plan", " ".join(words), (WIDTH, height), lambda f: draw_floorplan(f, data))


def _everybody(data: ReportInput) -> list[Plot]:
    """Who was there, and who saw them."""
    tracks = data.everybody
    if tracks is None:
        return []
    people, ids = crowd(tracks), np.unique(tracks.target_id)
    drawn = min(len(ids), MOST_PEOPLE)
    words = [
        f"{number(float(f'{people.people.mean():.3g}'))} people at a time, {number(int(people.people.max()))} at most"
    ]
    words.append(f"probability that they are there: {number(round(float(np.nanmean(tracks.existence)), 3))} on average")
    if data.events is not None:
        counts = [(int(np.count_nonzero(data.events.kind == kind)), kind) for kind in ("birth", "death", "doubt")]
        words.append(", ".join(plural(count, kind) for count, kind in counts))
    caption = "; ".join(words) + "."
    if drawn < len(ids):
        caption += f" The {drawn} identities that are there longest are drawn, of {number(len(ids))}."
    size = (WIDTH, 2.4 + 0.16 * drawn)
    who = plot("people", "Who was there", caption, size, lambda f: draw_crowd(f, data, tracks, data.events))
    names = seeing(tracks)
    if not names:
        return [who]
    several = float(np.mean(np.char.find(tracks.seen_by, ",") >= 0))
    caption = f"In {number(round(100.0 * several, 1))} % of the estimates several cameras see the person."
    if len(names) > MOST_ROWS:
        caption += f" The first {MOST_ROWS} of {len(names)} cameras are drawn."
    size = (WIDTH, 1.15 + 0.27 * min(len(names), MOST_ROWS))
    seen = plot("seenby", "Which camera saw them", caption, size, lambda f: draw_seen_by(f, data, tracks))
    return [who, seen]


def _whose(data: ReportInput, target: int) -> str:
    return "" if len(data.targets) <= 1 else f", target {target}"


def _accuracy(data: ReportInput, target: int) -> list[Plot]:
    errors = data.errors
    if errors is None or not (rows := errors.target_id == target).any():
        return []
    unit, of_all = label(data.unit), data.of_all
    rmse = rms(errors.error[rows]) if of_all is None else of_all.rmse(target)
    worst = float(errors.error[rows].max()) if of_all is None else of_all.worst(target)
    caption = f"RMSE {number(rmse)} {unit}, largest error {number(worst)} {unit}"
    if data.bound is not None:
        its = data.bound.take(data.bound.target_id == target)
        _, bound = with_bound(errors.take(rows), its, smoothed=data.smoothed)
        caption += f"; the posterior Cramér–Rao bound on the RMSE is {number(bound)} {unit}" if bound > 0 else ""
    axes = axes_of(errors.take(rows))
    if "z" in axes:
        caption = f"On the ground: {caption}. The lowest row is the height"
    if said := data.drawn("errors"):
        caption += f". {said[:-1]}, and the largest errors between them; figures are of all"
    heading = f"Error and bound over time{_whose(data, target)}"
    size = (WIDTH, 5.6 if axes == "xy" else 6.7)
    return [plot(f"error{target}", heading, caption + ".", size, lambda f: draw_accuracy(f, data, errors, target))]


def _sight(data: ReportInput, target: int) -> list[Plot]:
    """What can be said without truth."""
    if target not in data.residuals or not len(data.residuals[target].residual):
        return []
    words = ["There is no truth to compare with."]
    distance, unit = data.sight[target][1], label(data.unit)
    if len(distance):
        words.append(
            f"Above: distance of the track from where the sight lines of at least two sensors meet, RMS "
            f"{number(rms(distance))} {unit}, 95 % below {number(float(np.percentile(distance, 95)))} {unit}. Below:"
        )
    words.append("measured minus expected direction of each sighting, in degrees.")
    if watched(data) == (UNLABELLED,):
        words.append("The bearings name no target, so those nearest to the track are shown.")
    text = " ".join(words).replace(". m", ". M")
    name, size = f"sight{target}", (WIDTH, 4.6 if len(distance) else 2.9)
    return [
        plot(name, f"Track and sight lines{_whose(data, target)}", text, size, lambda f: draw_sight(f, data, target))
    ]


def _visibility(data: ReportInput, target: int) -> Plot:
    bearings = data.bearings
    assert bearings is not None  # `watched` names no target without bearings
    rows = min(len(sensors(data)), MOST_ROWS)
    whose = ", any object" if target < 0 else ("" if len(watched(data)) == 1 else f", target {target}")
    caption = "A bar is blue as far up as the target was seen in the frames of that time."
    if len(sensors(data)) > rows:
        caption += f" The first {rows} of {len(sensors(data))} sensors are drawn."
    size = (WIDTH, 1.15 + 0.27 * rows)
    heading = f"What each sensor saw{whose}"
    return plot(f"seen{target}", heading, caption, size, lambda f: draw_visibility(f, data, bearings, target))


def _selection(data: ReportInput, target: int) -> Plot:
    diagnostics = data.diagnostics
    assert diagnostics is not None  # `selected_targets` names no target without diagnostics
    times, chosen, _ = spans(diagnostics, target)
    expected, found, what = expected_and_found(diagnostics, data, target)
    caption = (
        f"Blue while a camera was selected, with its share of the time; {plural(len(times) - 1, 'selection')}. "
        f"Expected of them: {number(expected)} {data.unit} RMS"
        + (f"; {what} in those scans: {number(found)} {data.unit}." if what else ".")
    )
    size = (WIDTH, 0.95 + 0.27 * min(len(cameras_of(data, chosen)), MOST_ROWS))
    heading = f"Selected cameras{_whose(data, target)}"
    return plot(f"selected{target}", heading, caption, size, lambda f: draw_selection(f, data, diagnostics, target))


def _filter(data: ReportInput) -> list[Plot]:
    diagnostics = data.diagnostics
    if diagnostics is None or not len(diagnostics):
        return []
    fallbacks = int(np.count_nonzero(diagnostics.fallback != ""))
    steps = plural(len(diagnostics), "step")
    heading = "Filter"
    if has_particles(diagnostics):
        lowest = number(round(float(diagnostics.ess.min()), 1))
        caption = f"Lowest effective sample size {lowest}; {plural(fallbacks, 'fallback')} in {steps}."
    elif data.tracks is not None and len(data.tracks):
        heading, median = "Certainty", number(float(np.median(deviation(data.tracks))))
        caption = f"Median standard deviation of the position {median} {data.unit}; {fallbacks} of {steps} flagged."
    else:
        return []
    if doubtful := int(np.count_nonzero(diagnostics.doubt != "")):
        kinds = sorted({kind for text in diagnostics.doubt.tolist() if text for kind in text.split(",")})
        caption += f" Doubtful: {doubtful} of {steps} ({', '.join(kinds)})."
    return [plot("filter", heading, caption, (WIDTH, 2.7), lambda f: draw_filter(f, data, diagnostics))]


def _render(data: ReportInput, plots: list[Plot], moments: Replay | None) -> str:
    return template("report.html.j2").render(
        title=data.title,
        unit=data.unit,
        start=data.time.start,
        headline=headline(data),
        findings=data.findings,
        plausible=data.findings is None or plausible(data.findings),
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
