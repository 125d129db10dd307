"""Files of which a part can be asked (RFC 9110, ranges of bytes), so that a download goes on where it broke off."""

from __future__ import annotations

import re

from fastapi import Response
from starlette.types import Receive, Scope, Send

from revisit.core.codec.map_layout import PIECE_BYTES
from revisit.service.capacity.byte_budget import ByteBudget
from revisit.service.domain.identity import TenantId
from revisit.service.features.publishing.calls import OpenMapFile
from revisit.service.rest.entity_tags import etag_of, is_known
from revisit.service.rest.files import send_body

MAP_FILE = "application/vnd.revisit.map+zip"

_ONE_RANGE = re.compile(r"bytes=([0-9]{0,18})-([0-9]{0,18})", re.ASCII)

Bytes = tuple[int, int]
"""From the first byte to before the last."""


class FileInRanges(Response):
    """A map file or one range of it, read piece by piece; its ETag is its hash."""

    def __init__(
        self,
        budget: ByteBudget,
        tenant: TenantId,
        file: OpenMapFile,
        byte_range: str | None,
        if_range: str | None,
        if_none_match: str | None,
    ) -> None:
        """The three are the headers of the request. Other ranges than one are answered with the whole file."""
        super().__init__()
        self._budget = budget
        self._tenant = tenant
        self._file = file
        etag = etag_of(file.record.sha256)
        current = if_range is None or if_range == etag
        self._wanted = asked_range(byte_range, file.layout.size) if current else None
        self._known = is_known(if_none_match, etag)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it. Raises WorkersBusy where the budget has no room, DataLoss."""
        size = self._file.layout.size
        if self._known:
            await self._empty(send, 304, {})
        elif self._wanted is not None and self._wanted[0] >= min(self._wanted[1], size):
            await self._empty(send, 416, {"content-range": f"bytes */{size}"})
        else:
            await self._bytes(send, self._wanted or (0, size), 200 if self._wanted is None else 206)

    async def _bytes(self, send: Send, wanted: Bytes, status: int) -> None:
        (start, end), size = wanted, self._file.layout.size
        ranged = {"content-range": f"bytes {start}-{end - 1}/{size}"} if status == 206 else {}
        with self._budget.hold(self._tenant) as held:
            await held.wait_for(PIECE_BYTES)
            headers = {**ranged, "content-type": MAP_FILE, "content-length": str(end - start), **self._name()}
            await send({"type": "http.response.start", "status": status, "headers": self._header_rows(headers)})
            await send_body(send, self._file.pieces(start, end))

    async def _empty(self, send: Send, status: int, headers: dict[str, str]) -> None:
        length = {"content-length": "0"} if status != 304 else {}
        await send(
            {"type": "http.response.start", "status": status, "headers": self._header_rows({**headers, **length})}
        )
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    def _name(self) -> dict[str, str]:
        view = self._file.record
        return {"content-disposition": f'attachment; filename="{view.map_id}-{view.version}.rvmap"'}

    def _header_rows(self, headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
        every = {"accept-ranges": "bytes", "etag": etag_of(self._file.record.sha256), **headers}
        return [(name.encode(), value.encode("latin-1")) for name, value in every.items()]


def asked_range(header: str | None, size: int) -> Bytes | None:
    """The range that a header asks of a file of `size` bytes; None for the whole.

    A range that begins behind the end of the file is empty.
    """
    found = None if header is None else _ONE_RANGE.fullmatch(header.replace(" ", ""))
    if found is None or found[1] == found[2] == "":
        return None
    if not found[1]:
        return max(0, size - int(found[2])), size
    start, end = int(found[1]), min(size, int(found[2]) + 1) if found[2] else size
    return None if found[2] and int(found[2]) < start else (start, end)
