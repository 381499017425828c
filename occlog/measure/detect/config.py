"""Settings of `occlog detect`, and the constants that its provenance records with them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting

AUTO, NETWORK, BACKGROUND, OUTLINES, COMPONENTS = "auto", "network", "background", "outlines", "components"
"""Methods: the network of occlog, background subtraction with three ways to split the foreground, or a choice."""
OF_BOXES = ("bit_depth", "sigma_px", "sigma_scale", "min_confidence")
"""Settings of detection that apply to boxes of networks and plug-ins."""
OF_BACKGROUND = (
    *("background", "history", "foreground_threshold", "shadows", "warmup", "downscale", "person_height"),
    *("person_height_px", "min_similarity", "feedback_gate"),
)
"""Settings of detection that apply to background subtraction alone."""
N_PROBED = 24
"""Frames of a camera, evenly spread, by which `auto` compares network and background."""
MIN_MOVING = 3
"""Minimum number of them with a moving region of the size of a person."""
MIN_PERSON = 0.5
"""Smallest such region, in pixels of a person in full view."""
MIN_FOUND_RATIO = 0.1
"""Frames with people by the network over frames with such regions, below which background subtraction is used."""
CLEAN_PX = 5
"""Side of the median filter on the foreground [px]."""
MAX_FOREGROUND = 0.6
"""Share of foreground above which a frame cannot be used: the light changed, or the camera moved."""
STRENGTH = 2.0
"""Weight of the prior on a cluster's shape, in pixels of a person in full view."""
PENALTY = 0.1
"""Cost of one more cluster, in pixels of a person in full view."""
MIN_CLUSTER_RATIO = 0.2
"""Smallest cluster, in pixels of a person in full view."""
MAX_CLUSTER_RATIO = 5.0
"""Largest cluster that can be a target, in pixels of a person in full view."""
GLOBAL, CAMERA = "global", "camera"
"""Scope of box identities: one person in all cameras, or a track in one camera."""
LONE_TARGET_ID = 0
"""Identity of the one target when no appearance is known."""
CONTINUITY_BONUS = 0.05
"""Similarity that it is worth to be where the target was last seen."""
MEMORY_S = 1.0
"""Time for which a position where the target was last seen counts [s]."""
BATCH = 32
"""Frames read ahead at a time, of all cameras together."""


@dataclass(frozen=True)
class DetectConfig(Settings):
    """Settings of detection; lengths in the scene's unit unless their name states px."""

    OWNER: ClassVar[str] = "detect"

    method: str = option_setting(
        AUTO,
        "The person network of occlog (`network`), or background subtraction with regions by a mixture of "
        "person-shaped Gaussians (`background`), the same with outlines of people where several touch (`outlines`), or "
        "connected blobs (`components`). `auto`: the network; background subtraction in simulated recordings, for "
        "targets of known appearance, with an option of it, and where people move that the network misses.",
        choices=(AUTO, NETWORK, BACKGROUND, OUTLINES, COMPONENTS),
    )
    background: str = option_setting("mog2", "Background model of OpenCV.", choices=("mog2", "knn"))
    history: int = option_setting(
        500,
        "Memory of the background model in frames. A person who stands still for a tenth of it fades into the "
        "background.",
        at_least=1,
        metavar="FRAMES",
    )
    foreground_threshold: float | None = option_setting(
        None,
        "Foreground threshold, in the measure of the background model. Lower values detect people of low contrast "
        "and more noise.",
        above=0,
        nothing="the model's own",
    )
    shadows: bool = setting(
        True, "Detect shadows and leave them out of the foreground.", option="--shadows/--no-shadows"
    )
    warmup: int = option_setting(
        50,
        "With --no-learn-background: number of frames that only train the background model.",
        at_least=0,
        metavar="FRAMES",
    )
    bit_depth: int | None = option_setting(
        None,
        "Significant bits of 16-bit images: 12 for a 12-bit sensor. Larger values darken images, smaller saturate.",
        at_least=8,
        at_most=16,
        nothing="16-bit images are refused",
    )
    downscale: int | None = option_setting(
        None,
        "Downscale images by this factor before detection.",
        at_least=1,
        at_most=16,
        metavar="FACTOR",
        nothing="so that people stay 100 px wide",
    )
    person_height: float | None = option_setting(
        None, "Height of a person, for the expected size of regions.", unit="length", above=0, nothing="1.7 m"
    )
    person_height_px: float | None = option_setting(
        None,
        "Height of a person in pixels, equal everywhere, instead of the one expected from the camera poses. Needed "
        "without a calibration.",
        unit="px",
        above=0,
        nothing="from the poses",
    )
    min_similarity: float = option_setting(
        0.65,
        "Minimum colour similarity (Bhattacharyya coefficient) to the target. Lower values accept more regions.",
        at_least=0,
        at_most=1,
    )
    sigma_px: float | None = option_setting(
        None,
        "Measurement noise: standard deviation of the horizontal centre of an unoccluded person.",
        unit="px",
        above=0,
        nothing="a tenth of its width, and the camera's noise",
    )
    sigma_scale: float = option_setting(
        1.0,
        "Factor on all measurement noise. `occlog evaluate` estimates it from residuals between cameras "
        "(`measurement_noise_scale`).",
        above=0,
    )
    min_confidence: float = option_setting(
        0.3,
        "Minimum confidence of a box of a detector (0.4 by default for the network of occlog). Lower values "
        "detect more people and raise the clutter rate.",
        at_least=0,
        at_most=1,
    )
    feedback_gate: float = option_setting(
        3.0, "Gate in standard deviations about the predicted direction of a target; with --track-feedback.", above=0
    )
    label_scope: str | None = option_setting(
        None,
        f"Scope of box identities, which become target IDs: {GLOBAL} (equal in all cameras) or {CAMERA} (renumbered "
        f"per camera).",
        choices=(GLOBAL, CAMERA),
        nothing="boxes are unlabelled candidates",
    )


def parameters(config: DetectConfig) -> dict[str, object]:
    """Settings and constants that background subtraction depends on by name, for the provenance."""
    return {name: value for name, value in asdict(config).items() if name not in ("label_scope", "feedback_gate")} | {
        "clean_px": CLEAN_PX,
        "max_foreground": MAX_FOREGROUND,
        "strength": STRENGTH,
        "penalty": PENALTY,
        "least": MIN_CLUSTER_RATIO,
        "most": MAX_CLUSTER_RATIO,
        "lone_target_id": LONE_TARGET_ID,
        "margin": CONTINUITY_BONUS,
        "memory_s": MEMORY_S,
        "batch": BATCH,
    }
