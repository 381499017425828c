"""Settings of the selection of cameras, [Ercan] Sec. 5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from occlog.errors import InputError
from occlog.settings import Settings, declared, setting

POLICIES = ("greedy", "brute-force", "fixed", "random", "closest", "all")
BY_ERROR = ("greedy", "brute-force")
"""Policies that select by the expected error."""


@dataclass(frozen=True)
class SelectConfig(Settings):
    """How cameras are selected."""

    OWNER: ClassVar[str] = "select"

    policy: str = setting(
        "greedy",
        "Use only some cameras, selected anew every few steps.",
        choices=POLICIES,
        option="--select",
        shown="use all",
    )
    count: int = setting(4, "Cameras selected.", at_least=1, option="--count")
    every: float = setting(
        5.0, "Reference steps (--set reference_s, 1 s) between selections.", above=0, option="--every", metavar="STEPS"
    )
    model: str = setting(
        "perspective",
        "Camera model of the expected error: [Ercan] Secs. 5.1 and 5.2.",
        choices=("perspective", "weak"),
        option="--select-model",
    )
    order: tuple[str, ...] = setting(
        (),
        "Order of the cameras for --select fixed.",
        option="--select-order",
        metavar="A,B,...",
        shown="that of the scene",
    )
    patience: int = setting(
        1,
        "Scans in a row in which fewer than two of the selected cameras see the target, after which they are selected "
        "anew; 0: only after the whole interval. Only greedy and brute-force, without priors of the moving occluders.",
        at_least=0,
        option="--patience",
        metavar="SCANS",
    )


def read_selection(values: Mapping[str, Any]) -> SelectConfig:
    """How cameras are selected, from the fields of a file; InputError for an unknown one or one that does not fit."""
    known = [f.name for f in declared(SelectConfig)]
    for name in values:
        if name not in known:
            raise InputError(f"select: unknown key {name!r}; it has: {', '.join(known)}")
    lists = {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
    return SelectConfig(**{**values, **lists})
