"""Who is known in a box of two."""

import numpy as np

from occlog.track.methods.jipda.batch.association import MIN_ASSOCIATION_PROBABILITY, assign_shared_boxes
from occlog.track.methods.jipda.batch.mcmc_association import NO_NODE
from occlog.track.methods.jipda.kernels.detections import PackedDetections

ABOVE = np.nextafter(MIN_ASSOCIATION_PROBABILITY, 1.0)


def test_who_shares_a_box_has_the_identity_of_most_of_their_boxes():
    """Four cameras; the last has one box of two people, the third none of the first person."""
    boxes = PackedDetections(
        np.arange(4), np.zeros(4), np.arange(5), np.zeros((4, 4)), np.ones((4, 4), dtype=bool), np.zeros(4)
    )
    given = np.array([[0, NO_NODE], [1, NO_NODE], [2, NO_NODE], [NO_NODE, NO_NODE]])
    joint = np.zeros((3, 4))
    joint[[0, 2], 3] = ABOVE
    # The second person of all has no box; the third has none alone, so that nothing says who they are
    rows = np.array([0, 2])
    followed = np.array([[7, 5, 7, NO_NODE], [NO_NODE, NO_NODE, NO_NODE, NO_NODE]])
    assign_shared_boxes(followed, rows, joint, given, boxes)
    assert followed.tolist() == [[7, 5, 7, 7], [NO_NODE] * 4]
    # A box that is theirs no more probably than not names no one, nor does one that is theirs alone
    for share, own in ((MIN_ASSOCIATION_PROBABILITY, NO_NODE), (ABOVE, 3)):
        joint[0, 3], given[3, 0] = share, own
        followed = np.array([[7, 5, 7, NO_NODE], [NO_NODE, NO_NODE, NO_NODE, NO_NODE]])
        assign_shared_boxes(followed, rows, joint, given, boxes)
        assert followed[0].tolist() == [7, 5, 7, NO_NODE]
