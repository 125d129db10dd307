"""A store with as many described submaps as wanted, made without the service."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
from sqlalchemy import insert

from revisit.service.adapters.files.blobs import FileBlobStore
from revisit.service.adapters.sql import tables
from revisit.service.adapters.sqlite.migration import migrate
from revisit.service.adapters.sqlite.transactions import SqliteTransactions
from revisit.service.application.contract.blobs import CLOUD_BLOB
from tests.support.records import TENANT, a_map, a_session, a_submap

PORTION = 2000


def fill(home: Path, submaps: int, dimension: int) -> None:
    """A home with maps/town/sessions/monday: submaps s1, s2, ... of one cloud with random unit descriptors."""
    home.mkdir(exist_ok=True)
    migrate(home / "revisit.db")
    store = SqliteTransactions(home / "revisit.db", checkpoints=True)
    rng = np.random.default_rng(1)
    number = store.write(lambda uow: (uow.maps.add(a_map()), uow.sessions.add(a_session()))[0].number).result()
    cloud_sha256 = FileBlobStore(home / "blobs").put(TENANT, CLOUD_BLOB, b"a cloud")

    def add(uow, first: int) -> None:
        vectors = rng.normal(size=(PORTION, dimension)).astype("<f4")
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        ids = range(first, min(first + PORTION, submaps + 1))
        rows = [
            asdict(
                a_submap(
                    f"s{each}",
                    number=each,
                    ordinal=each,
                    state="DESCRIBED",
                    cloud_sha256=cloud_sha256,
                    descriptor=vector.tobytes(),
                )
            )
            for each, vector in zip(ids, vectors, strict=False)
        ]
        change = {"tenant": TENANT, "map_number": number, "kind": "DESCRIBED"}
        uow.connection.execute(insert(tables.submaps), rows)
        uow.connection.execute(insert(tables.index_changes), [{**change, "submap_number": each} for each in ids])

    for first in range(1, submaps + 1, PORTION):
        store.write(lambda uow, first=first: add(uow, first)).result()
    store.close()
