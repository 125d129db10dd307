"""A store with as many described submaps as wanted, made without the service."""

from __future__ import annotations

from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import insert, update

from lab.distractors import made_up_places
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.engines.local.sqlite.migration import migrate
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.sql import tables
from revisit.service.ports.blobs import CLOUD_BLOB
from tests.support.records import TENANT, a_loop, a_map, a_session, a_submap

Vectors = NDArray[np.float32]

PORTION = 2000
SPACING_M = 5.0


def fill(home: Path, submaps: int, dimension: int) -> None:
    """A home with maps/town/sessions/monday: submaps s1, s2, ... of one cloud with random unit descriptors."""
    fill_sessions(home, {"monday": submaps}, dimension)


def fill_sessions(
    home: Path, sizes: dict[str, int], dimension: int, *, loops: bool = False, pool: Vectors | None = None
) -> None:
    """A home with these sessions of maps/town, so many submaps in each; s1, s2, ... counts through all of them.

    With `loops`, each submap has an accepted loop closure with the one before it in its session. Descriptors are
    random; or made up from those of a `pool` (n, d) of real places, and places of a session then lie 5 m apart.
    """
    home.mkdir(exist_ok=True)
    migrate(home / "revisit.db")
    store = SqliteTransactions(home / "revisit.db", checkpoints=True)
    rng = np.random.default_rng(1)
    numbers = store.write(lambda uow: _add_map(uow, list(sizes))).result()
    cloud_sha256 = FileBlobStore(home / "blobs").put(TENANT, CLOUD_BLOB, b"a cloud")
    first = 1
    for session_id, count in sizes.items():
        for start in range(0, count, PORTION):
            ordinals = range(start, min(start + PORTION, count))
            vectors = (
                _random(len(ordinals), dimension, rng) if pool is None else made_up_places(pool, len(ordinals), rng)
            )
            described = {"state": "DESCRIBED", "cloud_sha256": cloud_sha256, "session_id": session_id}
            described["session_number"] = numbers[session_id]
            records = [
                a_submap(f"s{first + n}", number=first + n, ordinal=n, descriptor=vector.tobytes(), **described)
                for n, vector in zip(ordinals, vectors, strict=True)
            ]
            if pool is not None:
                records = [replace(one, position_m=(SPACING_M * one.ordinal, 0.0, 0.0)) for one in records]
            found = _chained(records) if loops else []
            store.write(lambda uow, records=records, found=found: _add(uow, numbers["map"], records, found)).result()
        first += count
    store.close()


def _random(count: int, dimension: int, rng: np.random.Generator) -> Vectors:
    vectors = rng.normal(size=(count, dimension)).astype("<f4")
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _add_map(uow, session_ids: list[str]) -> dict[str, int]:
    numbers = {"map": uow.maps.add(a_map()).number}
    return numbers | {session_id: uow.sessions.add(a_session(session_id)).number for session_id in session_ids}


def _chained(records) -> list[dict]:
    """The rows of loop closures between submaps that follow each other."""
    rows = []
    for match, query in pairwise(records):
        ids = {"query_session_id": query.session_id, "query_submap_id": query.submap_id}
        ids |= {"match_session_id": match.session_id, "match_submap_id": match.submap_id}
        rows.append(asdict(replace(a_loop(query.number, match.number), **ids)))
    return [{name: value for name, value in row.items() if name != "number"} for row in rows]


def _add(uow, map_number: int, records, loops: list[dict]) -> None:
    change = {"tenant": TENANT, "map_number": map_number, "kind": "DESCRIBED"}
    numbered = [{**asdict(record), "seq": record.number, "entered": record.number} for record in records]
    uow.connection.execute(insert(tables.submaps), numbered)
    changes = [{**change, "submap_number": record.number, "seq": record.number} for record in records]
    uow.connection.execute(insert(tables.index_changes), changes)
    last = {"changes": records[-1].number, "submaps": records[-1].number}
    uow.connection.execute(update(tables.map_counters).values(last))
    if loops:
        uow.connection.execute(insert(tables.loops), loops)
