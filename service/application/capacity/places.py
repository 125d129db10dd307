"""Places: how many calls and watches each holder may have open at the same time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from revisit.service.application.contract.errors import RateLimited

RETRY_S = 1.0
"""When to come back where no place is free."""


@dataclass(frozen=True)
class Claim:
    """One more place for `holder`, which may have `most`; `what` names the places to the client."""

    holder: tuple[str, ...]
    most: int
    what: str


class Places:
    """Counts the places that are held. All calls come from the event loop."""

    def __init__(self) -> None:
        self._held: Counter[tuple[str, ...]] = Counter()

    def held(self, *holder: str) -> int:
        """The places of `holder`."""
        return self._held[holder]

    @contextmanager
    def hold(self, *claims: Claim) -> Iterator[None]:
        """Hold a place of each claim until the block ends. Raises RateLimited where one is not to be had."""
        for claim in claims:
            if self._held[claim.holder] >= claim.most:
                raise RateLimited(f"{claim.most} {claim.what} are open; close one first", retry_after_s=RETRY_S)
        for claim in claims:
            self._held[claim.holder] += 1
        try:
            yield
        finally:
            for claim in claims:
                self._leave(claim.holder)

    def _leave(self, holder: tuple[str, ...]) -> None:
        self._held[holder] -= 1
        if not self._held[holder]:
            del self._held[holder]
