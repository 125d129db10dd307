"""IngestService: scans as they are taken."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

from revisit.core.errors import ErrorCode, RevisitError
from revisit.service.calls.loops import loop_fields
from revisit.service.domain.callers import current_tenant
from revisit.service.domain.errors import Draining, NotFound, StreamFenced
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.features.ingest.appending import ScanAck, ScanStream
from revisit.service.features.ingest.calls import OpenedStream, ResumePoint
from revisit.service.status import STATUS, retry_after_s
from revisit.service.use_cases import UseCases
from revisit.service.wire import names
from revisit.service.wire.fields import fields_of
from revisit.service.wire.requests import append_scan
from revisit.v1 import ingest_pb2 as pb

CREDITS = 32
"""Scans a client may have unanswered. Further ones wait in its own socket: one scan is read at a time."""

WINDOW_BYTES = 8 * 2**20
"""Bytes of clouds that a client may have unanswered."""

UNREAD_LIMIT_S = 60.0
"""A client that reads no answers for so long loses its stream."""

DRAIN_POLL_S = 0.1


class StreamNotOpen(RevisitError):
    """The first message of a stream must be Open, and only the first."""

    code = ErrorCode.MALFORMED_BODY


class ClientReadsNothing(RevisitError):
    """The client reads no answers."""

    code = ErrorCode.RATE


class ScanStreams:
    """IngestService: runs each stream as a `_ScanStream`; the newest stream of a session fences the older one."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._use_cases = use_cases
        self._streams: dict[tuple[TenantId, SessionKey], _ScanStream] = {}

    async def stream(
        self, requests: AsyncIterator[pb.StreamScansRequest], _context: Any
    ) -> AsyncIterator[pb.StreamScansResponse]:
        """See the proto file for the rules."""
        opening = await _open_of(requests)
        tenant, session = current_tenant(), names.session_key(opening.session, "session")
        scans, resume = self._use_cases.scans, ResumePoint(opening.resume_token, opening.acknowledged_seq)
        opened = await scans.open(tenant, session, resume)
        stream = _ScanStream(self._use_cases, tenant, opened)
        older = self._streams.get(stream.key)
        with scans.reserve_stream(tenant, replaces=older is not None):
            self._streams[stream.key] = stream
            if older is not None:
                older.fence()
            async for response in self._answers(stream, opened, requests, opening):
                yield response

    async def _answers(
        self,
        stream: _ScanStream,
        opened: OpenedStream,
        requests: AsyncIterator[pb.StreamScansRequest],
        opening: pb.Open,
    ) -> AsyncIterator[pb.StreamScansResponse]:
        try:
            yield pb.StreamScansResponse(opened=_opened(opened))
            async for response in stream.run(requests, opening):
                yield response
        finally:
            if self._streams.get(stream.key) is stream:
                del self._streams[stream.key]


class _ScanStream:
    """One open stream: a reader answers scans in order, watchers report loops and the drain, all into one queue."""

    def __init__(self, use_cases: UseCases, tenant: TenantId, opened: OpenedStream) -> None:
        self.tenant = tenant
        self.session = opened.session
        self._use_cases = use_cases
        self._fenced = asyncio.Event()
        self._scans = ScanStream.of(opened.session_number)
        self._committed_seq = opened.committed_seq
        self._handler: asyncio.Task[Any] = asyncio.current_task()  # type: ignore[assignment]  # made by its call
        self._answers: asyncio.Queue[pb.StreamScansResponse | None] = asyncio.Queue(maxsize=2 * CREDITS)

    @property
    def key(self) -> tuple[TenantId, SessionKey]:
        """The key of a stream: only one may be open for it."""
        return (self.tenant, self.session)

    def fence(self) -> None:
        """End this stream: a newer one took over."""
        self._fenced.set()

    async def run(
        self, requests: AsyncIterator[pb.StreamScansRequest], opening: pb.Open
    ) -> AsyncIterator[pb.StreamScansResponse]:
        """The answers, until the client is done, the service drains, another stream takes over or the session goes."""
        reasons = (self._read(requests), self._drain(), self._watch_fence(), self._watch_deletion())
        enders = [asyncio.create_task(work) for work in reasons]
        extras = []
        if opening.watch_loop_closures:
            extras.append(asyncio.create_task(self._watch_loops(opening.loop_closures_after)))
        closer = asyncio.create_task(self._close_after(enders))
        try:
            while (answer := await self._answers.get()) is not None:
                yield answer
            await closer
        finally:
            await _stop([*enders, *extras, closer])

    async def _close_after(self, enders: list[asyncio.Task[None]]) -> None:
        done, _ = await asyncio.wait(enders, return_when=asyncio.FIRST_COMPLETED)
        try:
            await asyncio.wait_for(self._answers.put(None), UNREAD_LIMIT_S)
        except TimeoutError:
            # The answers hang in a write that nobody reads: only cancelling that gives the stream's place back.
            self._handler.cancel()
        for task in done:
            task.result()

    async def _read(self, requests: AsyncIterator[pb.StreamScansRequest]) -> None:
        async for request in requests:
            kind = request.WhichOneof("request")
            if kind == "pose":
                await self._send(ack=pb.Ack(committed_seq=self._committed_seq))
                continue
            if kind != "scan":
                raise StreamNotOpen("after Open, a stream carries scans and poses only")
            try:
                await self._acknowledge(await self._append(request.scan))
            except Draining:
                await self._send(drain=pb.Drain())
                return
            except RevisitError as error:
                await self._refuse(request.scan.seq, error)

    async def _append(self, scan: pb.Scan) -> ScanAck:
        command = replace(append_scan(self.session, scan), stream=self._scans)
        ack = await self._use_cases.scans.append(self.tenant, command, patient=True)
        if not ack.replay:
            self._scans = self._scans.begun()
        return ack

    async def _acknowledge(self, ack: ScanAck) -> None:
        submap_seq = 0 if ack.submap is None else ack.submap.submap.seq
        self._committed_seq = ack.committed_seq
        told = pb.Ack(committed_seq=ack.committed_seq, credits=1, submap_seq=submap_seq, left_out=ack.left_out)
        await self._send(ack=told)
        if ack.submap is not None:
            posted = ack.submap
            finished = pb.SubmapFinished(
                name=posted.submap.key.name, operation=f"operations/{posted.operation.operation_id}"
            )
            await self._send(submap_finished=finished)

    async def _refuse(self, seq: int, error: RevisitError) -> None:
        """Answer a scan that was not stored; the stream lives. Raises where the session itself cannot go on."""
        if error.code in (ErrorCode.NOT_FOUND, ErrorCode.SESSION_FINISHED, ErrorCode.STREAM_FENCED):
            raise error
        status = STATUS[error.code]
        opened = await self._use_cases.scans.open(self.tenant, self.session)
        nack = pb.Nack(
            seq=seq,
            reason=error.code.value,
            retryable=status.retryable,
            message=error.message[:800],
            expected_seq=opened.committed_seq + 1,
            credits=1,
        )
        await self._send(nack=nack)
        delay_s = retry_after_s(error, status)
        if delay_s is not None:
            await self._send(throttle=pb.Throttle(retry_delay_s=delay_s))

    async def _drain(self) -> None:
        while not self._use_cases.system.draining:
            await asyncio.sleep(DRAIN_POLL_S)
        await self._send(drain=pb.Drain())

    async def _watch_fence(self) -> None:
        await self._fenced.wait()
        raise StreamFenced

    async def _watch_deletion(self) -> None:
        await self._use_cases.scans.deleted(self.tenant, self._scans.session_number)
        raise NotFound(f"session {self.session.name!r} was deleted"[:300])

    async def _watch_loops(self, after: int) -> None:
        with suppress(Draining):
            async for view in self._use_cases.loops.watch(
                self.tenant, self.session.map_id, after, self.session.session_id
            ):
                await self._send(loop_closed=pb.LoopClosed(loop_closure=loop_fields(view)))

    async def _send(self, **answer: Any) -> None:
        try:
            await asyncio.wait_for(self._answers.put(pb.StreamScansResponse(**answer)), UNREAD_LIMIT_S)
        except TimeoutError as error:
            raise ClientReadsNothing from error


def _opened(stream: OpenedStream) -> pb.Opened:
    marks = fields_of(pb.ScanMarks, stream.marks)
    return pb.Opened(**fields_of(pb.Opened, stream, credits=CREDITS, window_bytes=WINDOW_BYTES, marks=marks))


async def _open_of(requests: AsyncIterator[pb.StreamScansRequest]) -> pb.Open:
    async for request in requests:
        if request.WhichOneof("request") == "open":
            return request.open
        break
    raise StreamNotOpen


async def _stop(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
