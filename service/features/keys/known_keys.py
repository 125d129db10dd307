"""A cache of API keys, read again only after a commit (docs/decisions/0221)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from revisit.service.ports.access import KeyRecord, KeyRing
from revisit.service.ports.storage import Storage

T = TypeVar("T")

MOST_KNOWN = 1000
"""Answers that are kept; of keys that do not exist, none is."""

_EMPTY = ""
"""No key has this id: the entry under it says whether there is any key."""


class KnownKeys:
    """The keys in a store, as they are at the time of asking. All calls come from the event loop."""

    def __init__(self, storage: Storage) -> None:
        """Begins with nothing known."""
        self._storage = storage
        self._version: int | None = None
        self._known: dict[str, object] = {}

    async def is_empty(self) -> bool:
        """Whether no key was ever created."""
        return cast(bool, await self._read(_EMPTY, lambda keys: keys.is_empty()))

    async def get(self, key_id: str) -> KeyRecord | None:
        """The key of this id."""
        return cast("KeyRecord | None", await self._read(key_id, lambda keys: keys.get(key_id)))

    async def _read(self, asked: str, ask: Callable[[KeyRing], T]) -> object:
        """The cached answer to `asked`, or the store's: never older than the last commit before this call."""
        version = self._storage.transactions.version()
        if version is None or version != self._version or len(self._known) >= MOST_KNOWN:
            self._version = version
            self._known.clear()
        if asked in self._known:
            return self._known[asked]
        answer = await self._storage.read(lambda uow: ask(uow.keys))
        # Read after `version` was asked for: it holds as long as that is still the number.
        if version is not None and version == self._version and answer is not None:
            self._known[asked] = answer
        return answer
