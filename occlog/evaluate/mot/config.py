"""Settings of the evaluation of many targets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from occlog.evaluate.matching.config import BRIDGE_S, GROUND, IMAGES, EvaluateConfig
from occlog.settings import Settings, configure, option_setting, setting

MANY = (IMAGES, GROUND)
MAX_POWER = 10.0
"""Largest exponent of distances: of a larger one tenths of a cutoff would vanish in floating-point numbers, ..."""
MIN_LENGTH, MAX_LENGTH = 1e-9, 1e9
"""... and with this one powers of such lengths are far from doing so."""


@dataclass(frozen=True)
class MultiTargetConfig(Settings):
    """Settings of the figures for many targets (MOT metrics), in images and on the ground.

    `assigned_target` decides on which target a track should be ([Qu] Eq. 9): `id`, the one with its identity; `start`,
    the first one that it is on; `optimal`, by the one-to-one assignment with most estimates on their assigned target.
    """

    OWNER: ClassVar[str] = "many targets"

    distance_gate: float = option_setting(
        1.0,
        "Distance gate in the image: a tracker is on a target within this many radii, sqrt(half width x half "
        "height) of the true box ([Qu] tau).",
        above=0,
        metavar="FACTOR",
        kinds=(IMAGES,),
    )
    distance_gate_px: float | None = option_setting(
        None, "Distance gate in pixels, instead of --distance-gate.", above=0, metavar="PX", kinds=(IMAGES,)
    )
    assigned_target: str = option_setting(
        "id",
        "Assigned target of a track: by its identity (`id`), the first one it is on (`start`), or by the best "
        "assignment (`optimal`).",
        choices=("id", "start", "optimal"),
        shown="id; start for MOTChallenge text, boxes, tracks from detections; else optimal with --match optimal",
        kinds=MANY,
    )
    clear_rule: str = option_setting(
        "classic",
        "CLEAR-MOT matching as in py-motmetrics (`classic`) or in TrackEval (`challenge`).",
        choices=("classic", "challenge"),
        kinds=MANY,
    )
    benchmark: str = option_setting(
        "auto",
        "Rules for the classes of a MOTChallenge truth: mot17 (of MOT16 too), mot20, or mot15, which has no classes.",
        choices=("auto", "mot15", "mot17", "mot20"),
        shown="mot17 where the truth is text with a column of classes, which 8 or 9 columns mean; else mot15",
        kinds=(IMAGES,),
    )
    match_iou: float = setting(
        0.5,
        "IoU (intersection over union) at which a track matches a true box; --iou-threshold.",
        above=0,
        at_most=1,
        kinds=(IMAGES,),
    )
    match_distance: float | None = option_setting(
        None,
        "On the ground: match threshold, the largest distance at which a track matches a target.",
        unit="length",
        at_least=MIN_LENGTH,
        at_most=MAX_LENGTH,
        people=1.0,
        shown="1 m",
        kinds=(GROUND,),
    )
    track_gap_s: float | None = setting(
        None,
        "On the ground: maximum gap in time to interpolate in tracks of many targets.",
        at_least=0,
        at_most=1e9,
        option="--track-gap",
        metavar="SECONDS",
        nothing="--max-gap, or 1 s",
        kinds=(GROUND,),
    )
    gospa_cutoff: float | None = option_setting(
        None,
        "Cutoff c of GOSPA: of 1 - IoU for boxes, of the distance on the ground otherwise [m, or scene unit].",
        at_least=MIN_LENGTH,
        at_most=MAX_LENGTH,
        nothing="1 minus --iou-threshold for boxes, else --match-distance",
        kinds=MANY,
    )
    gospa_p: float = option_setting(2.0, "Exponent p of GOSPA.", at_least=1, at_most=MAX_POWER, kinds=MANY)
    gospa_alpha: float = option_setting(2.0, "Parameter alpha of GOSPA.", above=0, at_most=2, kinds=MANY)
    gospa_switch_penalty: float | None = option_setting(
        None,
        "On the ground: switch penalty of trajectory GOSPA, in the unit of the cutoff.",
        unit="length",
        at_least=MIN_LENGTH,
        at_most=MAX_LENGTH,
        nothing="cutoff of GOSPA",
        kinds=(GROUND,),
    )
    ospa_cutoff: float | None = option_setting(
        None,
        "Cutoff c of OSPA(2), on the ground.",
        unit="length",
        at_least=MIN_LENGTH,
        at_most=MAX_LENGTH,
        nothing="--match-distance",
        kinds=(GROUND,),
    )
    ospa_p: float = option_setting(
        1.0, "Exponent p of OSPA(2), on the ground.", at_least=1, at_most=MAX_POWER, kinds=(GROUND,)
    )
    ospa_window: int | None = option_setting(
        None,
        "On the ground: also report OSPA(2) averaged over windows of this many frames.",
        at_least=1,
        metavar="FRAMES",
        kinds=(GROUND,),
    )
    moda_distance: float | None = option_setting(
        None,
        "On the ground: match threshold of MODA and MODP.",
        unit="length",
        at_least=MIN_LENGTH,
        at_most=MAX_LENGTH,
        people=0.5,
        shown="0.5 m; that of --match-distance in a scene-specific unit",
        kinds=(GROUND,),
    )
    gospa_px: float | None = option_setting(
        None,
        "Also report GOSPA of box centres in the image, with this cutoff [px].",
        at_least=MIN_LENGTH,
        at_most=MAX_LENGTH,
        metavar="PX",
        kinds=(IMAGES,),
    )
    cameras: tuple[str, ...] = setting(
        (),
        "For tracks in images: compare this camera only; may be repeated.",
        repeat=True,
        option="--camera",
        metavar="NAME",
        shown="all",
        kinds=(IMAGES,),
    )
    fps: float | None = option_setting(
        None,
        "Frame rate of tables that count frames: true boxes (XML, VATIC, KITTI, MOTChallenge text), positions with a "
        "column frame.",
        above=0,
        at_most=1e6,
        metavar="RATE",
        nothing="that of the tracks, or 25; needed on the ground",
        kinds=(IMAGES, GROUND),
    )
    first_number: int | None = option_setting(
        None, "Number of frame 0 in true boxes in XML.", at_least=0, nothing="0", kinds=(IMAGES,)
    )
    frames: tuple[int, int] | None = setting(
        None, "First frame to compare, and the one after the last.", counts=(2,), kinds=(IMAGES,)
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate the rule (setting, whether it holds, words) that `frames` is a range."""
        if self.frames is not None:
            yield "frames", 0 <= self.frames[0] < self.frames[1], "A:B with 0 <= A < B"

    def gap_ns(self, limit_ns: int | None) -> int:
        """Return the widest gap of tracks that is interpolated [ns].

        `limit_ns`: that of the truth, which is the default; None: unknown, the default is 1 s.
        """
        if self.track_gap_s is not None:
            return round(self.track_gap_s * 1e9)
        return round(BRIDGE_S * 1e9) if limit_ns is None else limit_ns


def own_targets_by(config: EvaluateConfig, *, numbered_itself: bool) -> str:
    """Return the default of `MultiTargetConfig.assigned_target`: `id`, `start` or `optimal`.

    `numbered_itself`: whether the tracker numbers its tracks itself, so that numbers are not those of targets.
    """
    return "id" if config.match == "id" else ("start" if numbered_itself else "optimal")


def many_config(unit: str, own: str, given: Mapping[str, object]) -> tuple[MultiTargetConfig | None, str | None]:
    """Return the settings of multi-target figures on the ground; or None, and the reason (a note) why there are none.

    Args:
        unit: unit of lengths; of an unknown unit a match distance must be given.
        own: default of `assigned_target`.
        given: settings of the user by name.
    """
    many = configure(MultiTargetConfig.in_unit(unit), {"assigned_target": own, **given})
    if many.match_distance is None:
        return None, f"lengths are in {unit}: give --match-distance for the figures of many targets"
    return many, None
