"""Methods that track many targets in the images of several views, by name, [Qu]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TypeVar

from occlog.track.images.methods.cmct import adapt_colours, propose_on_lines, weigh_cmct
from occlog.track.images.methods.config import BmctConfig, CmctConfig, IdmotConfig, MipfConfig
from occlog.track.images.methods.loop_check import at_bottom, check_loops, check_new_pairs
from occlog.track.images.methods.mcmc import MCMC
from occlog.track.images.methods.restart import restart_one
from occlog.track.images.methods.state import (
    VisualState,
    add_trackers,
    end_trackers,
    initial_state,
    initial_state_with_paths,
    with_geometry,
)
from occlog.track.images.methods.step import Scheme, advance
from occlog.track.images.methods.weigh import weigh_bmct, weigh_idmot, weigh_mipf

from .interface import AnyVisual, Birth, Collaboration, FrameSet, Visual

Looped = TypeVar("Looped", BmctConfig, CmctConfig)


def _frozen(config: IdmotConfig) -> float:
    return config.frozen


def _add_and_check(state: VisualState[Looped], frames: FrameSet, births: Sequence[Birth]) -> VisualState[Looped]:
    later = add_trackers(state, frames, births)
    return later._replace(trackers=check_new_pairs(later))


MIPF: Visual[VisualState[MipfConfig], MipfConfig] = Visual(
    config=MipfConfig,
    init=initial_state,
    born=add_trackers,
    step=partial(advance, Scheme[MipfConfig](weigh_mipf)),
    ended=end_trackers,
)

IDMOT: Visual[VisualState[IdmotConfig], IdmotConfig] = Visual(
    config=IdmotConfig,
    init=initial_state_with_paths,
    born=add_trackers,
    step=partial(advance, Scheme[IdmotConfig](weigh_idmot, frozen=_frozen)),
    ended=end_trackers,
)

CMCT: Visual[VisualState[CmctConfig], CmctConfig] = Visual(
    config=CmctConfig,
    init=initial_state,
    born=_add_and_check,
    step=partial(
        advance,
        Scheme[CmctConfig](weigh_cmct, propose=propose_on_lines, check_loops=check_loops, learn=adapt_colours),
    ),
    ended=end_trackers,
    collaboration=Collaboration("does what mipf does, with colours that adapt", at_bottom, with_geometry),
)

BMCT: Visual[VisualState[BmctConfig], BmctConfig] = Visual(
    config=BmctConfig,
    init=initial_state_with_paths,
    born=_add_and_check,
    step=partial(
        advance,
        Scheme[BmctConfig](weigh_bmct, frozen=_frozen, check_loops=check_loops, restart=restart_one),
    ),
    ended=end_trackers,
    collaboration=Collaboration("does what idmot does", at_bottom, with_geometry),
)

VISUAL: dict[str, AnyVisual] = {"mipf": MIPF, "idmot": IDMOT, "cmct": CMCT, "bmct": BMCT, "mcmc": MCMC}
"""Methods by the names that `--method` takes."""
