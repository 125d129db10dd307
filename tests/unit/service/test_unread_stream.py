"""A client that sends scans and reads no answers (row S08)."""

from __future__ import annotations

import asyncio

from revisit.service.grpc import scan_streams
from revisit.v1 import ingest_pb2
from tests.support.patience import PATIENCE_S
from tests.support.service_world import SESSION, TENANT, memory_world, open_session


async def test_a_stream_whose_answers_nobody_reads_is_given_up(monkeypatch):
    monkeypatch.setattr(scan_streams, "UNREAD_LIMIT_S", 0.05)
    world = memory_world()
    await open_session(world)

    async def scans():
        while True:
            yield ingest_pb2.StreamScansRequest(scan=ingest_pb2.Scan(seq=7))  # each is answered with a Nack
            await asyncio.sleep(0)

    async def handler():
        stream = scan_streams._ScanStream(world.use_cases, TENANT, await world.use_cases.scans.open(TENANT, SESSION))
        async for _ in stream.run(scans(), ingest_pb2.Open()):
            await asyncio.Event().wait()  # the write that flow control holds back for ever

    call = asyncio.create_task(handler())
    await asyncio.wait([call], timeout=PATIENCE_S)
    assert call.cancelled()
