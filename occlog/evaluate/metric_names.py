"""All figures of an evaluation: name, label, unit and meaning, for the summary, the report, and misspelled names."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from typing import NamedTuple

from occlog.errors import nearest

LENGTH = "length"
"""Unit of a figure: the unit of length of the scene, in which its name ends."""
AREA = "squared length"
DISTANCE, DISTANCE_SQUARED = "distance", "squared distance"
"""As length and area on the ground; of boxes in images 1 - IoU, without a unit."""
ANGLE = "angle"
"""px for readings of cameras, mrad for bearings."""
SHARE = "share"
UNITS = ("m", "unit", "ft", "in", "px", "mrad")
"""Units in which names of figures end, and that may be omitted."""


class MetricDefinition(NamedTuple):
    """A figure of an evaluation.

    The marks are letters: `l` it is a line of the summary on the terminal; `s` so it is without the settling time; `e`
    it is shown for each target and sensor, too.
    """

    group: str
    name: str  # without the target or sensor, and without unit
    label: str
    unit: str = ""
    note: str = ""
    marks: str = ""

    def units(self, length: str) -> tuple[str, ...]:
        """Return the units in which its name can end, "" for none; `length` is the unit of length."""
        several = {LENGTH: (length,), AREA: (f"{length}2",), ANGLE: ("px", "mrad"), SHARE: ("",)}
        several |= {DISTANCE: (length, ""), DISTANCE_SQUARED: (f"{length}2", "")}
        return several.get(self.unit, (self.unit,))

    def label_in(self, unit: str) -> str:
        """Return the label of the figure in one of its units."""
        return self.label + (" of 1 - IoU" if self.unit in (DISTANCE, DISTANCE_SQUARED) and not unit else "")


ACCURACY, BOUND, CONSISTENCY = "Accuracy", "Bound", "Consistency"
TARGETS = "Tracking of many targets"
DETECTION, SIGHT, HELD_OUT, VIEWS = (
    "Detection",
    "Lines of sight",
    "Prediction of held-out sensors",
    "Views and true boxes",
)
DOA, COOPERATION = "Directions of arrival", "Requests for camera frames"

METRICS_OF_GROUP: dict[str, tuple[tuple[str, ...], ...]] = {
    TARGETS: (
        ("hota", "HOTA", "", "geometric mean of detection and association, over thresholds of similarity", "le"),
        ("deta", "DetA", "", "detection part of HOTA", "le"),
        ("assa", "AssA", "", "association part of HOTA", "le"),
        ("loca", "LocA", "", "mean similarity of the matches", "le"),
        ("idf1", "IDF1", "", "share of rows with the right identity", "le"),
        ("mota", "MOTA", "", "1 - (missed + false + switches) / true rows", "le"),
        ("id_switches", "identity switches", "", "", "le"),
        ("fragmentations", "fragmentations", "", "times that a target is tracked again after a gap", "le"),
        ("recall", "recall", SHARE, "true rows with a track", "le"),
        ("precision", "precision", SHARE, "rows of tracks with a target", "le"),
        ("matched_rmse", "RMSE, matching per frame", LENGTH, "within the gate", "le"),
        ("matched_error_median", "median error, matching per frame", LENGTH, "", "e"),
        ("matched_error_p95", "95 % of these errors below", LENGTH, "", "e"),
        ("matched_gate", "gate of a match", LENGTH, "", "le"),
        ("matched_nees_mean", "mean NEES, matching per frame", "", "2 where covariances are right", "le"),
        ("matched_nees_share_95", "inside the 95 % ellipse", SHARE, "95 where covariances are right", "le"),
        ("gospa", "mean GOSPA", DISTANCE, "", "le"),
        ("tgospa", "trajectory GOSPA", LENGTH, "", "le"),
        ("ospa2", "OSPA(2)", LENGTH, "", "le"),
        ("ospa2_localisation", "OSPA(2), localisation", LENGTH, ""),
        ("ospa2_cardinality", "OSPA(2), cardinality", LENGTH, ""),
        ("ospa2_window", "OSPA(2), mean over windows", LENGTH, "", "l"),
        ("gospa_localisation", "mean GOSPA, localisation", DISTANCE_SQUARED, ""),
        ("gospa_missed", "mean GOSPA, missed", DISTANCE_SQUARED, ""),
        ("gospa_false", "mean GOSPA, false", DISTANCE_SQUARED, ""),
        ("tgospa_localisation", "trajectory GOSPA, localisation", AREA, ""),
        ("tgospa_missed", "trajectory GOSPA, missed", AREA, ""),
        ("tgospa_false", "trajectory GOSPA, false", AREA, ""),
        ("tgospa_switch", "trajectory GOSPA, switches", AREA, ""),
        ("detre", "DetRe", "", "recall of the detection part of HOTA"),
        ("detpr", "DetPr", "", "precision of the detection part of HOTA"),
        ("assre", "AssRe", "", "recall of the association part of HOTA"),
        ("asspr", "AssPr", "", "precision of the association part of HOTA"),
        ("idr", "identity recall", SHARE, "true rows with the right identity"),
        ("idp", "identity precision", SHARE, "rows of tracks with the right identity"),
        ("idf1_across_views", "IDF1 across views", "", "identities that are those of all views", "l"),
        ("idr_across_views", "identity recall across views", SHARE, ""),
        ("idp_across_views", "identity precision across views", SHARE, ""),
        ("idtp", "rows with the right identity"),
        ("idfp", "rows without the right identity"),
        ("idfn", "true rows without the right identity"),
        ("tp", "matched rows"),
        ("fp", "false rows", "", "", "l"),
        ("fn", "missed rows", "", "", "l"),
        ("motp", "MOTP", DISTANCE, "mean distance of the pairs", "l"),
        ("motp_iou", "mean IoU of the pairs"),
        ("moda", "MODA", "", "1 - (missed + false) / true rows", "l"),
        ("modp", "MODP", "", "1 is the best possible", "l"),
        ("moda_missed", "missed rows of MODA"),
        ("moda_false", "false rows of MODA"),
        ("fr_p", "FR_p", SHARE, "targets without a tracker on them", "l"),
        ("fr_l", "FR_l", SHARE, "trackers on another target than their own", "l"),
        ("position_failures", "targets without a tracker", "", "numerator of FR_p"),
        ("label_failures", "trackers on another target", "", "numerator of FR_l"),
        ("mostly_tracked", "targets mostly tracked", "", "", "l"),
        ("partly_tracked", "targets partly tracked", "", "", "l"),
        ("mostly_lost", "targets mostly lost", "", "", "l"),
        ("count_targets_mean", "targets at a time, true", "", "mean", "l"),
        ("count_tracks_mean", "tracks at a time", "", "mean", "l"),
        ("count_error_mean", "difference in number, mean"),
        ("count_error_rms", "difference in number, RMS", "", "", "l"),
        ("count_error_max", "difference in number, largest"),
        ("matched_nees_compared", "rows with a NEES"),
        ("objects", "true rows", "", "", "l"),
        ("objects_interpolated", "true rows, interpolated", "", "", "l"),
        ("tracks_interpolated", "track rows, interpolated", "", "", "l"),
        ("objects_ignored", "true rows that do not count"),
        ("overlap", "overlap from which boxes match"),
        ("estimates_compared", "rows compared"),
        ("estimates_other_frames", "rows in frames without truth", "", "", "l"),
        ("frames", "frames", "", "", "l"),
        ("frames_without_tracks", "frames without tracks"),
        ("views_without_tracks", "views without tracks"),
    ),
    ACCURACY: (
        ("rmse", "RMSE", LENGTH, "root mean square distance between estimate and truth", "lse"),
        ("rmse_x", "RMSE along x", LENGTH, "root mean square error along one axis", "le"),
        ("rmse_y", "RMSE along y", LENGTH, "root mean square error along one axis", "le"),
        ("error_mean", "mean error", LENGTH, "mean distance between estimate and truth", "le"),
        ("error_median", "median error", LENGTH, "half of the estimates are nearer than this", "le"),
        ("error_p95", "95 % of errors below", LENGTH, "", "le"),
        ("error_max", "largest error", LENGTH, "", "le"),
        ("bias_x", "bias along x", LENGTH, "mean of estimate minus truth", "e"),
        ("bias_y", "bias along y", LENGTH, "mean of estimate minus truth", "e"),
        ("rmse_space", "RMSE in space", LENGTH, "root mean square distance in space", "lse"),
        ("rmse_z", "RMSE along z", LENGTH, "root mean square error of the height", "le"),
        ("error_space_mean", "mean error in space", LENGTH, "mean distance in space", "e"),
        ("error_space_median", "median error in space", LENGTH, "", "le"),
        ("error_space_p95", "95 % of errors in space below", LENGTH, "", "le"),
        ("error_space_max", "largest error in space", LENGTH, "", "e"),
        ("bias_z", "bias along z", LENGTH, "mean of estimate minus truth", "e"),
        ("estimates_space", "estimates in space", "", "with a height and a true height", "l"),
        ("estimates", "estimates", "", "compared with the truth", "lse"),
        ("estimates_interpolated_truth", "truth interpolated", "", "between its own times", "l"),
        ("estimates_without_truth", "estimates without truth", "", "no truth near enough in time", "le"),
        ("estimates_unmatched", "estimates of no target", "", "their track belongs to no true target", "le"),
        ("tracks", "tracks", "", "", "e"),
        ("tracks_smoothed", "tracks smoothed", "", "1: estimated with later measurements"),
        ("tracks_unmatched", "tracks of no target", "", "", "e"),
        ("targets", "true targets", "", "", "e"),
        ("targets_unmatched", "true targets without track", "", "", "e"),
        ("time_coverage", "time covered", SHARE, "of the targets' true path", "le"),
    ),
    BOUND: (
        ("bound_rmse", "bound on the RMSE", LENGTH, "posterior Cramér–Rao bound for the true visibility", "lse"),
        ("bound_ratio", "RMSE / bound", "", "1 is the best possible", "lse"),
        ("smoothed_bound_rmse", "bound of smoothing", LENGTH, "with everything known that was seen later, too", "lse"),
        ("smoothed_bound_ratio", "RMSE / bound of smoothing", "", "1 is the best possible of all estimates", "lse"),
        ("bound_rmse_space", "bound on the RMSE in space", LENGTH, "posterior Cramér–Rao bound", "lse"),
        ("bound_ratio_space", "RMSE / bound in space", "", "1 is the best possible", "lse"),
        ("smoothed_bound_rmse_space", "bound of smoothing in space", LENGTH, "", "le"),
        ("smoothed_bound_ratio_space", "RMSE / bound of smoothing in space", "", "", "le"),
        ("smoothed_bound_rmse_z", "bound of smoothing along z", LENGTH, ""),
        ("bound_rmse_z", "bound on the RMSE along z", LENGTH, "", "l"),
        ("bound_estimates", "times compared", "", "that have both an error and a bound", "e"),
    ),
    CONSISTENCY: (
        ("nees_mean", "mean NEES", "", "normalised squared error; 2 where the filter's covariance is right", "le"),
        ("nees_share_95", "inside the 95 % ellipse", SHARE, "95 where the filter's covariance is right", "le"),
        ("nees_singular", "singular covariances"),
        ("nees_space_mean", "mean NEES in space", "", "3 where the filter's covariance is right", "le"),
        ("nees_space_share_95", "inside the 95 % ellipsoid", SHARE, "95 where the filter's covariance is right", "le"),
        ("nees_space_singular", "singular covariances in space"),
    ),
    DETECTION: (
        ("detection_rate", "detected of visible", SHARE, "visible targets that were seen where they are", "le"),
        ("false_alarms_per_frame", "false alarms a frame", "", "", "le"),
        ("detection_frames", "frames"),
        ("detection_opportunities", "detection opportunities", "", "a frame of a sensor, for each target", "e"),
        ("detection_opportunities_without_truth", "opportunities without truth"),
        ("visible", "target visible", "", "in view and not hidden, by the truth", "e"),
        ("detected", "detected", "", "visible, and seen where it is", "le"),
        ("missed", "missed", "", "visible, but not seen where it is", "le"),
        ("detected_hidden", "detected though hidden"),
        ("correct_rejections", "rightly not seen", "", "", "l"),
        ("false_alarms", "false alarms", "", "seen where no target is", "le"),
        ("bearing_rms", "RMS bearing error", ANGLE, "", "le"),
        ("bearing_bias", "mean bearing error", "px", "", "le"),
        ("bearing_nis", "squared error / variance", "", "1 where the stated noise is right", "e"),
        ("elevation_rms", "RMS elevation error", "mrad", "", "l"),
        ("elevation_nis", "squared elevation error / variance", "", "1 where the stated noise is right"),
        ("bearings_unmatched", "bearings of no target", "", "labelled with a target that the truth has not", "e"),
    ),
    SIGHT: (
        ("triangulation_distance_rms", "RMS distance", LENGTH, "of the track from where the lines of sight meet", "e"),
        ("triangulation_distance_median", "median distance", LENGTH, "", "le"),
        ("triangulation_distance_p95", "95 % of distances below", LENGTH, "", "le"),
        ("triangulation_distance_max", "largest distance", LENGTH, "", "le"),
        ("triangulation_share_within", "within the limit", SHARE, "distances up to the limit that was asked for", "le"),
        ("triangulation_sigma_median", "uncertainty of the meeting point", LENGTH, "median standard deviation", "e"),
        (
            "triangulation_residual_rms",
            "RMS miss of the lines of sight",
            "mrad",
            "from their triangulated position",
            "le",
        ),
        ("triangulation_scans", "scans", "", "with lines of sight from enough sensors", "e"),
        (
            "triangulation_refused",
            "scans without meeting point",
            "",
            "lines of sight nearly parallel, or that do not meet",
            "le",
        ),
        ("triangulation_compared", "scans compared", "", "during the track", "le"),
        (
            "measurement_noise_scale",
            "noise required / stated",
            "",
            "factor on standard deviations, from three lines and more",
            "le",
        ),
        ("measurement_noise", "noise required", "px", "median", "e"),
        ("measurement_noise_scans", "scans with three lines or more", "", "", "l"),
    ),
    HELD_OUT: (
        (
            "held_out_median",
            "median miss",
            ANGLE,
            "of the nearest reported bearing; the track was made without it",
            "le",
        ),
        ("held_out_median_chance", "median miss by chance", "px", "with frames and predictions shifted in time", "le"),
        ("held_out_p95", "95 % of misses below", "px", "", "le"),
        ("held_out_rms", "RMS miss", ANGLE, "", "le"),
        ("held_out_rms_within", "RMS miss inside the gate", "px", "", "e"),
        ("held_out_bias", "mean miss", "px", ""),
        (
            "held_out_share_within",
            "inside the gate",
            SHARE,
            "of the frames in which the target should be in view",
            "le",
        ),
        ("held_out_share_within_chance", "inside the gate by chance", SHARE, "", "le"),
        ("held_out_frames", "frames", "", "in which the track is in view", "le"),
        ("held_out_reported", "frames with a bearing"),
        ("held_out_boxes_share", "boxes predicted", SHARE, "", "l"),
        ("held_out_boxes_share_chance", "boxes predicted by chance", SHARE, "", "l"),
        ("held_out_boxes_feet_share", "boxes predicted by their feet", SHARE, "", "l"),
        ("held_out_boxes_precision", "expected people with a box", SHARE, "", "l"),
        ("held_out_boxes_median", "median distance of the boxes", "px", "", "l"),
        ("held_out_boxes", "boxes", "", "", "l"),
    ),
    VIEWS: (
        ("views_recall", "recall", SHARE, "true boxes that a view was found for", "le"),
        ("views_precision", "precision", SHARE, "views that are of a true box", "le"),
        ("views_error_rms", "RMS horizontal error", "px", "", "le"),
        ("views_error_median", "median horizontal error", "px", "", "e"),
        ("views_error_bias", "mean horizontal error", "px", "", "e"),
        ("views_frames", "frames"),
        ("views_true_boxes", "true boxes", "", "", "e"),
        ("views_matched", "views of a true box"),
        ("views_false", "other views"),
        ("views_without_truth", "views in frames without truth", "", "", "e"),
    ),
    DOA: (
        ("doa_recall", "recall", SHARE, "true directions that were found"),
        ("doa_precision", "precision", SHARE, "directions that are of a true source"),
        ("doa_hits_rms", "RMS error within the gate", "deg"),
        ("doa_hits_bias", "mean error within the gate", "deg"),
        ("doa_error_median", "median error", "deg"),
        ("doa_error_p90", "90 % of errors below", "deg"),
        ("doa_error_max", "largest error", "deg"),
        ("doa_gate", "gate", "deg"),
        ("doa_true", "true directions"),
        ("doa_found", "directions found"),
        ("doa_hits", "directions found within the gate"),
        ("doa_missed", "missed"),
        ("doa_false", "false alarms"),
        ("doa_sets", "sets of directions compared"),
        ("doa_sets_without_truth", "sets without truth"),
    ),
    COOPERATION: (
        ("cooperation_requests", "requests", "", "", "l"),
        ("cooperation_answered", "answered", "", "", "l"),
        ("cooperation_shared", "shared positions", "", "", "l"),
        ("cooperation_frames", "frames asked for", "", "", "l"),
        ("cooperation_period", "mean time between requests", "s", "", "l"),
        ("cooperation_requests_periodic", "requests by the period", "", "", "l"),
        ("cooperation_requests_count", "requests by the number of bearings", "", "", "l"),
        ("cooperation_requests_bearing", "requests by the bearing", "", "", "l"),
        ("cooperation_requests_ellipse", "requests by the ellipse", "", "", "l"),
        ("cooperation_requests_spread", "requests by the spread", "", "", "l"),
    ),
}
"""Figures of each group: name, label, unit, note and marks, as of `MetricDefinition`."""
METRICS = tuple(MetricDefinition(group, *row) for group, rows in METRICS_OF_GROUP.items() for row in rows)
OTHER_NAMES = (
    "max_gap_s noise_at_known_positions noise_at_known_positions_error noise_at_known_positions_readings "
    "tracks_independent_ids tracks_on_distractors"
)
"""Figures that the groups do not contain."""
FIGURES = frozenset((*(metric.name for metric in METRICS), *OTHER_NAMES.split()))
"""Names without unit, and without the sensor, target or recording that a figure is of."""
OWN_ENDINGS = ("views_", "cooperation_requests_", "doa_of_")
"""Prefixes of names with ends that come from the data: classes of boxes, causes of requests, numbers of sources."""
BOXES = {"clear": "in the clear", "front": "in front of other people", "hidden": "partly hidden"}
"""Kinds of true boxes, for which figures of views stand apart."""
SETTLED = "settled_"
"""Prefix of figures without the settling time."""
_OF = re.compile(r"_(sensor|target|recording)_.+$")


def summary_rows(length: str) -> Iterator[tuple[str, str, str, str]]:
    """Generate the group, full name, label and unit of each line of the summary; `length` is the unit of length."""
    for prefix, mark, after in (("", "l", ""), (SETTLED, "s", ", after the start")):
        for metric in METRICS:
            if mark in metric.marks:
                for unit in metric.units(length):
                    end = f"_{unit}" if unit else ""
                    yield metric.group + after, f"{prefix}{metric.name}{end}", metric.label_in(unit), unit
                    for kind, where in BOXES.items() if metric.group == VIEWS else ():
                        yield metric.group, f"{metric.name}_{kind}{end}", f"{metric.label}, {where}", unit


def unknown_metric_hint(name: str, more: Collection[str] = ()) -> str | None:
    """Return a hint with the most similar names if a metric name is unknown; None if it is known.

    The name may have or lack its unit, and the suffix of a sensor, target or recording. `more`: additional known names.
    """
    if name in more or any(f"{name}_{unit}" in more for unit in UNITS):
        return None
    base = _OF.sub("", name.removeprefix("settled_"))
    endings = (base, *(base.removesuffix(f"_{unit}{power}") for unit in (*UNITS, "deg", "s") for power in ("", "2")))
    if FIGURES.intersection(endings) or base.startswith(OWN_ENDINGS):
        return None
    known = (*more, *FIGURES)
    renamed = next((new for name in endings if (new := nearest(name, known, cutoff=1.0))), None)
    near = renamed or nearest(base, known, n=3, cutoff=0.5)
    return f"did you mean {' or '.join(near)}?" if near else "docs/reference/evaluate.md names them"
