"""The kit of detectors finds each seeded fault by the name of its check, and nothing in one without fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seeded import check_kit, check_seeded, common_faults, example, hoard

from occlog.conformance.detectors import CHECKS
from occlog.plugins.interface import Detected, Image

Bright: Any = example("own_parts/own_images").BrightRegions


class Good(Bright):
    """With embeddings."""

    def detect(self, image: Image) -> Detected:
        found = super().detect(image)
        return found._replace(embeddings=np.ones((len(found.boxes), 3), dtype=np.float32))


def changed(act: Any) -> type:
    """The good one, whose boxes are changed: called with the object, the image and the boxes."""
    return type("Changed", (Good,), {"detect": lambda self, image: act(self, image, Good.detect(self, image))})


def given(act: Any) -> type:
    """The good one, to which something happens with the image first."""
    return type("Given", (Good,), {"detect": lambda self, image: Good.detect(self, act(self, image))})


def _shared(self: Any, image: Image, found: Detected) -> Detected:
    moved = found._replace(boxes=found.boxes + SHARED["at"])
    SHARED["at"] = 1e-3 * float(image[60, :, 0].argmax())
    return moved


SHARED = {"at": 0.0}


def _held(self: Any, image: Image, found: Detected) -> Detected:
    self.boxes = self.__dict__.get("boxes", np.zeros((2, 4)))
    self.boxes[:] = found.boxes[:2] if len(found.boxes) >= 2 else 1.0
    return found._replace(boxes=self.boxes) if len(found.boxes) == 2 else found


def _asserts(holds: Any) -> type:
    def act(self: Any, image: Image) -> Image:
        assert holds(image)
        return image

    return given(act)


def _in_place(self: Any, image: Image) -> Image:
    image[0, 0] = image[0, 0]
    return image


def _whitens(self: Any, image: Image) -> Image:
    image[0, 0] = 255
    return image


FAULTS = {
    **common_faults(Good, "detect"),
    "shape": changed(lambda self, image, found: (found.boxes, found.scores)),
    "finite": changed(lambda self, image, found: found._replace(boxes=found.boxes * np.nan)),
    "sizes": changed(lambda self, image, found: found._replace(boxes=-found.boxes)),
    "scores": changed(lambda self, image, found: found._replace(scores=100.0 * found.scores)),
    "inside": changed(lambda self, image, found: found._replace(boxes=np.add(found.boxes, (640.0, 0.0, 0.0, 0.0)))),
    "embeddings": changed(
        lambda self, image, found: found._replace(
            embeddings=np.ones((len(found.boxes), 2 + int(image[60, :, 0].argmax()) % 5))
        )
    ),
    "independent": changed(_shared),
    "inputs": given(_whitens),
    "results": changed(_held),
    "read-only": given(_in_place),
    "strided": given(lambda self, image: np.frombuffer(image.base if image.base is not None else image, np.uint8)[
        : image.size
    ].reshape(image.shape)),
    "empty": changed(lambda self, image, found: found._replace(scores=found.scores / (1.0 - found.scores.min()))
        if image.max() == image.min() else found),
    "noise": _asserts(lambda image: not (image.min() == 0 and image.max() == 255)),
    "small": _asserts(lambda image: image.shape[0] % 4 == 0 and image.shape[1] >= 32),
    "determinism": changed(
        lambda self, image, found: found._replace(boxes=found.boxes + 1e-9 * np.random.default_rng().normal())
    ),
    "memory": given(lambda self, image: hoard() or image),
}  # fmt: skip
"""A detector with one fault, by the check that must find it."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_seeded_fault_is_found_by_name(name: str) -> None:
    check_seeded(CHECKS, FAULTS, name)


def test_the_kit_is_complete_and_finds_nothing_in_a_good_one(tmp_path: Path) -> None:
    check_kit(CHECKS, FAULTS, Good, tmp_path)
