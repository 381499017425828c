"""Discrete events by hand on two routers, and the orderings of the string of five."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from numpy.testing import assert_allclose

from occlog.papers.lee.traffic.network import (
    FINAL,
    VISUAL,
    CameraNode,
    NetworkSimulation,
    RouterNetwork,
    SensorNode,
    Sizes,
    simulate_cycle,
)

# 8000 bit/s: a byte takes 1 ms; packets of 100 bytes, acknowledgements of 10
TWO = RouterNetwork(
    links=(("R1", "R2"), ("R2", "server")),
    server="server",
    sensors=(SensorNode("S1", "R1", detects=10, assigned=1.0),),
    cameras=(CameraNode("V", "R2"),),
    objects={"R1": 10},
    rate_bps=8000.0,
    sizes=Sizes(packet=100, header=0, ack=10, detection=1, assigned=2, acoustic=3, estimate=4),
)


def test_one_packet_takes_its_time_on_each_hop() -> None:
    simulation, arrived = NetworkSimulation(TWO), {}
    simulation.at(0.0, lambda _: simulation.send("x", "R1", ("server",), 50, arrived=arrived.__setitem__))
    simulation.run()
    assert_allclose(arrived["server"], 0.100)
    (message,) = simulation.messages
    assert (message.packets, message.hops) == (1, 2)
    assert_allclose((message.air_s, message.hop_s), (0.100, 0.100))


@pytest.mark.parametrize(("channel", "end"), [("shared", 0.400), ("node", 0.400), ("link", 0.300)])
def test_two_packets_share_the_channel_or_follow_each_other(channel: str, end: float) -> None:
    # Two packets of 100 ms over two hops: 4 x 100 on one channel (and at R2, whose radio does one thing at a time);
    # on links of their own the second packet is on the first link while the first one is on the second
    simulation, arrived = NetworkSimulation(replace(TWO, channel=channel)), {}
    simulation.at(0.0, lambda _: simulation.send("x", "R1", ("server",), 200, arrived=arrived.__setitem__))
    simulation.run()
    assert_allclose(arrived["server"], end)


def test_acknowledgements_occupy_the_channel_but_packets_go_on() -> None:
    simulation, arrived = NetworkSimulation(TWO), {}
    simulation.at(
        0.0, lambda _: simulation.send("x", "R1", ("server",), 100, arrived=arrived.__setitem__, reliable=True)
    )
    simulation.run()
    assert_allclose(arrived["server"], 0.210)  # 100, acknowledgement 10, 100
    assert_allclose(simulation.messages[0].air_s, 0.220)


def test_a_message_to_several_goes_over_each_link_once() -> None:
    simulation, arrived = NetworkSimulation(TWO), {}
    simulation.at(0.0, lambda _: simulation.send("x", "R1", ("R2", "server"), 100, arrived=arrived.__setitem__))
    simulation.run()
    assert simulation.messages[0].hops == 2
    assert_allclose((arrived["R2"], arrived["server"]), (0.100, 0.200))


def test_a_message_to_oneself_is_there_at_once() -> None:
    simulation, arrived = NetworkSimulation(TWO), {}
    simulation.at(0.5, lambda _: simulation.send("x", "R1", ("R1",), 300, arrived=arrived.__setitem__))
    simulation.run()
    assert arrived == {"R1": 0.5}
    assert simulation.messages[0].hops == 0


def test_a_cycle_of_rbvc_by_hand() -> None:
    # Sensors: detection 10, assigned 20, acoustic 30 ms on their own channel: heard at 60.
    # Image of 100 bytes: camera to R2 until 100, then R2 to R1 from 100 to 200 with its acknowledgement until 210.
    # Final estimate of 40 bytes: asked for at 200, on the air from 210 to 250 and from 250 to 290.
    found = simulate_cycle(TWO, "rbvc", 100.0, 1.0)
    assert_allclose(found.delays["R1"], 0.290)


def test_a_cycle_of_sbvc_by_hand() -> None:
    # The acoustic estimate of 40 bytes goes to the server from 60 to 100 and from 100 to 140; the image waits at R2
    # from 100 on and goes from 140 to 240 (acknowledgement until 250); final: 250 to 290, 290 to 330.
    found = simulate_cycle(TWO, "sbvc", 100.0, 1.0)
    assert_allclose(found.delays["R1"], 0.330)


def test_estimates_take_their_time() -> None:
    slow = simulate_cycle(replace(TWO, processing_s=0.5), "rbvc", 100.0, 1.0)
    # Heard at 60, estimated at 560, corrected at 1060, 80 ms to the server
    assert_allclose(slow.delays["R1"], 1.140)


ROUTERS = tuple(f"R{n}" for n in range(1, 6))
STRING = RouterNetwork(
    links=(*pairwise(ROUTERS), ("R5", "server")),
    server="server",
    sensors=tuple(
        SensorNode(f"S{r}{k}", r, detects, share)
        for r in ROUTERS
        for k, (detects, share) in enumerate(((30, 0.3), (40, 0.3), (50, 0.4)))
    ),
    cameras=(CameraNode("V1", "R2"), CameraNode("V2", "R4")),
    objects=dict.fromkeys(ROUTERS, 100),
)


def test_images_of_rbvc_go_over_eight_links_and_those_of_sbvc_over_six() -> None:
    hops = {}
    for protocol in ("rbvc", "sbvc"):
        found = simulate_cycle(STRING, protocol, 40e3, 0.1)
        images = [m for m in found.messages if m.kind == VISUAL]
        # 40 packets, and the hop from each camera to its router
        hops[protocol] = [m.hops // 40 - 1 for m in images]
        assert len([m for m in found.messages if m.kind == FINAL]) == 5
    assert hops == {"rbvc": [4, 4], "sbvc": [4, 2]}


@pytest.mark.parametrize(("protocol", "independent"), [("rbvc", 1.346), ("sbvc", 1.027)])
def test_delays_are_those_of_an_independent_implementation(protocol: str, independent: float) -> None:
    found = simulate_cycle(STRING, protocol, 40e3, 0.1)
    assert_allclose(max(found.delays.values()), independent, rtol=0.01)
