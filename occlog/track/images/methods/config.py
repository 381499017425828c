"""Settings of the methods that track in images, with defaults that were measured to work.

Lengths are pixels, times are frames.  Each method has its own settings; one that a method
does not have is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

from occlog.core.image.ellipse import CLOSE
from occlog.settings import check_settings
from occlog.track.images.kernels.ellipse_colour import SIGMA

MODELS = ("colour", "pca")
ANCHORS = ("centre", "bottom")
LARGEST = 1e4
"""Of settings that are lengths, or factors of them."""
MOST = 1000
"""Of settings that are numbers of turns of a loop."""


def above_0(value: float) -> tuple[bool, str]:
    """Whether a value is above 0 and at most `LARGEST`, and that in words."""
    return 0.0 < value <= LARGEST, f"above 0 and at most {LARGEST:g}"


@dataclass(frozen=True)
class MipfConfig:
    """Settings of method `mipf`: a particle filter for each target and view, on its own."""

    particles: int = 60

    # Motion of an ellipse; `moved` of `occlog.track.images.kernels.motion`
    sigma_px: float = 3.0  # noise of the centre, each axis
    keep_velocity: float = 0.85  # the rest comes from the last displacement
    keep_axes: float = 0.9  # share of a change of the half axes that stays
    sigma_axes_px: float = 0.3
    axes_limit: float = 0.15  # largest change of a half axis, as a share of the one at the start
    sigma_rho: float = 0.05  # noise of the angle [rad]
    keep_rho: float = 0.9  # share of a turn from the angle at the start that stays

    # Local likelihood
    sigma_colour: float = SIGMA  # of exp(-(1 - BC) / (2 sigma^2))
    halves: float = 1.5  # targets this many times higher than wide have colours for each half; 0: none
    pixel_step: int = 2  # only each n-th pixel of each n-th row counts
    model: str = "colour"  # `colour`, or `pca`: an appearance model on top of the colours
    pca_power: float = 1.0  # power of the likelihood of `pca`

    # With the regions of a detector
    region_reach: float = 0.6  # a tracker has a region to itself nearer than this, in sums of radii
    region_share: float = 0.3  # share of its particles that start anew there
    region_spread: float = 0.1  # their spread over the radius
    region_pull: float = 0.25  # spread of the distance from it over the radius
    region_axes: float = 0.2  # how fast the half axes of the start follow its own

    # When a tracker ends
    lost_likeness: float = 0.6  # below this the best particle's colours are not the target's
    lost_after: int = 25  # frames in a row of that; 0: never

    def __post_init__(self) -> None:
        check_settings(self, self.method(), self.limits())

    @classmethod
    def method(cls) -> str:
        """Name of the method that has these settings."""
        return cls.__name__.removesuffix("Config").lower()

    def limits(self) -> list[tuple[str, bool, str]]:
        """Name, whether its limit holds, and the limit, for each setting."""
        above = ("sigma_px", "sigma_colour", "region_reach", "region_spread", "region_pull")
        positive = ("sigma_axes_px", "sigma_rho", "pca_power")
        shares = ("keep_velocity", "keep_axes", "keep_rho", "lost_likeness", "region_share", "region_axes")
        return [
            ("particles", self.particles >= 1, "at least 1"),
            ("axes_limit", 0.0 <= self.axes_limit < 1.0, "at least 0 and below 1"),
            ("pixel_step", self.pixel_step >= 1, "at least 1"),
            ("halves", self.halves >= 0, "at least 0"),
            ("lost_after", self.lost_after >= 0, "at least 0"),
            ("model", self.model in MODELS, f"one of {', '.join(MODELS)}"),
            *((name, *above_0(getattr(self, name))) for name in above),
            *((name, 0.0 <= getattr(self, name) <= 1.0, "0 to 1") for name in shares),
            *((name, 0.0 <= getattr(self, name) <= LARGEST, f"0 to {LARGEST:g}") for name in positive),
        ]


@dataclass(frozen=True)
class IdmotConfig(MipfConfig):
    """Settings of method `idmot`: trackers of a view that touch repel each other and keep their ways."""

    touch: float = 1.0  # trackers touch when nearer than this many times the sum of their radii
    alpha: float = 1.2  # [Qu] Eq. 8
    repulsion: float = 0.6  # Sigma of [Qu] Eq. 8 over the mean radius of the two
    iterations: int = 4  # K
    inertia: float = 5.0  # weight that a particle gains by moving as its target did; 0: none
    inertia_angle: float = 0.6  # how near to its direction [rad]
    inertia_speed: float = 2.0  # and to its speed [px a frame]
    memory: int = 8  # displacements that make up how a target moved
    frozen: float = 0.1  # share of a displacement that counts while touching

    def limits(self) -> list[tuple[str, bool, str]]:
        """See `MipfConfig`."""
        above = ("touch", "repulsion", "inertia_angle", "inertia_speed")
        return [
            *super().limits(),
            ("alpha", self.alpha >= 1.0, "at least 1"),
            ("iterations", 0 <= self.iterations <= MOST, f"0 to {MOST}"),
            ("inertia", self.inertia >= 0, "at least 0"),
            ("memory", 1 <= self.memory <= MOST, f"1 to {MOST}"),
            ("frozen", 0.0 <= self.frozen <= 1.0, "0 to 1"),
            *((name, *above_0(getattr(self, name))) for name in above),
        ]


@dataclass(frozen=True)
class BmctConfig(IdmotConfig):
    """Settings of method `bmct`: trackers that are close to others are helped by the other views."""

    close: float = CLOSE  # trackers are close when nearer than this many times the sum of their radii
    band: float = 0.3  # Sigma of [Qu] Eq. 5 over the radius
    anchor: str = "centre"  # point of the ellipse whose epipolar line counts: `centre`, or `bottom` for people
    clear: float = CLOSE  # less clear counterparts (see `close`) help only trackers that are less clear still; 0: all
    sweeps: int = 2  # over the views of targets that are close to others in all of them
    bad_after: int = 15  # loop checks in a row that fail make a counterpart bad
    good_after: int = 5  # that hold make it good again
    restart: bool = True  # a tracker with bad counterparts that is on another one or on nothing starts again on a line
    restart_likeness: float = 0.85  # where colours are at least this alike

    def limits(self) -> list[tuple[str, bool, str]]:
        """See `MipfConfig`."""
        return [
            *super().limits(),
            ("close", self.close >= self.touch, f"at least touch ({self.touch:g})"),
            ("band", *above_0(self.band)),
            ("sweeps", 1 <= self.sweeps <= MOST, f"1 to {MOST}"),
            ("anchor", self.anchor in ANCHORS, f"one of {', '.join(ANCHORS)}"),
            *((name, getattr(self, name) >= 1, "at least 1") for name in ("bad_after", "good_after")),
            ("clear", self.clear >= 0, "at least 0"),
            ("restart_likeness", 0.0 <= self.restart_likeness <= 1.0, "0 to 1"),
        ]


@dataclass(frozen=True)
class CmctConfig(MipfConfig):
    """Settings of method `cmct`: particles are drawn on the epipolar lines, colours adapt, no interaction."""

    particles: int = 100
    on_line: float = 0.3  # share of the particles drawn on the epipolar line
    along_px: float = 8.0  # their spread along it, about the tracker
    across: float = 0.5  # their spread across it over the radius
    anchor: str = "centre"  # see `BmctConfig`
    adapt: float = 0.1  # how fast the target's colours follow those in the estimate
    adapt_above: float = 0.9  # only an estimate at least as alike counts
    search_below: float = 0.7  # after one less alike all are drawn on the line; see also `cmct.propose_on_lines`
    bad_after: int = 15
    good_after: int = 5

    def limits(self) -> list[tuple[str, bool, str]]:
        """See `MipfConfig`."""
        shares = ("on_line", "adapt", "adapt_above", "search_below")
        return [
            *super().limits(),
            ("anchor", self.anchor in ANCHORS, f"one of {', '.join(ANCHORS)}"),
            ("along_px", *above_0(self.along_px)),
            ("across", *above_0(self.across)),
            *((name, 0.0 <= getattr(self, name) <= 1.0, "0 to 1") for name in shares),
            *((name, getattr(self, name) >= 1, "at least 1") for name in ("bad_after", "good_after")),
        ]


SAMPLERS = ("mcmc", "sir")


@dataclass(frozen=True)
class McmcConfig(MipfConfig):
    """Settings of method `mcmc`: a filter for each view, whose samples hold all of its targets."""

    particles: int = 500  # samples of a view, not of a tracker

    sampler: str = "mcmc"  # `mcmc`: a Markov chain that moves one target at a time; `sir`: weights of whole samples
    burn: float = 0.25  # moves of the chain before its first sample, as a share of `particles`
    thin: int = 1  # moves of the chain per sample that is kept
    overlap: float = 2.0  # strength of the prior: two targets at one place are exp(-overlap) times as likely

    def limits(self) -> list[tuple[str, bool, str]]:
        """See `MipfConfig`."""
        return [
            *super().limits(),
            ("sampler", self.sampler in SAMPLERS, f"one of {', '.join(SAMPLERS)}"),
            ("thin", 1 <= self.thin <= MOST, f"1 to {MOST}"),
            *((name, 0 <= getattr(self, name) <= MOST, f"0 to {MOST}") for name in ("burn", "overlap")),
        ]
