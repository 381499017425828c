"""The report page: figures, tables and text; headline figures; Markdown."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS
from occlog.console.text import noun
from occlog.evaluate.mot.figures import independent_ids
from occlog.records.declared.people import POSSIBLE_SWITCH
from occlog.records.tables import UNLABELLED
from occlog.records.verdicts import Check, Verdict, all_plausible, counts_of, made_checks

from .content.coverage import MAX_SENSORS, MAX_TARGETS
from .content.metrics_in_words import Figure, groups, number
from .content.model import ReportInput, TimeAxis
from .content.people import PeopleStatistics
from .drawing import COLOURS, DARK, Plot, house_style, label, plot, script, template
from .plots.floorplan import MAX_MOVING_OCCLUDERS, bold_from, draw_floorplan, drawn_times, outside, plan_limits
from .plots.over_time import (
    axes_of,
    cameras_of,
    draw_accuracy,
    draw_crowd,
    draw_filter,
    draw_seen_by,
    draw_selection,
    draw_sight,
    draw_visibility,
    of_target,
    sensors,
    watched,
)
from .plots.sensortable import sensor_columns, sensor_rows
from .replay.build import Replay, replay
from .replay.thumbnails import Thumbnails


def plural(count: int, what: str, several: str = "") -> str:
    """Return a count with its noun: `1 target`, `2 targets`, and `2 boxes` with what="box", several="boxes"."""
    return f"{number(count)} {noun(count, what, several)}"


def headline(data: ReportInput) -> list[Figure]:
    """Return the headline figures of a run: accuracy first, then the amount of data."""
    out = _headline_accuracy(data)
    if data.time.length > 0:
        out.append(Figure("recorded time", number(float(f"{data.time.length:.4g}")), data.time.unit))
    if data.people is not None:
        out += _people(data.people)[: 2 if data.boxes_stated else 1]
    elif data.tracks is not None:
        out.append(Figure("estimates", number(data.rows("tracks")), "", f"of {plural(len(data.targets), 'target')}"))
    coverage = data.coverage
    if coverage is not None and coverage.seen < coverage.rows:  # else detections alone have rows
        share = 100.0 * (coverage.seen / coverage.rows)
        out.append(Figure("target seen", number(round(share, 1)), "%", f"of {number(coverage.rows)} observations"))
    if data.losses:
        lost = sum(loss.count for loss in data.losses)
        out.append(Figure("input lost", number(lost or len(data.losses)), "", "items" if lost else "stretches"))
    return out


def _people(people: PeopleStatistics) -> list[Figure]:
    """Return two headline figures: number of identities, with people at a time, and share of predicted estimates."""
    at_a_time = number(float(f"{people.mean:.3g}"))
    unseen = number(round(100.0 * people.unseen, 1))
    return [
        Figure("identities", number(people.identities), "", f"{at_a_time} at a time"),
        Figure("predicted", unseen, "%", f"seen by no camera, of {number(people.rows)} estimates"),
    ]


def _headline_accuracy(data: ReportInput) -> list[Figure]:
    """Return headline figures of accuracy: RMSE, bound and ratio over all targets.

    Of tracks with their own identities, multi-target figures; without errors, the distance from triangulated positions.
    """
    if data.in_images or independent_ids(data.metrics) or (data.errors is None and "idf1" in data.metrics):
        return _pairs(data)
    if data.errors is None or not len(data.errors):
        return _headline_sight(data)
    out = [Figure("RMSE", number(data.figures.errors.rmse()), data.unit, "estimate to truth")]
    if data.bound is not None and len(data.bound):
        rmse, bound = data.beside_bound()
        if bound > 0:
            who = "smoother" if data.smoothed else "filter"
            out.append(Figure("bound", number(bound), data.unit, f"no {who} can do better"))
            out.append(Figure("RMSE / bound", number(round(rmse / bound, 3)), "", "1 is the best possible"))
    return out + _in_space(data)


def _pairs(data: ReportInput) -> list[Figure]:
    """Return headline figures of tracks with their own identities (HOTA, IDF1, MOTA, per-frame RMSE), if known."""
    unit = data.unit
    value = {name: found for name, found in data.metrics.items() if isinstance(found, int | float)}
    gate = f"matching per frame, {number(value.get(f'matched_gate_{unit}'))} {unit} gate"
    where = " of boxes in the images" if not data.in_images and f"matched_gate_{unit}" not in value else ""
    shown = (
        ("HOTA", "hota", "", f"detection and association{where}"),
        ("IDF1", "idf1", "", "share of rows with the right identity"),
        ("MOTA", "mota", "", "1 is the best possible"),
        ("identity switches", "id_switches", "", ""),
        ("RMSE", f"matched_rmse_{unit}", unit, gate),
        ("mean NEES", "matched_nees_mean", "", "2 where covariances are right"),
    )
    return [Figure(name, number(value[key]), of, note) for name, key, of, note in shown if key in value]


def _in_space(data: ReportInput) -> list[Figure]:
    """Return the headline figure RMSE in space, with its ratio to the bound; empty if heights are unknown."""
    whole = data.figures.errors.rmse_in_space()
    if math.isnan(whole):
        return []
    rmse, bound = (math.nan, math.nan) if data.bound is None else data.beside_bound(where="_space")
    note = f"{number(round(rmse / bound, 3))} × bound" if bound > 0 else "heights included"
    return [Figure("RMSE in space", number(whole), data.unit, note)]


def _headline_sight(data: ReportInput) -> list[Figure]:
    """Return the headline figure RMS distance of the tracks from triangulated positions; empty without any."""
    reported = [each for each in data.sight.values() if each.rows]
    rows = sum(each.rows for each in reported)
    off = math.sqrt(math.fsum(each.rms**2 * each.rows for each in reported) / rows) if rows else math.nan
    return [] if math.isnan(off) else [Figure("off lines of sight", number(off), data.unit, "RMS; no truth is given")]


def row_counts(data: ReportInput) -> list[Figure]:
    """Return, for each given table, its number of rows, time range and number of times."""
    out = []
    for name in ("truth", "bearings", "tracks", "diagnostics", "events", "errors", "bound"):
        if getattr(data, name) is None:
            continue
        if not data.rows(name):
            out.append(Figure(name, "0", "rows", "empty"))
            continue
        lasted = TimeAxis(*data.whole[name].span_ns).duration
        times = plural(data.whole[name].times, "time")
        out.append(Figure(name, number(data.rows(name)), "rows", f"{lasted}, {times}"))
    return out


class CheckRow(NamedTuple):
    """Row of the page's table of checks: name, stage, result, figures, and the sensors and targets it concerns."""

    name: str
    stage: str
    result: str
    figures: str
    who: str


def verdict_heading(verdicts: Sequence[Verdict]) -> str:
    """Return the heading of a page: all checks of the estimates passed, one failed (not reliable), or none was made."""
    return {
        True: "All checks of these estimates passed",
        False: "Not reliable as they are",
        None: "Not checked: nothing is known for or against these estimates",
    }[all_plausible(verdicts)]


def check_rows(verdicts: Sequence[Verdict]) -> list[CheckRow]:
    """Return the rows of the table of checks with results and figures, and reasons of checks that were impossible."""
    return [
        CheckRow(check.name, stage, _result(check), _figures(check), affected(check))
        for stage, check in made_checks(verdicts)
    ]


def check_counts(verdicts: Sequence[Verdict]) -> str:
    """Return the numbers of checks by outcome, as text."""
    return counts_of(check for _, check in made_checks(verdicts))


def affected(check: Check) -> str:
    """Return the sensors and targets that a check concerns, as text."""
    targets = [f"target {target}" for target in check.targets]
    return ", ".join([*check.sensors, *targets])


def _result(check: Check) -> str:
    if check.status == "not applicable":
        return f"not applicable: {check.text}"
    return ", ".join([check.status, *([check.id] if check.id else [])])


def _figures(check: Check) -> str:
    words = {name: name.replace("_", " ") for name in check.figures}
    return ", ".join(f"{words[name]} {number(value)}" for name, value in check.figures.items())


MAX_LIVES, MAX_SWITCHES = 300, 100
"""Rows of the tables of tracks, and of possible identity switches."""


class LifeRow(NamedTuple):
    """Row of the table of tracks in images.

    Attributes:
        target: identity of the track.
        cameras: names of the cameras.
        begin, end: first and last time [s since the start].
        length: duration, as text.
        rows: number of rows, as text.
        predicted: predicted share [%], as text.
        switches: identity switches, as text.
    """

    target: int
    cameras: str
    begin: float
    end: float
    length: str
    rows: str
    predicted: str
    switches: str


class SwitchRow(NamedTuple):
    """Row of the table of possible identity switches.

    Attributes:
        seconds: time [s since the start].
        target: identity of the track.
        other: identity of the track with which it may be exchanged, or words for a person without a track.
        probability: probability of the switch, as text.
    """

    seconds: float
    target: int
    other: str
    probability: str


def life_rows(data: ReportInput) -> list[LifeRow]:
    """Return the rows of the longest tracks in images, sorted by start; empty for tracks on the ground."""
    if not data.in_images or data.people is None:
        return []
    lives = sorted(data.people.lives.items(), key=lambda item: -item[1].rows)[:MAX_LIVES]
    counts = Counter[int]()
    if (events := data.events) is not None:
        counts.update(events.target_id[events.kind == POSSIBLE_SWITCH].tolist())
    known = events is not None and data.whole["events"].every == 1
    out = []
    for target, life in sorted(lives, key=lambda item: (item[1].span_ns[0], item[0])):
        begin, end = ((t_ns - data.time.start_ns) / NS for t_ns in life.span_ns)
        share = number(round(100.0 * life.unseen / life.rows, 1)) if data.boxes_stated else "–"
        switches = number(counts[target]) if known else "–"
        cameras = ", ".join(sorted(life.cameras)) or "–"
        out.append(LifeRow(target, cameras, begin, end, f"{end - begin:.2f}", number(life.rows), share, switches))
    return out


def switch_rows(data: ReportInput) -> list[SwitchRow]:
    """Return the most probable identity switches of tracks in images, sorted by time, one row for the two tracks.

    Empty for tracks on the ground.
    """
    events = data.events
    if not data.in_images or events is None:
        return []
    doubts = np.flatnonzero(events.kind == POSSIBLE_SWITCH)
    pairs = np.sort(np.column_stack([events.target_id[doubts], events.other_id[doubts]]), axis=1)
    doubts = doubts[np.unique(np.column_stack([events.t_ns[doubts], pairs]), axis=0, return_index=True)[1]]
    doubts = np.sort(doubts[np.argsort(-np.nan_to_num(events.probability[doubts]), kind="stable")[:MAX_SWITCHES]])
    return [
        SwitchRow(
            float((events.t_ns[k] - data.time.start_ns) / NS),
            int(events.target_id[k]),
            "a person without a track" if events.other_id[k] < 0 else str(events.other_id[k]),
            number(round(float(events.probability[k]), 3)),
        )
        for k in doubts.tolist()
    ]


WIDTH = 8.4
SCRIPTS = ("plan.js", "time.js", "replay.js")


def build_page(data: ReportInput, images: Thumbnails | None = None) -> str:
    """Return the page of a run as self-contained HTML with its own script.

    Args:
        data: the run.
        images: thumbnails of the cameras; None: none.
    """
    with house_style():
        plots = _plots(data)
    return _render(data, plots, replay(data, images))


def _plots(data: ReportInput) -> list[Plot]:
    out = [*([] if data.in_images else [floorplan(data)]), *_all_people(data)]
    if data.relabelled:
        for target in data.compared[:MAX_TARGETS]:
            out += _accuracy(data, target)
    else:
        for target in data.targets[:MAX_TARGETS]:
            out += _accuracy(data, target) or _sight(data, target)
    out += [_visibility(data, target) for target in watched(data)[:MAX_TARGETS]]
    out += [_selection(data, target) for target in list(data.selections)[:MAX_TARGETS]]
    return out + _filter(data)


def floorplan(data: ReportInput) -> Plot:
    """Draw the floor plan, inside `house_style`; return it with its caption."""
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
        if moving > MAX_MOVING_OCCLUDERS:
            words.append(f"The {moving} moving occluders are not drawn.")
    if data.occluders is not None and (n := len(drawn_times(data.occluders.t_ns[data.occluders.occluder_id >= 0]))):
        words.append(f"Moving occluders are drawn as the tracker knew them at {plural(n, 'time')}.")
    if (since := bold_from(data)) is not None:
        recent = TimeAxis(since, data.time.end_ns).duration
        words.append(f"The paths are long: the last {recent} are bold, earlier parts are faint.")
    if (gone := outside(data)) > 0:
        drawn_note = " of those that are drawn lie" if data.drawn("tracks") else ""
        words.append(f"{plural(gone, 'estimate')}{drawn_note} outside the drawing.")
    words += [diagnostics] if (diagnostics := data.drawn("tracks", "truth")) else []
    return plot("plan", "Floor plan", " ".join(words), (WIDTH, height), lambda f: draw_floorplan(f, data))


EVENT_WORDS = {
    "initiated": ("track initiation", "track initiations"),
    "terminated": ("track termination", "track terminations"),
    "possible_switch": ("possible identity switch", "possible identity switches"),
}
"""Descriptions of kinds of events, of one and of several."""


def _all_people(data: ReportInput) -> list[Plot]:
    """Return the plots of tracked people, and of the sensors that detect them.

    Empty if the tracks are not of all people.
    """
    tracks, people = data.people_tracks, data.people
    if tracks is None or people is None:
        return []
    drawn = len(people.drawn)
    words = [f"{number(float(f'{people.mean:.3g}'))} people at a time, {number(people.most)} at most"]
    if not math.isnan(people.existence):
        words.append(f"probability that they are there: {number(round(people.existence, 3))} on average")
    if data.events is not None:
        counts = data.figures.events
        words.append(", ".join(plural(counts.get(kind, 0), *names) for kind, names in EVENT_WORDS.items()))
    caption = "; ".join(words) + "."
    if drawn < people.identities:
        caption += f" The {drawn} identities that are there longest are drawn, of {number(people.identities)}."
    caption += _drawn(data, "tracks", "truth", "events")
    size = (WIDTH, 2.4 + 0.16 * drawn)
    who = plot("people", "Who was there", caption, size, lambda f: draw_crowd(f, data, tracks, people))
    names = people.cameras
    if not names or (data.in_images and len(names) == 1):
        return [who]
    caption = "Share of the people who are there."
    if len(names) > 1:
        caption = f"In {number(round(100.0 * people.several, 1))} % of the estimates several cameras see the person."
    if len(names) > MAX_SENSORS:
        caption += f" The first {MAX_SENSORS} of {len(names)} cameras are drawn."
    size = (WIDTH, 1.15 + 0.27 * min(len(names), MAX_SENSORS))
    seen = plot("seenby", "Which camera saw them", caption, size, lambda f: draw_seen_by(f, data, people))
    return [who, seen]


def _drawn(data: ReportInput, *names: str) -> str:
    """Return the end of a caption that states which of the named tables are partly drawn; empty if all rows are."""
    diagnostics = data.drawn(*names)
    return f" {diagnostics[:-1]}; figures are of all." if diagnostics else ""


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
    if diagnostics := data.drawn("errors", "bound"):
        caption += f". {diagnostics[:-1]}{largest}; figures are of all"
    owner_note = f", {data.whose_errors(target)}" if data.relabelled else _whose(data, target)
    heading = f"{'Error' if data.bound is None else 'Error and bound'} over time{owner_note}"
    size = (WIDTH, 5.6 if axes == "xy" else 6.7)
    return [plot(f"error{target}", heading, caption + ".", size, lambda f: draw_accuracy(f, data, errors, target))]


def _sight(data: ReportInput, target: int) -> list[Plot]:
    """Return the plot of a target that needs no truth: triangulation distances and bearing residuals.

    Empty without any.
    """
    if target not in data.residuals or not data.residuals[target].any:
        return []
    words = ["There is no truth to compare with."]
    off, found, unit = data.residuals[target], data.sight[target], label(data.unit)
    if found.rows:
        words.append(
            f"Above: distance of the track from where the lines of sight of at least two sensors meet, RMS "
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
        plot(name, f"Track and lines of sight{_whose(data, target)}", text, size, lambda f: draw_sight(f, data, target))
    ]


def _visibility(data: ReportInput, target: int) -> Plot:
    coverage = data.coverage
    assert coverage is not None  # `watched` names no target without bearings
    rows = min(len(sensors(data)), MAX_SENSORS)
    caption = "A bar is blue as far up as the target was seen in the frames of that time."
    if len(sensors(data)) > rows:
        caption += f" The first {rows} of {len(sensors(data))} sensors are drawn."
    size = (WIDTH, 1.15 + 0.27 * rows)
    heading = f"What each sensor saw{data.whose_bearings(target)}"
    return plot(f"seen{target}", heading, caption, size, lambda f: draw_visibility(f, data, coverage, target))


def _selection(data: ReportInput, target: int) -> Plot:
    own = data.selections[target]
    caption = (
        f"Blue while a camera was selected, with its share of the time; {plural(own.count, 'selection')}. "
        f"Expected of them: {number(own.expected)} {data.unit} RMS"
        + (f"; {own.what} in those scans: {number(own.found)} {data.unit}." if own.what else ".")
    )
    if len(own.chosen) < own.count:
        caption += f" Drawn: one selection in {data.whole['diagnostics'].every}; figures are of all."
    size = (WIDTH, 0.95 + 0.27 * min(len(cameras_of(data, own)), MAX_SENSORS))
    heading = f"Selected cameras{_whose(data, target)}"
    return plot(f"selected{target}", heading, caption, size, lambda f: draw_selection(f, data, own))


def _filter(data: ReportInput) -> list[Plot]:
    diagnostics, filter_diagnostics = data.diagnostics, data.filter_diagnostics
    if diagnostics is None or filter_diagnostics is None:
        return []
    fallbacks = sum(found.rows for found in filter_diagnostics.fallbacks.values())
    steps, drawn = plural(filter_diagnostics.rows, "step"), "diagnostics"
    heading = "Filter"
    if filter_diagnostics.particles:
        lowest = number(round(filter_diagnostics.lowest, 1))
        caption = f"Lowest effective sample size {lowest}; {plural(fallbacks, 'fallback')} in {steps}."
    elif data.tracks is not None and len(data.tracks):
        heading, median, drawn = "Certainty", number(data.figures.deviation), "tracks"
        caption = f"Median standard deviation of the position {median} {data.unit}; {fallbacks} of {steps} flagged."
    else:
        return []
    if filter_diagnostics.doubtful:
        caption += f" Doubtful: {filter_diagnostics.doubtful} of {steps} ({', '.join(filter_diagnostics.doubts)})."
    caption += _drawn(data, drawn)
    return [plot("filter", heading, caption, (WIDTH, 2.7), lambda f: draw_filter(f, data, diagnostics))]


def _render(data: ReportInput, plots: list[Plot], replay: Replay | None) -> str:
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
        sensors=(rows := sensor_rows(data)),
        sensor_columns=sensor_columns(rows, data.unit),
        plots=plots,
        left_out=() if data.in_images else data.targets[MAX_TARGETS:],
        lives=life_rows(data),
        more_lives=0 if data.people is None else len(data.people.lives) - MAX_LIVES,
        switches=switch_rows(data),
        losses=data.losses,
        provenance=_provenance(data.provenance),
        replay=replay,
        script=script(*SCRIPTS),
        light=COLOURS,
        dark=DARK,
    )


def _provenance(values: object) -> str:
    return json.dumps(values, indent=2, sort_keys=True, ensure_ascii=False, default=str) if values else ""


SPECIAL = "\\`*_{}[]<>()#+-!|&~"
MAX_LOSSES = 20


def build_markdown(data: ReportInput) -> str:
    """Return the report as Markdown: verdict, losses, and all figures, without pictures."""
    out = [f"# {plain(data.title)}", ""]
    if data.tracks is not None or data.verdicts:
        out += [f"**{plain(verdict_heading(data.verdicts))}.**", ""]
        for stage, check in data.findings:
            place = stage if check.severity == "warning" else f"{stage}, note"
            out.append(f"- **{plain(check.id)}** ({place}): {plain(check.text)}")
        out += [""] if data.findings else []
    out += table_lines(
        ("Figure", "Value", "Unit", "Note"), ((f.name, f.value, f.unit, f.note) for f in headline(data)), "lrll"
    )
    if data.losses:
        out += ["## Input that was lost", ""]
        lost = ((loss.source, loss.place, loss.what, str(loss.count or "")) for loss in data.losses[:MAX_LOSSES])
        out += table_lines(("Source", "Where", "What", "Items"), lost, "lllr")
        if len(data.losses) > MAX_LOSSES:
            out += [f"and {len(data.losses) - MAX_LOSSES} more.", ""]
    for group in groups(data.metrics, data.unit):
        out += [f"## {plain(group.title)}", ""]
        if group.figures:
            rows = ((f.name, f.value, f.unit, f.note) for f in group.figures)
            out += table_lines(("Figure", "Value", "Unit", "Meaning"), rows, "lrll")
        for table in group.breakdowns:
            cells = ((name, *values) for name, values in table.rows)
            out += table_lines((table.kind.capitalize(), *table.columns), cells, "l" + "r" * len(table.columns))
    if checks := check_rows(data.verdicts):
        out += ["## Checks", "", f"{check_counts(data.verdicts)}.", ""]
        out += table_lines(("Check", "Stage", "Result", "Sensors, targets", "Figures"), checks, "lllll")
    out += ["## Tables read", ""]
    out += table_lines(("Table", "Rows", "Time"), ((r.name, r.value, r.note) for r in row_counts(data)), "lrl")
    return "\n".join(out)


def table_lines(head: Sequence[str], rows: Iterable[Sequence[object]], sides: str) -> list[str]:
    """Return the lines of a Markdown table.

    Args:
        head: titles of the columns.
        rows: cells of each row.
        sides: alignment of each column, left (l) or right (r), as in `lrr`.
    """
    lines = [_row(head), "|" + "|".join("---:" if side == "r" else "---" for side in sides) + "|"]
    return [*lines, *(_row(row) for row in rows), ""]


def _row(cells: Sequence[object]) -> str:
    return "| " + " | ".join(plain(cell) for cell in cells) + " |"


def plain(value: object) -> str:
    """Return `value` as Markdown text with markup characters escaped, in one line."""
    plain = " ".join(str(value).split())
    return "".join(f"\\{c}" if c in SPECIAL else c for c in plain)
