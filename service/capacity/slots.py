"""Slots: how many calls, waits and watches may be open at the same time, shared between their holders."""

from __future__ import annotations

from revisit.service.capacity.budget import Held
from revisit.service.capacity.limits import SLOT_RETRY_S, Share
from revisit.service.domain.errors import RateLimited


class Slots:
    """Counts the slots of one kind that are held. All calls come from the event loop."""

    def __init__(self, share: Share) -> None:
        self._share = share
        self._of_group: Held[str] = Held()
        self._of_holder: Held[tuple[str, str]] = Held()

    @property
    def held(self) -> int:
        """Slots that are held, of all groups."""
        return self._of_group.total()

    def take(self, group: str, holder: str) -> None:
        """One more for a holder of a group. Raises RateLimited where none is to be had."""
        share, own = self._share, self._of_group[group]
        room = share.beside(self.held - own)
        if self._of_holder[group, holder] >= share.holder:
            raise _none_free(f"{share.holder} {share.what} of this {share.names[1]}")
        if room == 0:
            raise _none_free(f"{share.most} {share.what}")
        if own >= room:
            beside = "" if own >= share.group else " beside those of others"
            raise _none_free(f"{own} {share.what} of this {share.names[0]}{beside}")
        self.take_back(group, holder)

    def take_back(self, group: str, holder: str) -> None:
        """One more in any case: for a call that has given up its slot for a while, and goes on."""
        self._of_group.add(group, 1)
        self._of_holder.add((group, holder), 1)

    def give(self, group: str, holder: str) -> None:
        """One less."""
        self._of_group.add(group, -1)
        self._of_holder.add((group, holder), -1)


def _none_free(held: str) -> RateLimited:
    return RateLimited(f"{held} are open; close one first", retry_after_s=SLOT_RETRY_S)
