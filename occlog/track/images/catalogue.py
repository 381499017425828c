"""Methods that track many targets in the images of several views, by name, [Qu]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from occlog.track.images.methods.cmct import adapted, by_colours, on_lines
from occlog.track.images.methods.config import BmctConfig, CmctConfig, IdmotConfig, MipfConfig
from occlog.track.images.methods.loop_check import paired_anew
from occlog.track.images.methods.mcmc import MCMC
from occlog.track.images.methods.restart import restarted
from occlog.track.images.methods.state import State, born, empty, ended
from occlog.track.images.methods.step import Scheme, advance
from occlog.track.images.methods.weigh import alone, among, together

from .interface import Birth, Looks, Visual


def _born_checked(state: State, looks: Looks, births: Sequence[Birth]) -> State:
    later = born(state, looks, births)
    return later._replace(trackers=paired_anew(later))


def _visual(summary: str, config: type, scheme: Scheme) -> Visual:
    begin = _born_checked if scheme.loop else born
    return Visual(summary, config, empty, begin, partial(advance, scheme), ended)


VISUAL: dict[str, Visual] = {
    "mipf": _visual("a particle filter for each target and view, on its own", MipfConfig, Scheme(alone, False)),
    "idmot": _visual("trackers that touch repel each other and keep their ways", IdmotConfig, Scheme(among, False)),
    "cmct": _visual(
        "particles on the epipolar lines of the other views, colours that adapt; no interaction",
        CmctConfig,
        Scheme(by_colours, True, on_lines, adapted),
    ),
    "bmct": _visual(
        "as idmot, helped by the other views through epipolar lines",
        BmctConfig,
        Scheme(together, True, again=restarted),
    ),
    "mcmc": MCMC,
}
"""Names as they are given on the command line."""
