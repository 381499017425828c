"""Values of keys as the fields of requests have them."""

from __future__ import annotations

import pytest

from occlog.evaluate.request import EvaluateRequest
from occlog.pipeline.run.stage import setting_of
from occlog.request import Form
from occlog.track.request import TrackRequest


def read(form: Form, key: str, value: object) -> object:
    return setting_of(next(entry for entry in form.entries() if entry.key == key), value)


@pytest.mark.parametrize("value", ["2:5", [2, 5]])
def test_frames_are_two_whole_numbers(value: object) -> None:
    assert read(Form(EvaluateRequest), "frames", value) == (2, 5)


def test_frames_begin_at_the_first_one() -> None:
    assert read(Form(EvaluateRequest), "frames", ":5") == (0, 5)


def test_several_targets_are_whole_numbers() -> None:
    assert read(Form(TrackRequest), "target", [3, 8]) == (3, 8)
