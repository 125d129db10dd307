"""The open streams, which end when their session is deleted: an idle stream would not notice by itself."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from revisit.service.domain.identity import SessionKey, TenantId


class OpenStreams:
    """The open streams and whether their session is gone. All calls come from the event loop."""

    def __init__(self) -> None:
        self._open: list[tuple[TenantId, SessionKey, asyncio.Event]] = []

    @contextmanager
    def deletion_of(self, tenant: TenantId, session: SessionKey) -> Iterator[asyncio.Event]:
        """While a stream is open: set once its session was deleted. To be entered before the session is looked up."""
        entry = (tenant, session, asyncio.Event())
        self._open.append(entry)
        try:
            yield entry[2]
        finally:
            self._open.remove(entry)

    def end(self, tenant: TenantId, map_id: str, session_id: str | None = None) -> None:
        """A session was deleted, or a map with all its sessions."""
        for owner, session, ended in self._open:
            if (owner, session.map_id) == (tenant, map_id) and session_id in (None, session.session_id):
                ended.set()
