"""What each group of people adds to the figures of many targets: parts that an exchange of identities does not cross.

Who has become another one stays that to the end, so that stretches of a recording are not independent in figures of
identities.  People are not, either: of two who are exchanged both lose.  Groups of people who share tracks are, nearly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from occlog.array_types import Floats, Ints

from .clear_mot import CLASSIC, ClearRule, match
from .frame_pairs import Frames
from .frame_sums import Associated, sums_by_cell
from .hota import associations
from .idf1 import identity


class Groups(NamedTuple):
    """Groups of people and of tracks.

    Attributes:
        number: how many groups there are.
        target: (G,) group of each target.
        track: (K,) group of each track.
    """

    number: int
    target: Ints
    track: Ints


def groups_of(a: Frames, b: Frames) -> tuple[Groups, Groups]:
    """Groups of people who have to do with each other in either of two runs, the same people in both.

    Two people are of one group if some track is paired with both, as it is where they are exchanged, and so on from
    person to person; a track is of the group of those whom it is paired with, or a group of its own.  What happens in
    one group does not depend on what happens in another, but for what people hide from each other.
    """
    people, first = len(a.truth_key), len(a.truth_key) + len(a.track_key)
    count = first + len(b.track_key)
    left, right = [], []
    for frames, offset in ((a, people), (b, first)):
        alone = match(frames, ClearRule(memory=0))
        given = identity(frames).track
        left += [frames.truth[alone.truth], np.flatnonzero(given >= 0)]
        right += [offset + frames.track[alone.track], offset + given[given >= 0]]
    x, y = np.concatenate(left), np.concatenate(right)
    number, label = connected_components(coo_array((np.ones(len(x)), (x, y)), shape=(count, count)), directed=False)
    of_people = label[:people].astype(np.int64)
    return (
        Groups(int(number), of_people, label[people:first].astype(np.int64)),
        Groups(int(number), of_people, label[first:].astype(np.int64)),
    )


def group_sums(frames: Frames, groups: Groups, rule: ClearRule = CLASSIC) -> Floats:
    """(groups.number, SIZE) what each group of people and tracks adds; pairs are of the group of the person.

    Args:
        frames: truth and tracks as points.
        groups: which group each person and each track is of.
        rule: how CLEAR-MOT pairs.
    """
    _, target, pairs, belonging = associations(frames)
    given = Associated(groups.target[target], pairs, belonging)
    return sums_by_cell(frames, groups.number, rule, groups.target[frames.truth], groups.track[frames.track], given)
