"""Settings of the filter of several motion models for several targets, and of its cooperation with cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

from occlog.settings import check_settings

METRES = {"m": 1.0, "ft": 0.3048, "in": 0.0254}
ASSOCIATIONS = ("joint", "any")
POLICIES = ("none", "periodic", "printed", "count", "spread")
TRIGGERS = ("count", "bearing", "ellipse")
"""Of policy `printed`: [Lee] Eqs. 3.14, 3.15 and 3.16."""
FIXES = ("update", "replace")
START_NUMBERS = 6
"""X, Y, SIGMA, VX, VY, SIGMA_V of one target."""


@dataclass(frozen=True)
class ImmConfig:
    """Settings of method `imm`; lengths in the scene's unit, times in seconds, angles in radians."""

    particles: int = 500  # of each target; every one is moved under each of the three models
    start: tuple[float, ...] | None = None
    """X, Y, SIGMA, VX, VY, SIGMA_V of each target known at first; None: none is."""

    # Motion, [Lee] Sec. 3.3.1
    alpha: float = 1.0  # lateral acceleration of the two turns
    sigma_v: float = 1.3  # noise of the velocity per axis, gathered in a second
    hold_s: float | None = None  # a model holds this long on average; None: every model is as likely at every step
    speed: float = 1.0  # standard deviation of a new target's velocity, per axis

    # Which bearing is whose
    association: str = "joint"  # or `any`: every target's filter takes any bearing, [Lee] Eq. 3.6
    detection: float = 0.95  # an array hears a sounding target in its range
    clutter: float = 0.1  # bearings of nobody expected of an array at a time, anywhere around it
    height: float | None = None  # of sources; None: an array's range is taken on the ground
    sound_s: float = 30.0  # a target sounds this long on average before it falls silent
    silent_s: float = 3.0  # and is silent for so long

    # Births and deaths
    birth: float = 0.02
    """A bearing of nobody is of a new target with this probability.  With 0, and with `association=any`, targets are
    only those of `start`, those that cameras find, and those that have labels."""
    birth_factor: int = 10  # a new target has this many times the particles until it is confirmed
    confirm: float = 0.95  # a target is reported from this probability on that it exists
    confirm_hits: int = 3  # and when it was heard so often
    die: float = 0.02  # below this probability it is given up
    forget_s: float = 15.0  # and when it was neither heard nor seen for so long
    walls: bool = True  # nobody leaves the room, if the scene has one

    # Cooperation with cameras, [Lee] Sec. 3.3
    cooperate: str = "none"  # policies, several with commas: `periodic`, `printed`, `count`, `spread`
    period_s: float = 10.0  # of `periodic`
    triggers: str = "count,bearing,ellipse"  # of `printed`
    spread: float = 1.0  # of `spread`: asks when the root of the position's variance is above
    fix: str = "update"  # what a position found does: a measurement, or `replace` (the thesis)
    share: bool = True  # whom else the frames show is taken in as well
    frame_age_s: float = 0.5  # frames older than this are none
    retry_s: float = 0.5  # a request in vain is not made anew before
    gate: float = 4.0  # standard deviations within which what unlabelled candidates show is of a target

    def __post_init__(self) -> None:
        limits = [(n, 0.0 <= getattr(self, n) < 1.0, "in [0, 1)") for n in ("birth", "die", "confirm")]
        limits += [(n, getattr(self, n) >= 0, "at least 0") for n in ("alpha", "sigma_v", "speed", "spread", "retry_s")]
        limits += [(n, getattr(self, n) >= 1, "at least 1") for n in ("particles", "birth_factor", "confirm_hits")]
        for name in ("clutter", "sound_s", "silent_s", "forget_s", "period_s", "frame_age_s", "gate"):
            limits.append((name, getattr(self, name) > 0, "above 0"))
        limits += [
            ("detection", 0.0 < self.detection <= 1.0, "above 0 and at most 1"),
            ("hold_s", self.hold_s is None or self.hold_s > 0, "above 0"),
            ("association", self.association in ASSOCIATIONS, "one of " + ", ".join(ASSOCIATIONS)),
            ("cooperate", self.policies <= frozenset(POLICIES), "of " + ", ".join(POLICIES)),
            ("triggers", bool(self.printed) and self.printed <= frozenset(TRIGGERS), "of " + ", ".join(TRIGGERS)),
            ("fix", self.fix in FIXES, "one of " + ", ".join(FIXES)),
            ("start", _good_start(self.start), "X,Y,SIGMA,VX,VY,SIGMA_V of each target, SIGMA and SIGMA_V >= 0"),
        ]
        check_settings(self, "imm", limits)

    @property
    def policies(self) -> frozenset[str]:
        """Names of `cooperate`."""
        return names(self.cooperate)

    @property
    def printed(self) -> frozenset[str]:
        """Names of `triggers`."""
        return names(self.triggers)


def names(text: str) -> frozenset[str]:
    """Names separated by commas."""
    return frozenset(part.strip() for part in text.split(",") if part.strip())


def _good_start(start: tuple[float, ...] | None) -> bool:
    if start is None:
        return True
    return len(start) > 0 and len(start) % START_NUMBERS == 0 and all(s >= 0 for s in (*start[2::6], *start[5::6]))


def imm_defaults(length_unit: str) -> ImmConfig:
    """Settings that suit a scene: people for metres, feet and inches; as in metres for a unit of its own."""
    config = ImmConfig()
    metre = 1.0 / METRES.get(length_unit, 1.0)
    return replace(
        config,
        alpha=config.alpha * metre,
        sigma_v=config.sigma_v * metre,
        speed=config.speed * metre,
        spread=config.spread * metre,
    )
