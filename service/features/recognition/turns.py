"""The turn of a submap on its drive: rules ask for the loops of the submaps before it, so those are waited for.

Only loops of submaps that entered the map earlier count. The one that entered first waits for nobody, so all get on.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

from revisit.core.config import PipelineConfig
from revisit.service.domain.errors import Unavailable
from revisit.service.domain.records import SubmapRecord
from revisit.service.domain.states import OperationState
from revisit.service.features.loops.claims import StoredDrive, drive_before
from revisit.service.ports.transactions import Transactions, UnitOfWork

WAIT_S = 30.0
"""A run waits for others no longer: it may be the worker that one of them needs."""

_PAUSE_S = (0.005, 0.25)


def drive_in_turn(transactions: Transactions, submap: SubmapRecord, config: PipelineConfig) -> StoredDrive:
    """The drive before a submap once its loops are there.

    Raises Unavailable where one of them is looked for by no run, or for too long: this run is repeated later.
    """
    until_s, pause_s = time.monotonic() + WAIT_S, _PAUSE_S[0]
    while True:
        before, states = transactions.read(partial(_drive, submap=submap, config=config)).result()
        if not states:
            return before
        if OperationState.QUEUED in states or time.monotonic() >= until_s:
            name = before.unsearched[0].key.name
            raise Unavailable(f"loops of {name} decide about those of {submap.submap_id}, and are not there yet")
        time.sleep(pause_s)
        pause_s = min(1.5 * pause_s, _PAUSE_S[1])


def _drive(uow: UnitOfWork, submap: SubmapRecord, config: PipelineConfig) -> tuple[StoredDrive, set[str]]:
    """The drive, and the states of the jobs that look for the loops that it lacks."""
    before = drive_before(uow, submap, config)
    return before, _states(uow, before.unsearched)


def _states(uow: UnitOfWork, submaps: Sequence[SubmapRecord]) -> set[str]:
    jobs = (uow.jobs.get(one.tenant, one.operation_id) for one in submaps)
    return {job.state for job in jobs if job is not None}
