"""Scans of many robots that wait are stored together, each as if it had come alone."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

import pytest

from revisit.core.errors import BadField
from revisit.service.domain.errors import AlreadyExists, SequenceGap, SessionFinished, StreamFenced
from revisit.service.domain.identity import SessionKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.ingest.appending import ScanStream
from tests.support.service_world import TENANT, postgres_world, scan, sqlite_world

ROBOTS = 8
SCANS = 12


@pytest.fixture(params=["sqlite", "postgres"])
def world(request, tmp_path):
    if request.param == "postgres":
        request.getfixturevalue("postgres_url")
    made = {"sqlite": lambda: sqlite_world(tmp_path), "postgres": postgres_world}
    world = made[request.param]()
    yield world
    world.context.transactions.close()


async def robots(world, count=ROBOTS):
    """Sessions of one map, each with a stream."""
    await world.use_cases.maps.create(TENANT, CreateMap("town"))
    keys = [SessionKey("town", f"robot-{number}") for number in range(count)]
    for key in keys:
        await world.use_cases.sessions.create(TENANT, CreateSession(key.map_id, key.session_id))
    opened = [await world.use_cases.scans.open(TENANT, key) for key in keys]
    return {key: ScanStream.of(one.session_number) for key, one in zip(keys, opened, strict=True)}


async def drive(world, key, stream, scans=SCANS):
    acks = []
    for seq in range(1, scans + 1):
        acks.append(
            await world.use_cases.scans.append(TENANT, replace(scan(seq, float(seq), key), stream=stream), patient=True)
        )
        stream = stream.begun()
    return acks


async def test_scans_of_many_robots_are_stored_in_fewer_transactions_and_cut_as_if_alone(world, monkeypatch):
    streams, written = await robots(world), []
    write = type(world.context.transactions).write
    monkeypatch.setattr(
        type(world.context.transactions), "write", lambda *given, **named: written.append(1) or write(*given, **named)
    )
    of_robots = await asyncio.gather(*(drive(world, *one) for one in streams.items()))
    monkeypatch.undo()
    assert len(written) < ROBOTS * SCANS
    alone = SessionKey("town", "alone")
    await world.use_cases.sessions.create(TENANT, CreateSession("town", "alone"))
    expected = [await world.use_cases.scans.append(TENANT, scan(seq, float(seq), alone)) for seq in range(1, SCANS + 1)]
    assert sum(ack.submap is not None for ack in expected) == 1
    for acks in of_robots:
        assert [ack.committed_seq for ack in acks] == list(range(1, SCANS + 1))
        assert [ack.submap is not None for ack in acks] == [ack.submap is not None for ack in expected]

    def stored(uow):
        return [
            [(one.seq, one.travelled_m, one.cloud_sha256) for one in uow.scans.find(TENANT, session_id=key.session_id)]
            for key in (*streams, alone)
        ] + [
            (one.committed_seq, one.travelled_m, one.window_start_m, one.window_first_seq, one.next_ordinal)
            for one in uow.sessions.find(TENANT)
        ]

    rows = world.context.transactions.read(stored).result()
    assert all(one == rows[ROBOTS] for one in rows[: ROBOTS + 1]) and len(rows[0]) == SCANS
    assert all(one == rows[-1] for one in rows[ROBOTS + 1 :])


async def test_a_scan_that_is_refused_does_not_hold_up_those_beside_it(world):
    streams = await robots(world)
    (fenced, old), (gap, _), (back, _), (other, _), (ended, _), *sound = streams.items()
    append = partial(world.use_cases.scans.append, patient=True)
    await asyncio.gather(*(drive(world, key, stream, 3) for key, stream in streams.items()))
    newer = ScanStream.of(old.session_number)
    await append(TENANT, replace(scan(4, 4.0, fenced), stream=newer))
    await world.use_cases.sessions.finish(TENANT, ended)
    calls = [
        append(TENANT, replace(scan(5, 5.0, fenced), stream=old.begun())),
        append(TENANT, scan(6, 6.0, gap)),
        append(TENANT, replace(scan(4, 4.0, back), stamp_ns=1)),
        append(TENANT, scan(3, 9.0, other)),
        append(TENANT, replace(scan(4, 4.0, ended), stream=streams[ended].begun())),
        *(append(TENANT, replace(scan(4, 4.0, key), stream=stream.begun())) for key, stream in sound),
    ]
    outcomes = await asyncio.gather(*calls, return_exceptions=True)
    refused = [StreamFenced, SequenceGap, BadField, AlreadyExists, SessionFinished]
    assert [type(one) for one in outcomes[: len(refused)]] == refused
    assert [one.committed_seq for one in outcomes[len(refused) :]] == [4] * len(sound)


async def test_a_stream_reads_its_session_no_more_once_it_holds_it(world, monkeypatch):
    (key, stream), *_ = (await robots(world, 1)).items()
    await drive(world, key, stream, 2)
    read = []
    monkeypatch.setattr(type(world.context.transactions), "read", lambda *_: read.append(1))
    ack = await world.use_cases.scans.append(TENANT, replace(scan(3, 3.0, key), stream=stream.begun()))
    assert (ack.committed_seq, read) == (3, [])
