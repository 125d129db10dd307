"""What a database holds in the end, against what was acknowledged and what one worker finds in the order of entry."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import create_engine, text
from sqlalchemy.engine import URL

from revisit.core.config import PipelineConfig
from revisit.service.domain.identity import SessionKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from tests.support.drives_on_a_road import loops_of
from tests.support.service_world import TENANT, memory_world, submap


@dataclass(frozen=True)
class Store:
    """A database on PostgreSQL."""

    url: URL

    def rows(self, query: str) -> list[Any]:
        """What it answers."""
        engine = create_engine(self.url)
        with engine.connect() as connection:
            found = list(connection.execute(text(query)).all())
        engine.dispose()
        return found


ALIKE = 0.9
"""Similarity from which two submaps show the same place. Which of all others are compared, chance tells."""

LEFT = """
SELECT j.subject, j.state, j.attempts, j.not_before_ms, j.lease_owner, s.entered, s.searched
FROM jobs j JOIN submaps s ON s.operation_id = j.operation_id
WHERE j.kind = 'DESCRIBE_SUBMAP' AND j.state IN ('QUEUED', 'RUNNING')
"""


def worked_off(store: Store, timeout_s: float = 1800.0) -> None:
    """Wait until no job is left. Raises AssertionError with those that are."""
    until_s = time.monotonic() + timeout_s
    while left := store.rows(LEFT):
        assert time.monotonic() < until_s, (len(left), left[:20])
        time.sleep(0.2)


def serially(rows: Sequence[Any]) -> dict[tuple[str, str], Any]:
    """The loops between alike places that one worker finds in the order of entry. `rows` are those of the submaps."""
    world = memory_world(pipeline=PipelineConfig(), optimise_after_loops=0, max_queued_jobs=10**6)

    async def post() -> None:
        await world.use_cases.maps.create(TENANT, CreateMap("town", leave_distance_m=0.0))
        for session_id in sorted({row.session_id for row in rows}):
            await world.use_cases.sessions.create(TENANT, CreateSession("town", session_id))
        for row in sorted(rows, key=lambda row: (row.session_id, row.ordinal)):
            session = SessionKey("town", row.session_id)
            await world.use_cases.posting.post(TENANT, submap(row.submap_id, row.stamp_ns, session))

    asyncio.run(post())
    leases = {}
    while (lease := world.claim(f"w{len(leases)}")) is not None:
        leases[lease.job.subject.rpartition("/")[2]] = lease
    worker = world.worker()
    for row in sorted(rows, key=lambda row: row.entered):
        worker.run(leases[row.submap_id])
    found = loops_of(world).items()
    return {(query[1], match[1]): verdict[:2] for (query, match), verdict in found if verdict[2] > ALIKE}


def require_all(store: Store, acknowledged: Collection[str]) -> None:
    """Each acknowledged submap is there once and described, no number is missing, loops are those of one worker."""
    rows = store.rows("SELECT session_id, submap_id, stamp_ns, entered, ordinal, state FROM submaps")
    names = [row.submap_id for row in rows]
    assert len(names) == len(set(names)) and set(acknowledged) <= set(names)
    assert {row.state for row in rows} == {"DESCRIBED"}
    for numbers in ("SELECT seq FROM events WHERE map_id = 'town'", "SELECT seq FROM index_changes"):
        given = sorted(row[0] for row in store.rows(numbers))
        assert given == list(range(1, len(given) + 1)), numbers
    loops = store.rows("SELECT query_submap_id, match_submap_id, state, reason, similarity FROM loop_closures")
    entered = {row.submap_id: row.entered for row in rows}
    assert [(loop, entered) for loop in loops if entered[loop[1]] >= entered[loop[0]]] == []
    found = {(query, match): (state, reason) for query, match, state, reason, similarity in loops if similarity > ALIKE}
    expected = serially(rows)
    assert len(expected) >= len(names) - len({row.stamp_ns for row in rows})
    assert sorted(found.items() ^ expected.items()) == []
