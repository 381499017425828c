"""[Lee] 5.2.3, traffic: the stated orderings hold where links share a channel."""

from __future__ import annotations

from occlog.papers.lee.traffic.delays import TRAFFIC_EXPERIMENTS
from occlog.papers.verdicts import Size


def test_orderings_hold_where_links_share_the_channel() -> None:
    end_to_end, hops = TRAFFIC_EXPERIMENTS
    size = Size(1, 1)
    table = end_to_end.compute(size, lambda _: [])
    found = {x.id: x.verdict for x in end_to_end.judge(table)}
    for key in ("traffic-1-shared", "traffic-2-shared", "traffic-3-shared", "traffic-size", "traffic-share"):
        assert found[key] == "reproduced", key
    assert found["traffic-2-link"] == "not reproduced"
    judged = hops.judge(hops.compute(size, lambda _: []))
    assert {x.id for x in judged} >= {"hops-2-visual", "hops-3-sum"}
