"""What a person reads of the figures of many targets; see `evaluate_text`."""

from __future__ import annotations

GROUP = ("many targets", (
    ("fr_p", "targets without a tracker, FR_p", ""), ("fr_l", "trackers on another target, FR_l", ""),
    ("mota", "MOTA", ""), ("motp", "mean 1 - IoU of the pairs, MOTP", ""),
    ("motp", "mean distance of the pairs, MOTP", "length"), ("idf1", "IDF1", ""),
    ("idf1_across_views", "IDF1 across views", ""), ("hota", "HOTA", ""), ("deta", "  detection, DetA", ""),
    ("assa", "  association, AssA", ""), ("loca", "  localisation, LocA", ""),
    ("gospa", "mean GOSPA of 1 - IoU", ""), ("gospa", "mean GOSPA", "length"),
    ("recall", "recall", ""), ("precision", "precision", ""), ("fp", "false", ""), ("fn", "missed", ""),
    ("id_switches", "identity switches", ""), ("fragmentations", "fragmentations", ""),
    ("mostly_tracked", "targets mostly tracked", ""), ("partly_tracked", "  partly", ""),
    ("mostly_lost", "  mostly lost", ""), ("objects", "true rows", ""), ("frames", "frames", ""),
    ("estimates_other_frames", "left out: rows in other frames", ""),
))  # fmt: skip
BY_SENSOR = (
    ("fr_p", "FR_p", ""), ("fr_l", "FR_l", ""), ("mota", "MOTA", ""), ("idf1", "IDF1", ""), ("hota", "HOTA", ""),
    ("objects", "true rows", ""),
)  # fmt: skip
