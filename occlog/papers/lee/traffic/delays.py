"""[Lee] Figs. 5-44 to 5-47: end-to-end and hop-by-hop delays of RBVC and SBVC in three scenarios."""

from __future__ import annotations

import functools
from itertools import pairwise

from occlog.papers import verdicts as v
from occlog.papers.lee.traffic.config import CHANNELS, PROTOCOLS, TrafficConfig
from occlog.papers.lee.traffic.network import CameraNode, RouterNetwork, SensorNode
from occlog.papers.lee.traffic.stage import TrafficCase, hop_delays, simulate_traffic
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, exact

ROUTERS = tuple(f"R{n}" for n in range(1, 6))
IMAGES_KB = (10.0, 40.0, 100.0)
SHARES = (0.1, 0.5, 1.0)
USUAL_KB, USUAL_SHARE = 40.0, 0.1
DETECTED_ASSIGNED = ((30, 0.3), (40, 0.3), (50, 0.4))
"""Objects that the three readers of a router detect, and shares of the tracked ones that its arrays are to hear."""
SCENARIOS = {1: (("R1",), ("R2", "R4")), 2: (ROUTERS, ("R2", "R4")), 3: (ROUTERS, ("R5", "R5"))}
"""Routers with 100 objects in range, and the routers of the two cameras; the text's "router 4 (R_2)" is R5."""
SHARED, AIR = "shared", "air time of images"
PRINTED = {
    2: {
        "RFID detection data": (0.000615, 0.001919),
        "assigned object data": (0.001639, 0.001625),
        "acoustic sensing data": (0.001263, 0.001288),
        "visual sensing data": (0.008797, 0.004149),
        "final estimation data": (0.023861, 0.009267),
        "estimation based on acoustic sensors": (None, 0.014093),
    },
    3: {
        "RFID detection data": (0.001853, 0.000624),
        "assigned object data": (0.001620, 0.001741),
        "acoustic sensing data": (0.001281, 0.001252),
        "visual sensing data": (0.010335, 0.001783),
        "final estimation data": (0.010127, 0.004588),
        "estimation based on acoustic sensors": (None, 0.012266),
    },
}
"""Printed hop-by-hop delays [s] of RBVC and SBVC by scenario (tables of Figs. 5-45 and 5-46)."""


def network(scenario: int, channel: str = SHARED) -> RouterNetwork:
    """Chain of five routers and a server ([Lee] Fig. 5-41) with the objects and cameras of a scenario, 1 to 3.

    `channel`: what the links between routers share; one of `CHANNELS`.
    """
    tracking, cameras = SCENARIOS[scenario]
    return RouterNetwork(
        links=(*pairwise(ROUTERS), ("R5", "server")),
        server="server",
        sensors=tuple(
            SensorNode(f"S{router[1:]}{k}", router, detects, share)
            for router in ROUTERS
            for k, (detects, share) in enumerate(DETECTED_ASSIGNED, start=1)
        ),
        cameras=tuple(CameraNode(f"V{k}", router) for k, router in enumerate(cameras, start=1)),
        objects=dict.fromkeys(tracking, 100),
        channel=channel,
    )


def end_to_end(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of the largest end-to-end delay [s] by scenario, channel and protocol, against image size [kB] and share.

    Nothing is drawn at random, so that both arguments are ignored.
    """
    rows = []
    for scenario in SCENARIOS:
        for channel in CHANNELS:
            for case in _cases(scenario, channel, IMAGES_KB, (USUAL_SHARE,)):
                name = f"{scenario}, {case.protocol}, {channel}"
                rows.append(PaperRow(name, case.image_kb, (case.delay_s,), plotted=channel == SHARED))
        for case in _cases(scenario, SHARED, (USUAL_KB,), SHARES):
            rows.append(PaperRow(f"{scenario}, {case.protocol}, by share", case.share, (case.delay_s,), plotted=False))
    return rows


def hop_by_hop(size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """Table of the mean delay of a hop [s] by kind of message and scenario, with the printed delay where there is one.

    Nothing is drawn at random, so that both arguments are ignored.
    """
    rows = []
    for scenario, printed in PRINTED.items():
        for case in _cases(scenario, SHARED, (USUAL_KB,), (USUAL_SHARE,)):
            found = hop_delays(case)
            for kind, values in printed.items():
                paper = values[PROTOCOLS.index(case.protocol)]
                if kind in found and paper is not None:
                    name = f"{case.protocol}, {kind}"
                    rows.append(PaperRow(name, float(scenario), (found[kind],), {"printed": paper}))
            images = [m for m in case.cycle.messages if m.kind == "visual sensing data"]
            air = sum(m.air_s for m in images)
            rows.append(PaperRow(f"{case.protocol}, {AIR}", float(scenario), (air,), plotted=False))
    return rows


def _cases(scenario: int, channel: str, images_kb: tuple[float, ...], shares: tuple[float, ...]) -> list[TrafficCase]:
    """Simulated cycles of both protocols in a scenario with a kind of channel, at each image size [kB] and share."""
    config = TrafficConfig(image_kb=images_kb, objects_share=shares)
    return list(simulate_traffic(network(scenario, channel), config))


def judge_end_to_end(table: Table) -> list[StatementVerdict]:
    """Verdicts on the orderings that the text states, from the table of `end_to_end`; nothing has an error bar."""
    out = []
    for scenario, (low, high) in {1: PROTOCOLS, 2: PROTOCOLS[::-1], 3: PROTOCOLS[::-1]}.items():
        for channel in CHANNELS:
            points = v.matched(table, f"{scenario}, {low}, {channel}", f"{scenario}, {high}, {channel}")
            statement = f"Scenario {scenario}: {low.upper()} has a lower delay than {high.upper()}; channel: {channel}."
            gaps = [b.mean - a.mean for a, b in points]
            out.append(_ordered(f"traffic-{scenario}-{channel}", statement, gaps, "image sizes"))
    for channel in CHANNELS:
        points = v.matched(table, f"3, sbvc, {channel}", f"2, sbvc, {channel}")
        statement = (
            f"Images get to the server sooner from R5: SBVC is faster in scenario 3 than in 2; channel: {channel}."
        )
        out.append(
            _ordered(f"traffic-closer-{channel}", statement, [b.mean - a.mean for a, b in points], "image sizes")
        )
    sizes, shares = [], []
    for scenario in SCENARIOS:
        for protocol in PROTOCOLS:
            by_size = v.series(table, f"{scenario}, {protocol}, {SHARED}")
            by_share = v.series(table, f"{scenario}, {protocol}, by share")
            sizes += [b.mean - a.mean for a, b in pairwise(by_size)]
            shares += [b.mean - a.mean for a, b in pairwise(by_share)]
    out.append(_ordered("traffic-size", "The delay grows with the size of images.", sizes, "steps"))
    out.append(_ordered("traffic-share", "The delay grows with the share of tracked objects.", shares, "steps"))
    ratios = []
    for scenario in SCENARIOS:
        for protocol in PROTOCOLS:
            by_size = v.series(table, f"{scenario}, {protocol}, {SHARED}")
            by_share = v.series(table, f"{scenario}, {protocol}, by share")
            ratios.append((by_size[-1].mean / by_size[0].mean) - (by_share[-1].mean / by_share[0].mean))
    statement = "Ten times larger images delay more than ten times more objects (factor of the delay higher by this)."
    out.append(_ordered("traffic-more-by-size", statement, ratios, "scenarios and protocols"))
    return out


def judge_hops(table: Table) -> list[StatementVerdict]:
    """Verdicts on the orderings of the printed hop-by-hop delays, from the table of `hop_by_hop`.

    The numbers themselves depend on settings that the thesis does not give.
    """
    out = []
    for scenario in PRINTED:
        for kind in ("visual sensing data", "final estimation data"):
            low = v.row_of(table, f"sbvc, {kind}", float(scenario))
            high = v.row_of(table, f"rbvc, {kind}", float(scenario))
            statement = f"Scenario {scenario}: a hop of {kind} takes longer with RBVC."
            key = f"hops-{scenario}-{kind.split()[0]}"
            out.append(_ordered(key, statement, [high.mean - low.mean], "difference"))
        air = [v.row_of(table, f"{p}, {AIR}", float(scenario)) for p in PROTOCOLS]
        statement = f"Scenario {scenario}: the sum of visual sensing is larger with RBVC."
        out.append(_ordered(f"hops-{scenario}-sum", statement, [air[0].mean - air[1].mean], "difference"))
    return out


def _ordered(key: str, statement: str, gaps: list[float], of: str) -> StatementVerdict:
    """Verdict on whether all gaps are above 0; the smallest is shown.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        gaps: differences of delays [s], or of ratios, that the statement has above 0.
        of: words for what the gaps are taken over, for the rule of the verdict.
    """
    points = [v.StatementPoint(exact(gap), v.above(0.0)) for gap in gaps]
    shown = exact(min(gaps)) if gaps else None
    return v.judge_points(
        key, statement, points, rule=f"in this order ({of}); shown: the smallest difference", shown=shown
    )


_experiment = functools.partial(Experiment, runs=1, steps=1, quick=(1, 1))
TRAFFIC_EXPERIMENTS = (
    _experiment(
        item="traffic",
        title="End-to-end delays of RBVC and SBVC",
        x_label="size of an image [kB]",
        y_label="delay [s]",
        compute=end_to_end,
        judge=judge_end_to_end,
        note="Packets of 1 kB, 2 Mb/s, acknowledgements of 40 bytes; the thesis does not give its settings of NS-2, so "
        "that only orderings are judged. Plotted: links that share one channel.",
    ),
    _experiment(
        item="traffic-hops",
        title="Hop-by-hop delays of RBVC and SBVC",
        x_label="scenario",
        y_label="mean delay of a hop [s]",
        compute=hop_by_hop,
        judge=judge_hops,
        note="Images of 40 kB, a tenth of the objects, one channel; printed delays are in the table.",
    ),
)
