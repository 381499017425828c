"""Names of all figures of an evaluation, so that a misspelled one is refused before the work."""

from __future__ import annotations

import re
from collections.abc import Collection

from occlog.errors import nearest

ON_GROUND = """
rmse rmse_x rmse_y rmse_z rmse_space error_mean error_median error_p95 error_max error_space_mean error_space_median
error_space_p95 error_space_max bias_x bias_y bias_z estimates estimates_space estimates_compared
estimates_interpolated_truth estimates_other_frames estimates_unmatched estimates_without_truth tracks tracks_smoothed
tracks_unmatched tracks_on_distractors targets targets_unmatched time_coverage nees_mean nees_share_95 nees_singular
nees_space_mean nees_space_share_95 nees_space_singular bound_rmse bound_ratio bound_estimates bound_rmse_space
bound_ratio_space bound_rmse_z smoothed_bound_rmse smoothed_bound_ratio smoothed_bound_rmse_space
smoothed_bound_ratio_space smoothed_bound_rmse_z
"""
"""Errors on the ground and in space with their bound; with `settled_` before it, after the settling time."""
OF_BEARINGS = """
bearing_bias bearing_nis bearing_rms bearings_unmatched elevation_nis elevation_rms correct_rejections detected
detected_hidden detection_frames detection_opportunities detection_opportunities_without_truth detection_rate
false_alarms false_alarms_per_frame missed visible held_out_bias held_out_frames held_out_median held_out_median_chance
held_out_p95 held_out_reported held_out_rms held_out_rms_within held_out_share_within held_out_share_within_chance
held_out_boxes held_out_boxes_feet_share held_out_boxes_median held_out_boxes_precision held_out_boxes_share
held_out_boxes_share_chance triangulation_compared triangulation_distance_max triangulation_distance_median
triangulation_distance_p95 triangulation_distance_rms triangulation_refused triangulation_residual_rms
triangulation_scans triangulation_share_within triangulation_sigma_median noise_at_known_positions
noise_at_known_positions_error noise_at_known_positions_readings measurement_noise measurement_noise_scale
measurement_noise_scans cooperation_answered cooperation_frames cooperation_period_s cooperation_requests
cooperation_shared
"""
OF_VIEWS = """
views_error_bias views_error_median views_error_rms views_false views_frames views_matched views_precision views_recall
views_true_boxes views_without_tracks views_without_truth
"""
OF_DIRECTIONS = """
doa_error_max_deg doa_error_median_deg doa_error_p90_deg doa_false doa_found doa_gate_deg doa_hits doa_hits_bias_deg
doa_hits_rms_deg doa_missed doa_precision doa_recall doa_sets doa_sets_without_truth doa_true max_gap_s
"""
OF_MANY = """
hota deta assa detpr detre asspr assre loca mota motp motp_iou moda moda_false moda_missed modp id_switches
fragmentations mostly_tracked partly_tracked mostly_lost precision recall tp fp fn idf1 idp idr idtp idfp idfn
idf1_across_views idp_across_views idr_across_views gospa gospa_localisation gospa_missed gospa_false tgospa
tgospa_localisation tgospa_missed tgospa_false tgospa_switch ospa2 ospa2_localisation ospa2_cardinality ospa2_window
matched_rmse matched_error_median matched_error_p95 matched_gate matched_nees_compared matched_nees_mean
matched_nees_share_95 tracks_independent_ids count_error_max count_error_mean count_error_rms count_targets_mean
count_tracks_mean fr_p fr_l position_failures label_failures frames frames_without_tracks objects objects_ignored
objects_interpolated overlap
"""
FIGURES = frozenset((ON_GROUND + OF_BEARINGS + OF_VIEWS + OF_DIRECTIONS + OF_MANY).split())
"""Names without unit, and without that of the sensor, target or recording that a figure is of."""
UNITS = ("m", "unit", "ft", "in", "px", "mrad")
"""Units that end the names of figures and may be left away."""
OWN_ENDINGS = ("views_", "cooperation_requests_", "doa_of_")
"""Prefixes of names with ends that come from the data: classes of boxes, causes of requests, numbers of sources."""
_OF = re.compile(r"_(sensor|target|recording)_.+$")


def unknown_metric_hint(name: str, more: Collection[str] = ()) -> str | None:
    """Return a hint with the most similar names if a metric name is unknown; None if it is known.

    The name may have or lack its unit, and the suffix of a sensor, target or recording. `more`: additional known names.
    """
    if name in more or any(f"{name}_{unit}" in more for unit in UNITS):
        return None
    base = _OF.sub("", name.removeprefix("settled_"))
    endings = (base, *(base.removesuffix(f"_{unit}{power}") for unit in UNITS for power in ("", "2")))
    if FIGURES.intersection(endings) or base.startswith(OWN_ENDINGS):
        return None
    known = (*more, *FIGURES)
    renamed = next((new for name in endings if (new := nearest(name, known, cutoff=1.0))), None)
    near = renamed or nearest(base, known, n=3, cutoff=0.5)
    return f"did you mean {' or '.join(near)}?" if near else "docs/reference/evaluate.md names them"
