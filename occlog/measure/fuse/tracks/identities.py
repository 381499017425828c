"""Identities of people whom several groups of cameras follow: they go over from one group to the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

Member = tuple[int, int]
"""Group of cameras, and identity there."""
NOBODY = -1


@dataclass
class Identities:
    """Who is who, moment by moment.

    A person is followed by tracks of one group or of several; while one of these tracks goes on, the person keeps the
    identity.  Of tracks that part one keeps it: the one that has had it for longest.

    Attributes:
        doubts: pairs of identities that may have been exchanged in the last moment.
    """

    doubts: list[tuple[int, int]] = field(default_factory=list)
    _held: dict[Member, int] = field(default_factory=dict)  # the identity that a track has now
    _own: dict[Member, int] = field(default_factory=dict)  # the first identity that a track had
    _next: int = 0

    def step(self, people: list[tuple[Member, ...]]) -> list[int]:
        """Give an identity to each person, who is a set of tracks, at the next moment."""
        self.doubts = []
        taken: dict[int, int] = {}
        # The oldest identity goes first, to those whose tracks have had it all along
        for identity, place in self._claims(people):
            if identity not in taken and place not in taken.values():
                taken[identity] = place
        given = {place: identity for identity, place in taken.items()}
        for place, members in enumerate(people):
            identity = given.get(place, NOBODY)
            if identity == NOBODY:
                identity = given[place] = self._again(members, taken)
                taken[identity] = place
            before = {self._held[m] for m in members if m in self._held} - {identity}
            self.doubts += [(identity, other) for other in sorted(before)]
            for member in members:
                self._held[member] = identity
                self._own.setdefault(member, identity)
        return [given[place] for place in range(len(people))]

    def _claims(self, people: list[tuple[Member, ...]]) -> Iterator[tuple[int, int]]:
        """Identities and who claims them, the oldest first; tracks that had one from the start come first."""
        claims = [
            (self._held[m], self._own[m] != self._held[m], m, place)
            for place, members in enumerate(people)
            for m in members
            if m in self._held
        ]
        for identity, _, _, place in sorted(claims):
            yield identity, place

    def _again(self, members: tuple[Member, ...], taken: dict[int, int]) -> int:
        """The identity that a track had before it was taken for another one's; else a new one."""
        for member in members:
            own = self._own.get(member)
            if own is not None and own not in taken:
                return own
        self._next += 1
        return self._next - 1
