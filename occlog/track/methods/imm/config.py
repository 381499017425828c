"""Settings of the filter of several motion models for several targets, and of its cooperation with cameras."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import listed, setting
from occlog.track.smoothing_and_lag import SmoothingConfig

POLICIES = ("none", "periodic", "printed", "count", "spread")
TRIGGERS = ("count", "bearing", "ellipse")
"""Of policy `printed`: [Lee] Eqs. 3.14, 3.15 and 3.16."""
START_NUMBERS = 6
"""X, Y, SIGMA, VX, VY, SIGMA_V of one target."""


@dataclass(frozen=True)
class ImmConfig(SmoothingConfig):
    """Settings of method `imm`; lengths in the scene's unit, times in seconds, angles in radians."""

    OWNER: ClassVar[str] = "imm"

    particles: int = setting(
        2000,
        "Particles of each target; every one is moved under each of the three models.",
        at_least=1,
        option="--particles",
    )
    start: tuple[float, ...] | None = setting(
        None, "X, Y, SIGMA, VX, VY, SIGMA_V of each target known at first.", unit="length", nothing="none is known"
    )

    # Motion, [Lee] Sec. 3.3.1
    alpha: float = setting(1.0, "Lateral acceleration of the two turns.", unit="length/s^2", at_least=0)
    sigma_v: float = setting(1.3, "Noise of the velocity per axis, gathered in a second.", unit="length/s", at_least=0)
    hold_s: float | None = setting(
        None,
        "How long a motion model holds on average.",
        unit="s",
        at_most=1e9,
        above=0,
        nothing="every model is as likely at every step",
    )
    speed: float = setting(1.0, "Standard deviation of a new target's velocity, per axis.", unit="length/s", at_least=0)

    # Data association
    association: str = setting(
        "joint",
        "Which bearing is whose; any: every target's filter takes any bearing, [Lee] Eq. 3.6.",
        choices=("joint", "any"),
    )
    detection: float = setting(
        0.95, "Probability that an array hears a sounding target in its range.", above=0, at_most=1
    )
    clutter: float = setting(0.1, "Bearings of nobody expected of an array at a time, anywhere around it.", above=0)
    height: float | None = setting(
        None, "Height of sources.", unit="length", nothing="an array's range is taken on the ground"
    )
    sound_s: float = setting(30.0, "A target sounds this long on average before it falls silent.", unit="s", above=0)
    silent_s: float = setting(3.0, "A target is silent for so long on average.", unit="s", above=0)

    # Births and deaths
    birth: float = setting(
        0.02,
        "Probability that a bearing of nobody is of a new target. With 0, and with association=any, targets are "
        "only those of `start`, those that cameras find, and those that have labels.",
        at_least=0,
        below=1,
    )
    birth_factor: int = setting(3, "A new target has this many times the particles until it is confirmed.", at_least=1)
    confirm: float = setting(0.95, "A target is reported from this probability on that it exists.", at_least=0, below=1)
    confirm_hits: int = setting(3, "And when it was heard so often.", at_least=1)
    die: float = setting(0.02, "Below this probability a target is given up.", at_least=0, below=1)
    forget_s: float = setting(
        15.0, "So is one that was neither heard nor seen for so long.", unit="s", at_most=1e9, above=0
    )
    walls: bool = setting(True, "No target leaves the room, if the scene has one.")

    # Cooperation with cameras, [Lee] Sec. 3.3
    cooperate: str = setting(
        "none",
        f"When to ask cameras where the targets are: {', '.join(POLICIES)}; several with commas.",
        choices=POLICIES,
        several=True,
        option="--cooperate",
        metavar="POLICY",
    )
    period_s: float = setting(10.0, "Period of `periodic`.", unit="s", at_most=1e9, above=0)
    triggers: str = setting(
        "count,bearing,ellipse", "Triggers of `printed`, with commas.", choices=TRIGGERS, several=True
    )
    spread: float = setting(
        1.0, "`spread` asks when the root of the position's variance is above this.", unit="length", at_least=0
    )
    fix: str = setting(
        "update",
        "A position that cameras found is a measurement, or replaces the cloud (the thesis).",
        choices=("update", "replace"),
    )
    share: bool = setting(True, "Other targets that the frames show are taken in as well.")
    frame_age_s: float = setting(
        0.5, "Frames older than this are not used, the time of an answer not counted.", unit="s", at_most=1e9, above=0
    )
    answer_s: float = setting(
        0.0,
        "Cameras' answers take so long: of each camera the last frame that is at least so old is used (see "
        "`occlog traffic`).",
        unit="s",
        at_least=0,
        at_most=1e6,
    )
    retry_s: float = setting(0.5, "A request in vain is not made anew before.", unit="s", at_least=0)
    gate: float = setting(
        4.0, "Standard deviations within which what unlabelled candidates show is of a target.", above=0
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Starts have six numbers each."""
        limit = "X,Y,SIGMA,VX,VY,SIGMA_V of each target, SIGMA and SIGMA_V >= 0"
        yield "start", _good_start(self.start), limit

    @property
    def policies(self) -> frozenset[str]:
        """Names of `cooperate`."""
        return frozenset(listed(self.cooperate))

    @property
    def printed(self) -> frozenset[str]:
        """Names of `triggers`."""
        return frozenset(listed(self.triggers))


def _good_start(start: tuple[float, ...] | None) -> bool:
    if start is None:
        return True
    return len(start) > 0 and len(start) % START_NUMBERS == 0 and all(s >= 0 for s in (*start[2::6], *start[5::6]))
