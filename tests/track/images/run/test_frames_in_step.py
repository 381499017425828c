"""Frames of several cameras in step: unequal rates, late starts, early ends, damage; nothing stops."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.measure.epipolar.views import TrackedView
from occlog.records.frames import Frame
from occlog.track.methods.images.run.frame_synchronisation import in_step, step_window, survey

VIEWS = (TrackedView("a", 8, 6), TrackedView("b", 8, 6))
IMAGE = np.zeros((6, 8, 3), np.uint8)


def frames(*stamps: tuple[str, int, int], images=None) -> list[Frame]:
    """Frames of (camera, number, time) in the order of time; images by (camera, number)."""
    images = images or {}

    def decode(key):
        def now():
            found = images.get(key, np.full_like(IMAGE, key[1]))
            if isinstance(found, str):
                raise InputError(f"file: camera {key[0]}: frame {key[1]}: {found}")
            return found

        return now

    ordered = sorted(stamps, key=lambda s: (s[2], s[0]))
    return [Frame(t, name, number, decode((name, number))) for name, number, t in ordered]


def seen(moments):
    return [tuple(m.frames.number.tolist()) for m in moments]


def test_equal_times_make_a_moment():
    given = frames(*[(n, k, 40 * k) for n in "ab" for k in range(30)])
    time_steps = list(in_step(given, VIEWS, 0))
    assert seen(time_steps) == [(k, k) for k in range(30)]
    assert [m.frames.t_ns for m in time_steps] == [40 * k for k in range(30)]
    assert all((m.frames.images[1] == k).all() for k, m in enumerate(time_steps))


def test_times_nearer_than_half_a_period_make_a_moment_and_keep_their_own_time():
    given = frames(*[("a", k, 40 * k) for k in range(5)], *[("b", k, 40 * k + 19) for k in range(5)])
    time_steps = list(in_step(given, VIEWS, step_window([40, 40])))
    assert seen(time_steps) == [(k, k) for k in range(5)]
    assert time_steps[2].t_ns.tolist() == [80, 99]
    assert time_steps[2].frames.t_ns == 99
    later = frames(*[("a", k, 40 * k) for k in range(5)], *[("b", k, 40 * k + 21) for k in range(5)])
    # Nearer to the next one
    assert seen(in_step(later, VIEWS, step_window([40, 40])))[:3] == [(0, -1), (1, 0), (2, 1)]


@pytest.mark.parametrize("offset", [3, 7, 16])
def test_a_slower_view_has_moments_without_a_frame(offset):
    given = frames(*[("a", k, 40 * k) for k in range(12)], *[("b", k, 100 * k + offset) for k in range(5)])
    time_steps = list(in_step(given, VIEWS, step_window([40, 100])))
    numbers = np.array(seen(time_steps))
    assert [n for n in numbers[:, 0] if n >= 0] == list(range(12))
    assert [n for n in numbers[:, 1] if n >= 0] == list(range(5))
    both = (numbers >= 0).all(axis=1)
    apart = np.array([abs(int(np.diff(m.t_ns)[0])) for m in time_steps])[both]
    assert both.sum() == 5
    assert apart.max() <= 20


def test_a_view_may_start_late_and_end_early():
    given = frames(*[("a", k, 40 * k) for k in range(10)], *[("b", k, 40 * (k + 3)) for k in range(4)])
    assert seen(in_step(given, VIEWS, 19)) == [
        *((k, -1) for k in range(3)),
        *((k, k - 3) for k in range(3, 7)),
        *((k, -1) for k in range(7, 10)),
    ]


def test_frames_that_cannot_be_used_are_reported_and_the_others_go_on():
    other = np.zeros((6, 9, 3), np.uint8)
    deep = np.zeros((6, 8), np.uint16)
    given = frames(
        *[(n, k, 40 * k) for n in "ab" for k in range(6)],
        images={("a", 1): "cut short", ("b", 1): "cut short", ("b", 3): other, ("b", 4): deep},
    )
    time_steps = list(in_step(given, VIEWS, 0))
    assert seen(time_steps) == [(0, 0), (-1, -1), (2, 2), (3, -1), (4, -1), (5, 5)]
    lost = [loss for m in time_steps for loss in m.lost]
    assert lost[:3] == [
        (0, 1, "cut short"),
        (1, 1, "cut short"),
        (1, 3, "image is 9 x 6 px, the camera's first was 8 x 6 px"),
    ]
    assert "16-bit" in lost[3][2]
    assert seen(in_step(given, VIEWS, 0, bits=10))[4] == (4, 4)


def test_the_number_of_threads_does_not_matter_and_frames_are_decoded_in_order():
    order: list[tuple[str, int]] = []

    def decode(key):
        def now():
            order.append(key)
            return IMAGE

        return now

    given = [Frame(40 * k, n, k, decode((n, k))) for k in range(50) for n in "ab"]
    assert seen(in_step(iter(given), VIEWS, 0, workers=2)) == [(k, k) for k in range(50)]
    assert [k for n, k in order if n == "a"] == list(range(50))


def test_frames_are_not_read_far_ahead():
    read = 0

    def counted():
        nonlocal read
        for frame in frames(*[(n, k, 40 * k) for n in "ab" for k in range(400)]):
            read += 1
            yield frame

    time_steps = in_step(counted(), VIEWS, 0)
    next(time_steps)
    assert read < 60
    time_steps.close()


def test_times_must_not_go_back():
    back = frames(("a", 0, 0), ("a", 1, 40))[::-1]
    with pytest.raises(InputError, match=r"camera a: frame 0: time 0 s is before 0.00000004 s"):
        list(in_step(back, VIEWS, 0))


def test_the_window_is_below_half_the_shortest_period():
    assert step_window([40, 100]) == 19
    assert step_window([41]) == 20
    assert step_window([0, 0]) == 0
    assert step_window([]) == 0


def test_survey_tells_size_period_and_frames_that_miss():
    given = frames(*[("a", k, 40 * k) for k in range(100) if k % 7], images={("a", 1): "cut short"})
    found = survey("a", given)
    assert (found.view, found.period_ns, found.first) == (TrackedView("a", 8, 6), 40, 1)
    assert survey("a", given, wanted=[7, 8, 200]).missing == (7, 200)
    with pytest.raises(InputError, match=r"camera a: not one frame can be decoded \(cut\).*leave this camera out"):
        survey("a", frames(("a", 0, 0), images={("a", 0): "cut"}))
    with pytest.raises(InputError, match="not one frame"):
        survey("a", [])
