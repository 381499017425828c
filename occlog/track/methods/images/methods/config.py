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

from occlog.settings import Settings, setting

ABOVE_0: dict[str, float] = {"above": 0.0, "at_most": 1e4}
"""Of settings that are lengths, or factors of them."""
AT_LEAST_0: dict[str, float] = {"at_least": 0.0, "at_most": 1e4}
SHARE: dict[str, float] = {"at_least": 0.0, "at_most": 1.0}
TURNS: dict[str, float] = {"at_least": 1, "at_most": 1000}
"""Of settings that are numbers of turns of a loop."""
ANCHORS = ("centre", "bottom")


@dataclass(frozen=True)
class MipfConfig(Settings):
    """Settings of method `mipf`: a particle filter for each target and view, on its own."""

    OWNER: ClassVar[str] = "mipf"

    particles: int = setting(60, "Particles of each target in each view.", at_least=1, option="--particles")

    # Motion of an ellipse; `moved` of `occlog.track.methods.images.kernels.motion`
    sigma_px: float = setting(3.0, "Noise of the centre, each axis.", unit="px", **ABOVE_0)
    keep_velocity: float = setting(
        0.85, "Share of the velocity that stays; the rest comes from the last displacement.", **SHARE
    )
    keep_axes: float = setting(0.9, "Share of a change of the half axes that stays.", **SHARE)
    sigma_axes_px: float = setting(0.3, "Noise of the half axes.", unit="px", **AT_LEAST_0)
    axes_limit: float = setting(
        0.15, "Largest change of a half axis, as a share of the one at the start.", at_least=0, below=1
    )
    sigma_rho: float = setting(0.05, "Noise of the angle.", unit="rad", **AT_LEAST_0)
    keep_rho: float = setting(0.9, "Share of a turn from the angle at the start that stays.", **SHARE)

    # Local likelihood
    sigma_colour: float = setting(0.1, "Sigma of exp(-(1 - BC) / (2 sigma^2)).", **ABOVE_0)
    halves: float = setting(
        1.5, "Targets this many times higher than wide have colours for each half; 0: none.", at_least=0
    )
    pixel_step: int = setting(2, "Only each n-th pixel of each n-th row counts.", at_least=1)
    model: str = setting("colour", "Colours, or an appearance model on top of them.", choices=("colour", "pca"))
    pca_power: float = setting(1.0, "Power of the likelihood of `pca`.", **AT_LEAST_0)

    # With the regions of a detector
    region_reach: float = setting(
        0.6, "A tracker has a region to itself nearer than this, in sums of radii.", **ABOVE_0
    )
    region_share: float = setting(0.3, "Share of a tracker's particles that start anew there.", **SHARE)
    region_spread: float = setting(0.1, "Their spread over the radius.", **ABOVE_0)
    region_pull: float = setting(0.25, "Spread of the distance from the region over the radius.", **ABOVE_0)
    region_axes: float = setting(0.2, "How fast the half axes of the start follow those of the region.", **SHARE)

    # When a tracker ends
    lost_likeness: float = setting(0.6, "Below this the best particle's colours are not the target's.", **SHARE)
    lost_after: int = setting(25, "Frames in a row of that after which a tracker ends; 0: never.", at_least=0)


@dataclass(frozen=True)
class IdmotConfig(MipfConfig):
    """Settings of method `idmot`: trackers of a view that touch repel each other and keep their ways."""

    OWNER: ClassVar[str] = "idmot"

    touch: float = setting(1.0, "Trackers touch when nearer than this many times the sum of their radii.", **ABOVE_0)
    alpha: float = setting(1.2, "alpha of [Qu] Eq. 8.", at_least=1)
    repulsion: float = setting(0.6, "Sigma of [Qu] Eq. 8 over the mean radius of the two.", **ABOVE_0)
    iterations: int = setting(4, "K: how often trackers that touch are weighed anew.", at_least=0, at_most=1000)
    inertia: float = setting(5.0, "Weight that a particle gains by moving as its target did; 0: none.", at_least=0)
    inertia_angle: float = setting(0.6, "How near to the target's direction.", unit="rad", **ABOVE_0)
    inertia_speed: float = setting(2.0, "And to its speed a frame.", unit="px", **ABOVE_0)
    memory: int = setting(8, "Displacements that make up how a target moved.", **TURNS)
    frozen: float = setting(0.1, "Share of a displacement that counts while trackers touch.", **SHARE)


@dataclass(frozen=True)
class LoopCheckConfig(MipfConfig):
    """Settings of the methods in which views help each other: epipolar lines, and the check of counterparts by them."""

    ALONE: ClassVar[str]
    """What the method does where no other view can help."""

    anchor: str = setting(
        "centre", "Point of the ellipse whose epipolar line counts; bottom is for people.", choices=ANCHORS
    )
    bad_after: int = setting(15, "Loop checks in a row that fail make a counterpart bad.", at_least=1)
    good_after: int = setting(5, "Loop checks in a row that hold make it good again.", at_least=1)

    @property
    def bottom(self) -> bool:
        """Whether the lowest point of an ellipse represents its target; else its centre."""
        return self.anchor == "bottom"


@dataclass(frozen=True)
class BmctConfig(LoopCheckConfig, IdmotConfig):
    """Settings of method `bmct`: trackers that are close to others are helped by the other views."""

    OWNER: ClassVar[str] = "bmct"
    ALONE: ClassVar[str] = "does what idmot does"

    close: float = setting(1.5, "Trackers are close when nearer than this many times the sum of their radii.")
    band: float = setting(0.3, "Sigma of [Qu] Eq. 5 over the radius.", **ABOVE_0)
    clear: float = setting(
        1.5, "Less clear counterparts (see `close`) help only trackers that are less clear still; 0: all.", at_least=0
    )
    sweeps: int = setting(2, "Sweeps over the views of targets that are close to others in all of them.", **TURNS)
    restart: bool = setting(
        True, "A tracker with bad counterparts that is on another one or on nothing starts again on a line."
    )
    restart_likeness: float = setting(0.85, "It starts where colours are at least this alike.", **SHARE)

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """What touches is close."""
        yield "close", self.close >= self.touch, f"at least touch ({self.touch:g})"


@dataclass(frozen=True)
class CmctConfig(LoopCheckConfig):
    """Settings of method `cmct`: particles are drawn on the epipolar lines, colours adapt, no interaction."""

    OWNER: ClassVar[str] = "cmct"
    ALONE: ClassVar[str] = "does what mipf does, with colours that adapt"

    particles: int = setting(100, "Particles of each target in each view.", at_least=1, option="--particles")
    on_line: float = setting(0.3, "Share of the particles drawn on the epipolar line.", **SHARE)
    along_px: float = setting(8.0, "Their spread along it, about the tracker.", unit="px", **ABOVE_0)
    across: float = setting(0.5, "Their spread across it over the radius.", **ABOVE_0)
    adapt: float = setting(0.1, "How fast the target's colours follow those in the estimate.", **SHARE)
    adapt_above: float = setting(0.9, "Only an estimate at least as alike counts.", **SHARE)
    search_below: float = setting(
        0.7, "After an estimate that is less alike all particles are drawn on the line.", **SHARE
    )


@dataclass(frozen=True)
class McmcConfig(MipfConfig):
    """Settings of method `mcmc`: a filter for each view, whose samples hold all of its targets."""

    OWNER: ClassVar[str] = "mcmc"

    particles: int = setting(500, "Samples of a view, not of a tracker.", at_least=1, option="--particles")
    sampler: str = setting(
        "mcmc", "A Markov chain that moves one target at a time, or weights of whole samples.", choices=("mcmc", "sir")
    )
    burn: float = setting(
        0.25, "Moves of the chain before its first sample, as a share of `particles`.", at_least=0, at_most=1000
    )
    thin: int = setting(1, "Moves of the chain per sample that is kept.", **TURNS)
    overlap: float = setting(
        2.0,
        "Strength of the prior: two targets at one place are exp(-overlap) times as likely.",
        at_least=0,
        at_most=1000,
    )


CONFIGS: dict[str, type[MipfConfig]] = {
    c.OWNER: c for c in (MipfConfig, IdmotConfig, CmctConfig, BmctConfig, McmcConfig)
}
"""Settings of each method, by the names that `--method` takes."""
