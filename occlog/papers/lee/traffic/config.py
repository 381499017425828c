"""Settings of `occlog traffic`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, listed, option_setting

PROTOCOLS = ("rbvc", "sbvc")
CHANNELS = ("shared", "node", "link")


@dataclass(frozen=True)
class TrafficConfig(Settings):
    """Traffic of the network: each protocol with each size of images and each share of objects."""

    OWNER: ClassVar[str] = "traffic"

    protocol: str = option_setting(
        "rbvc,sbvc",
        "Where images of cameras correct the estimated positions of objects: in the routers (rbvc) or in the server "
        "(sbvc); several separated by commas.",
        choices=PROTOCOLS,
        several=True,
        metavar="A,B",
    )
    image_kb: tuple[float, ...] = option_setting(
        (40.0,),
        "Size of a camera's image, in units of 1000 bytes. Several sizes are simulated one by one.",
        metavar="A,B,...",
    )
    objects_share: tuple[float, ...] = option_setting(
        (0.1,),
        "Share of each router's objects that are tracked: messages of estimates grow with it, images do not. Several "
        "shares are simulated one by one.",
        metavar="A,B,...",
    )
    channel: str | None = option_setting(
        None,
        "Shared resource of the links between routers: one channel (shared), a radio at each node (node), or nothing "
        "(link).",
        choices=CHANNELS,
        nothing="as stated in the network",
    )

    @property
    def protocols(self) -> tuple[str, ...]:
        """Distinct protocols that the setting `protocol` lists, in order."""
        return tuple(dict.fromkeys(listed(self.protocol)))

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Constraints, each as setting, whether it holds, and allowed values: sizes above 0, shares above 0 to 1."""
        yield "image_kb", min(self.image_kb) > 0.0 and max(self.image_kb) <= 1e5, "above 0 and at most 100000 each"
        shares = self.objects_share
        yield "objects_share", min(shares) > 0.0 and max(shares) <= 1.0, "above 0 and at most 1 each"
