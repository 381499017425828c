"""Methods that track in images: the settings of each, with defaults that were measured to work.

All methods are one scheme (`occlog.track.methods.images.methods.step`), and the class of a method's settings
composes it: a part of the scheme is on where the class derives from the class of that part's settings.

    part                                               class of settings   mipf  idmot  cmct  bmct  mcmc
    motion, local likelihood, regions, ends            MipfConfig           x      x     x     x     x
    interaction of trackers that touch                 IdmotConfig                 x           x
    loop check of the views                            LoopCheckConfig                   x     x
    proposal on epipolar lines, colours that adapt     CmctConfig                        x
    collaboration of the views, restart on a line      BmctConfig                              x
    samples of all targets of a view together          McmcConfig                                    x

Lengths are pixels, times are frames.  A setting that a method does not have is refused.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting

ABOVE_0: dict[str, float] = {"above": 0.0, "at_most": 1e4}
"""Limits of settings that are lengths, or factors of lengths."""
AT_LEAST_0: dict[str, float] = {"at_least": 0.0, "at_most": 1e4}
SHARE: dict[str, float] = {"at_least": 0.0, "at_most": 1.0}
TURNS: dict[str, float] = {"at_least": 1, "at_most": 1000}
"""Limits of settings that are numbers of iterations."""
ANCHORS = ("centre", "bottom")


@dataclass(frozen=True)
class MipfConfig(Settings):
    """Settings of method `mipf`: an independent particle filter for each target and view."""

    OWNER: ClassVar[str] = "mipf"

    particles: int = option_setting(
        60,
        "Particles per target and view. More reduce the Monte Carlo error and take time in proportion.",
        at_least=1,
    )

    # Motion of an ellipse; `moved` of `occlog.track.methods.images.kernels.motion`
    sigma_px: float = setting(
        3.0,
        "Process noise of the ellipse centre per axis and frame. Raise it for fast targets or low frame rates.",
        unit="px",
        **ABOVE_0,
    )
    keep_velocity: float = setting(
        0.85, "Velocity smoothing: weight of the previous velocity; the rest comes from the last displacement.", **SHARE
    )
    keep_axes: float = setting(
        0.9, "Share of a size change (half axes) that persists; the rest reverts to the initial size.", **SHARE
    )
    sigma_axes_px: float = setting(0.3, "Process noise of the half axes per frame.", unit="px", **AT_LEAST_0)
    axes_limit: float = setting(
        0.15, "Largest change of a half axis relative to its initial value.", at_least=0, below=1
    )
    sigma_rho: float = setting(0.05, "Process noise of the orientation per frame.", unit="rad", **AT_LEAST_0)
    keep_rho: float = setting(
        0.9,
        "Autoregressive coefficient per frame of the deviation from the initial orientation. Smaller values "
        "return to it faster.",
        **SHARE,
    )

    # Local likelihood
    sigma_colour: float = setting(
        0.1,
        "Width of the colour likelihood exp(-(1 - BC) / (2 sigma^2)). Smaller values discriminate more and lose "
        "targets when the light changes.",
        **ABOVE_0,
    )
    halves: float = setting(
        1.5,
        "Targets taller than this ratio of height to width have a colour histogram for each half; 0: never.",
        at_least=0,
    )
    pixel_step: int = setting(2, "Subsampling: use each n-th pixel and row.", at_least=1)
    model: str = setting(
        "colour",
        "Appearance model: `colour` histograms, or `pca` of grey patches in addition.",
        choices=("colour", "pca"),
    )
    pca_power: float = setting(1.0, "Exponent of the `pca` likelihood.", **AT_LEAST_0)

    # With the regions of a detector
    region_reach: float = setting(
        0.6,
        "Assign a region to a tracker if each is the only one within this multiple of the sum of their radii of the "
        "other. Larger values assign distant regions, but fewer of those that are close together.",
        **ABOVE_0,
    )
    region_share: float = setting(
        0.3,
        "Share of the particles that a tracker draws around its associated foreground region. Larger values follow the "
        "region, smaller ones the motion model.",
        **SHARE,
    )
    region_spread: float = setting(
        0.1,
        "Standard deviation of the particles drawn around the foreground region, relative to the radius of the target.",
        **ABOVE_0,
    )
    region_pull: float = setting(
        0.25,
        "Standard deviation of the distance from the region, relative to the radius. Smaller values pull trackers "
        "to their regions.",
        **ABOVE_0,
    )
    region_axes: float = setting(
        0.2, "Learning rate of the reference size (half axes at the start) from regions.", **SHARE
    )

    # When a tracker ends
    lost_similarity: float = setting(
        0.6,
        "Colour similarity below which the best particle is not on its target. Higher values terminate trackers "
        "sooner.",
        **SHARE,
    )
    max_lost_frames: int = setting(
        25, "Terminate a tracker after this many consecutive frames below lost_similarity; 0: never.", at_least=0
    )


@dataclass(frozen=True)
class IdmotConfig(MipfConfig):
    """Settings of method `idmot`: touching trackers of a view repel each other and keep their direction of motion."""

    OWNER: ClassVar[str] = "idmot"

    interaction_distance: float = setting(
        1.0, "Trackers interact when nearer than this multiple of the sum of their radii.", **ABOVE_0
    )
    alpha: float = setting(1.2, "Normalisation alpha of the repulsion ([Qu] Eq. 8).", at_least=1)
    repulsion: float = setting(
        0.6,
        "Range of the repulsion relative to the mean radius ([Qu] Eq. 8). Larger values keep interacting trackers "
        "further apart.",
        **ABOVE_0,
    )
    iterations: int = setting(4, "Iterations K of the interaction.", at_least=0, at_most=1000)
    inertia: float = setting(
        5.0,
        "Weight of the motion similarity of a particle, to the target's motion before, while trackers interact. Larger "
        "values keep trackers apart when targets cross; 0: off.",
        at_least=0,
    )
    inertia_angle: float = setting(0.6, "Angular tolerance of the motion similarity.", unit="rad", **ABOVE_0)
    inertia_speed: float = setting(2.0, "Speed tolerance of the motion similarity per frame.", unit="px", **ABOVE_0)
    memory: int = setting(8, "Number of displacements averaged for the reference motion.", **TURNS)
    frozen: float = setting(
        0.1,
        "Learning rate of the reference motion while the tracker overlaps others. "
        "Smaller values trust the motion before the overlap.",
        **SHARE,
    )


@dataclass(frozen=True)
class LoopCheckConfig(MipfConfig):
    """Settings of methods that check trackers of a target in several views by epipolar lines ([Qu]'s loop check)."""

    ALONE: ClassVar[str]
    """What the method does where no other view can help."""

    anchor: str = setting(
        "centre", "Point of the ellipse used for epipolar lines: `centre`, or `bottom` for people.", choices=ANCHORS
    )
    bad_after: int = setting(
        15, "Consecutive failed loop checks after which a counterpart in another view is dropped.", at_least=1
    )
    good_after: int = setting(5, "Consecutive passed loop checks after which it is restored.", at_least=1)

    @property
    def bottom(self) -> bool:
        """Return whether an ellipse is represented by its lowest point, rather than its centre."""
        return self.anchor == "bottom"


@dataclass(frozen=True)
class BmctConfig(LoopCheckConfig, IdmotConfig):
    """Settings of method `bmct` of [Qu]: the other views help trackers that are close to others of their view."""

    OWNER: ClassVar[str] = "bmct"
    ALONE: ClassVar[str] = "does what idmot does"

    collaboration_distance: float = setting(
        1.5, "Other views assist trackers nearer to each other than this multiple of the sum of their radii."
    )
    epipolar_band: float = setting(0.3, "Width of the epipolar band relative to the radius ([Qu] Eq. 5).", **ABOVE_0)
    clear_distance: float = setting(
        1.5,
        "The tracker of the target in another view assists only if it is farther from other trackers than this "
        "multiple "
        "of the sum of radii, or farther than the assisted tracker is from its own neighbours. 0: always.",
        at_least=0,
    )
    sweeps: int = setting(2, "Sweeps over views for targets that are close to others in all views.", **TURNS)
    restart: bool = setting(
        True,
        "Restart a tracker that fails the loop check over several views: search along the epipolar line, if it "
        "overlaps another tracker or no foreground.",
    )
    restart_similarity: float = setting(0.85, "Minimum colour similarity for a restart.", **SHARE)

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate the rule that collaboration_distance is not below interaction_distance: (setting, holds, limit)."""
        yield (
            "collaboration_distance",
            self.collaboration_distance >= self.interaction_distance,
            f"at least touch ({self.interaction_distance:g})",
        )


@dataclass(frozen=True)
class CmctConfig(LoopCheckConfig):
    """Settings of method `cmct`: particles are drawn on the epipolar lines of other views, and colours adapt.

    Trackers of one view do not interact.
    """

    OWNER: ClassVar[str] = "cmct"
    ALONE: ClassVar[str] = "does what mipf does, with colours that adapt"

    particles: int = option_setting(100, "Particles of each target in each view.", at_least=1)
    epipolar_fraction: float = setting(0.3, "Share of the particles drawn on the epipolar line.", **SHARE)
    sigma_along_line_px: float = setting(
        8.0,
        "Standard deviation, along the epipolar line, of the particles drawn on it; their mean is at the tracker.",
        unit="px",
        **ABOVE_0,
    )
    sigma_across_line: float = setting(
        0.5,
        "Standard deviation, across the epipolar line, of the particles drawn on it, relative to the radius.",
        **ABOVE_0,
    )
    appearance_learning_rate: float = setting(
        0.1,
        "Learning rate of the target's colours. Larger values follow changes of light and drift to the background.",
        **SHARE,
    )
    min_similarity_to_adapt: float = setting(0.9, "Minimum similarity of an estimate for the colour update.", **SHARE)
    max_similarity_to_search: float = setting(
        0.7, "Draw all particles on the line after an estimate of less similarity.", **SHARE
    )


@dataclass(frozen=True)
class McmcConfig(MipfConfig):
    """Settings of method `mcmc`: a joint filter for each view: a sample contains all of its targets."""

    OWNER: ClassVar[str] = "mcmc"

    particles: int = option_setting(500, "Samples of the joint state of a view.", at_least=1)
    sampler: str = setting(
        "mcmc", "Sampler: `mcmc` moves one target at a time, `sir` weights joint samples.", choices=("mcmc", "sir")
    )
    burn_in: float = setting(
        0.25, "Burn-in: moves of the chain before its first sample, relative to `particles`.", at_least=0, at_most=1000
    )
    thin: int = setting(1, "Moves per kept sample.", **TURNS)
    overlap_penalty: float = setting(
        2.0,
        "Penalty of overlapping targets: the density of two coinciding targets is multiplied by exp(-penalty).",
        at_least=0,
        at_most=1000,
    )


CONFIGS: dict[str, type[MipfConfig]] = {
    c.OWNER: c for c in (MipfConfig, IdmotConfig, CmctConfig, BmctConfig, McmcConfig)
}
"""Settings of each method, by the names that `--method` takes."""
