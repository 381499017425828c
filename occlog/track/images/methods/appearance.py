"""What trackers in images know of their targets besides colours: `model=pca`, [Qu] Sec. 4.2.

The local likelihood is then p = p_c p_p, with p_p from the density of the grey patch inside the
ellipse (`occlog.track.images.kernels.patch_pca`).  The pixels of a patch are far from independent, so that
p_p is the density's geometric mean over the pixels, to the power of the setting `pca_power`.
A target's patches are learned from the frame it starts in, from ellipses that are off by a
little, so that a target that turns, or that the light changes on, becomes unlikely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.track.images.interface import Birth, Image, Looks
from occlog.track.images.kernels.patch_pca import (
    PatchModels,
    disc_points,
    learn_target,
    patch_log_likelihood,
    stack_models,
)

from .colours import level

Memories = Mapping[tuple[int, int], PatchModels]
"""Models by view and target."""

COMPONENTS = 12
PATCHES = 40
"""That the components are learned from, besides the one given."""


def remembered(
    memories: Memories, pairs: Sequence[tuple[int, int]], looks: Looks, births: Sequence[Birth], config: Any
) -> Memories:
    """Models of the trackers (view, target) that are left, and of new ones; nothing for `model=colour`."""
    if config.model != "pca":
        return memories
    jitter = np.random.default_rng(0).standard_normal((PATCHES, 5))
    out = {pair: memories[pair] for pair in pairs if pair in memories}
    for birth in births:
        image = looks.images[birth.view]
        if image is not None:
            ellipse = level(np.asarray(birth.ellipse, dtype=np.float64)[None])[0]  # axes in the order of the tracker's
            out[birth.view, birth.target_id] = learn_target(image, ellipse, jitter, COMPONENTS)
    return out


def log_patches(image: Image, ellipses: Floats, owner: Ints, models: Sequence[PatchModels], config: Any) -> Floats:
    """(P,) log p_p of ellipses in one view's frame.

    Args:
        image: the frame.
        ellipses: (P, 5).
        owner: (P,) which of the models an ellipse is compared with.
        models: of the targets.
        config: with `pca_power`.
    """
    power = config.pca_power / len(disc_points())
    return np.asarray(power * patch_log_likelihood(image, ellipses, owner, stack_models(models)))


def log_appearance(
    looks: Looks, particles: Floats, view: Ints, target: Ints, memories: Memories, config: Any
) -> Floats | float:
    """(n, N) log p_p of particles (n, N, 5) of n trackers; 0 where their view has no frame, and for `model=colour`."""
    if config.model != "pca":
        return 0.0
    out = np.zeros(particles.shape[:2])
    for v, image in enumerate(looks.images):
        rows = np.flatnonzero(view == v)
        if image is not None and len(rows):
            models = [memories[v, int(target[i])] for i in rows]
            flat = particles[rows].reshape(-1, 5)
            owner = np.repeat(np.arange(len(rows)), particles.shape[1])
            out[rows] = log_patches(image, flat, owner, models, config).reshape(len(rows), -1)
    return out
