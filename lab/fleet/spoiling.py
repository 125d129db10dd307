"""Wrong loops put into the data of a service that does not run, as if its workers had accepted them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.evaluation.demo.truth import FoundLoop
from revisit.service.composition import build_context
from revisit.service.domain.identity import DEFAULT_TENANT, SubmapKey, TenantId
from revisit.service.domain.records import LoopRecord, SubmapRecord
from revisit.service.domain.states import LoopEventKind, LoopState
from revisit.service.engines.local.sqlite.migration import migrate
from revisit.service.features.loops.rows import Change, add_loop
from revisit.service.ports.storage import require_submap
from revisit.service.ports.transactions import UnitOfWork
from revisit.service.settings import Settings

WRONG = "wrong-"
"""How the ids of wrong loops begin."""


def put_in(data: Path, map_id: str, loops: Sequence[FoundLoop], seed: int) -> None:
    """Store wrong loops; each states the evidence, and so the covariance, of an accepted one chosen by chance."""
    settings = Settings(home=data)
    migrate(settings.database)
    installation = build_context(settings, gateway=False)
    try:
        installation.transactions.write(partial(_store, map_id=map_id, loops=loops, seed=seed)).result()
    finally:
        installation.transactions.close()


def _store(uow: UnitOfWork, map_id: str, loops: Sequence[FoundLoop], seed: int) -> None:
    tenant, rng = DEFAULT_TENANT, np.random.default_rng([seed, 83])
    accepted = uow.loops.find(tenant, map_id=map_id, state=LoopState.ACCEPTED.value)
    for number, loop in enumerate(loops):
        query, match = (_submap(uow, tenant, name) for name in (loop.query, loop.match))
        T_match_query = loop.T_match_query
        if query.number < match.number:  # the later submap is the query
            query, match, T_match_query = match, query, se3.inverse(T_match_query)
        like = accepted[int(rng.integers(len(accepted)))]
        record = LoopRecord.between(
            query,
            match,
            loop_id=f"{WRONG}{number}",
            state=LoopState.ACCEPTED.value,
            reason=None,
            similarity=like.similarity,
            score=like.score,
            T_match_query=pose_row(T_match_query),
            evidence=like.evidence,
            created_at_ns=like.created_at_ns,
        )
        add_loop(uow, record, Change(LoopEventKind.VERIFIED, like.created_at_ns))


def _submap(uow: UnitOfWork, tenant: TenantId, name: str) -> SubmapRecord:
    map_id, session_id, submap_id = name.split("/")[1::2]
    return require_submap(uow, tenant, SubmapKey(map_id, session_id, submap_id))
