"""Paths about a stretch of time are as good in it as whole ones, over gaps of any width, in height as well."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.evaluate.matching.path_outline import NEAR_NS, OCCLUDER, TARGET, TruthOutlines
from occlog.evaluate.matching.paths import paths_of
from occlog.records.tables import Truth

ASKED = {"at": True, "height_at": True, "roughly_at": False, "rough_height_at": False}
"""What is asked of a path, and whether with a widest gap."""


def people(seed: int) -> Truth:
    """Objects that are gone for seconds or minutes, whose heights are gone for longer still."""
    random = np.random.default_rng(seed)
    parts = []
    for label, role in ((0, TARGET), (3, TARGET), (4, TARGET), (3, OCCLUDER), (9, OCCLUDER)):
        t_ns = np.cumsum(random.choice([0.5, 0.5, 0.5, 7.0, 61.0, 200.0], 60) * NS).astype(np.int64)
        known = random.random(60) < (0.1 if label == 0 else 0.0 if label == 4 else 0.5)
        values = {"x": random.normal(size=60), "y": random.normal(size=60), "z": np.where(known, label + 1.0, np.nan)}
        parts.append(Truth.of(t_ns=t_ns, target_id=np.full(60, label), role=np.full(60, role), **values))
    return Truth.merge(parts)


@pytest.mark.parametrize("limit_ns", [None, 3 * NS, 100 * NS])
@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_paths_of_a_stretch_say_what_whole_ones_say(rows: int, limit_ns: int | None) -> None:
    truth, found = people(rows), TruthOutlines()
    parts = (truth.take(slice(start, start + rows)) for start in range(0, len(truth), rows))
    assert sum(len(part) for part in found.watch(parts)) == len(truth)
    assert found.high == {0, 3}
    end, margin = int(truth.t_ns[-1]), max(NEAR_NS, limit_ns or 0) + 1
    for role in (TARGET, OCCLUDER):
        whole = paths_of(truth.take(truth.role == role))
        gaps = found.gaps_ns(role, {label: path.usual_gap_ns for label, path in whole.items()})
        assert gaps == {label: path.usual_gap_ns for label, path in whole.items()}
        for begin in range(-100 * NS, end + 100 * NS, 97 * NS):
            about = begin - margin, begin + 97 * NS + margin
            near = truth.take((truth.t_ns >= about[0]) & (truth.t_ns < about[1]))
            paths = found.paths(near, about, role, gaps)
            assert list(paths) == list(whole)
            asked = np.sort(np.concatenate([np.arange(begin, begin + 97 * NS, 3 * NS + 1), near.t_ns]))
            asked = asked[(asked >= begin) & (asked < begin + 97 * NS)]
            for label, path in paths.items():
                for name, limited in ASKED.items():
                    more = (limit_ns,) if limited else ()
                    got, want = (getattr(p, name)(asked, *more) for p in (path, whole[label]))
                    for a, b in zip(*((v if isinstance(v, tuple) else (v,)) for v in (got, want)), strict=True):
                        np.testing.assert_array_equal(a, b, err_msg=f"{role} {label} {name}")
