"""Appearance of targets besides colours, `model=pca`: densities of grey patches, [Qu] Sec. 3.3.

The local likelihood is then p = p_c p_p, with p_p from the density of the grey patch inside the
ellipse (`occlog.track.images.kernels.patch_pca`).  The pixels of a patch are far from independent, so
that p_p is the density's geometric mean over the pixels, to the power of the setting `pca_power`.
A target's patches are learned from the frame it starts in, from ellipses that are off by a
little, so that a target that turns, or on which the light changes, becomes unlikely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.track.images.interface import Birth, FrameSet, Image, TrackerKey
from occlog.track.images.kernels.ellipse_colour import level
from occlog.track.images.kernels.patch_pca import (
    PatchModels,
    disc_points,
    learn_target,
    patch_log_likelihood,
    stack_models,
)

from .config import MipfConfig

AppearanceModels = Mapping[TrackerKey, PatchModels]
"""Model of each tracker's patches, M = 1."""

COMPONENTS = 12
"""Principal components of a model."""
PATCHES = 40
"""Patches from which the components are learned, besides that of the given ellipse."""


def learn_appearance(
    appearance: AppearanceModels,
    kept: Sequence[TrackerKey],
    frames: FrameSet,
    births: Sequence[Birth],
    config: MipfConfig,
) -> AppearanceModels:
    """Learn models of new trackers, and forget those of trackers that are not kept; nothing for `model=colour`.

    Args:
        appearance: models so far.
        kept: trackers that go on.
        frames: in which the targets of the births are.
        births: new trackers; one whose view has no frame gets no model.
        config: settings.
    """
    if config.model != "pca":
        return appearance
    jitter = np.random.default_rng(0).standard_normal((PATCHES, 5))
    out = {key: appearance[key] for key in kept if key in appearance}
    for birth in births:
        image = frames.images[birth.view]
        if image is not None:
            ellipse = level(np.asarray(birth.ellipse, dtype=np.float64)[None])[0]  # axes in the order of the tracker's
            out[birth.view, birth.target_id] = learn_target(image, ellipse, jitter, COMPONENTS)
    return out


def log_patches(
    image: Image, ellipses: Floats, owner: Ints, models: Sequence[PatchModels], config: MipfConfig
) -> Floats:
    """(P,) log p_p of ellipses in one view's frame, [Qu] Sec. 3.3.

    Args:
        image: the frame.
        ellipses: (P, 5).
        owner: (P,) row of the models for each ellipse.
        models: of the targets.
        config: settings.
    """
    power = config.pca_power / len(disc_points())
    return np.asarray(power * patch_log_likelihood(image, ellipses, owner, stack_models(models)))
