"""How a robot fared, in figures and in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from occlog.array_types import Floats
from occlog.core.navigation.potentials import distance
from occlog.core.navigation.steering import STATES, State

from .config import NavigateConfig
from .stage import Drive, End


class Verdict:
    """What became of one robot of a drive."""

    def __init__(self, robots: Drive, number: int, goal: Floats, names: Sequence[str], config: NavigateConfig) -> None:
        """Look at a robot when the drive is over.

        Args:
            robots: the drive.
            number: of the robot.
            goal: (2,) where it was to go.
            names: of the obstacles.
            config: its settings.
        """
        self.end = End(int(robots.end[number]))
        self._steps, self._config = int(robots.steps[number]), config
        self._states, self._length = robots.states[number], float(robots.length[number])
        self._recognised = int(robots.recognised[number])
        self._stays = self.end == End.ENDLESS or bool(robots.caught[number])
        self._prevented = bool(robots.prevented[number])
        self._clearance = float(robots.clearance[number])
        self._nearest = names[int(robots.nearest[number])] if robots.nearest[number] >= 0 else ""
        self._left = float(distance(robots.xy[number], goal))
        x, y = robots.xy[number]
        self._at = f"({x:.4g}, {y:.4g})"

    @property
    def reached(self) -> bool:
        """Whether the robot came to its goal without a collision."""
        return self.end == End.REACHED

    @property
    def trap(self) -> bool:
        """Whether forces, or the guard, hold the robot at one place, without the prevention taking part."""
        return self._stays and not self._prevented

    def words(self) -> str:
        """How the path ended."""
        if self.end == End.REACHED:
            return "goal reached"
        if self.end == End.COLLIDED:
            return f"collided with {self._nearest} in step {self._steps}"
        if self._stays and self._states[State.GUARDED]:
            return f"caught at {self._at} before {self._nearest}, where the guard holds it back"
        if self.trap:
            return f"caught at {self._at}, where goal and obstacles pull and push alike (a local minimum)"
        if self._stays:
            return f"oscillates for ever before {self._nearest}, at {self._at}"
        return f"all {self._steps} steps done, {self._left:.4g} from the goal"

    def warning(self) -> str:
        """A line about a goal that was not reached, with a remedy; empty if it was."""
        if self.reached:
            return ""
        return f"the robot did not reach its goal: {self.words()}; {self._remedy()}"

    def _remedy(self) -> str:
        """What to change."""
        if self.end == End.COLLIDED:
            return "take " + ("" if self._config.guard else "the guard, ") + "shorter steps or a larger repulsion"
        if self.trap:
            return "take a smaller influence or repulsion, or goals on the way"
        if self._stays:
            return "take escape inside" if self._config.escape != "inside" else "take goals on the way"
        return "take more steps"

    def figures(self) -> dict[str, object]:
        """The figures of the summary.

        reached: without a collision.  length: of the path, without steps that the guard left out.
        least_clearance: from obstacles, border to border, also between steps; null without obstacles.
        oscillation: whether it was recognised at any step.  trap: a local minimum, or the guard, holds the robot.
        states: steps by what decided on them.
        """
        return {
            "reached": self.reached,
            "end": self.words(),
            "steps": self._steps,
            "seconds": self._steps * self._config.step_s,
            "length": self._length,
            "to_goal": self._left,
            "least_clearance": self._clearance if math.isfinite(self._clearance) else None,
            "nearest": self._nearest,
            "collision": self.end == End.COLLIDED,
            "oscillation": self._recognised > 0,
            "oscillating_steps": self._recognised,
            "trap": self.trap,
            "states": {name: int(n) for name, n in zip(STATES, self._states, strict=True) if n},
        }
