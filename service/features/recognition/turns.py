"""The turn of a submap on its drive: rules ask for the loops of the submaps before it, so those are waited for.

Only loops of submaps that entered the map earlier count. The one that entered first waits for nobody, so all get on.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from revisit.core.config import PipelineConfig
from revisit.service.domain.errors import OutOfTurn
from revisit.service.domain.records import SubmapRecord
from revisit.service.features.loops.claims import StoredDrive, drive_before
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.transactions import UnitOfWork

WAIT_S = 30.0
"""A run waits for others no longer, so that its own time does not run out with one that hangs."""

_PAUSE_S = (0.005, 0.25)


def drive_in_turn(context: JobContext, submap: SubmapRecord, config: PipelineConfig) -> StoredDrive:
    """The drive before a submap once its loops are there.

    Raises OutOfTurn where a run that looks for them has to begin first, maybe in this worker; or has taken too long.
    """
    for pause_s in _pauses():
        before, missing, begun = context.transactions.read(partial(_drive, submap=submap, config=config)).result()
        if not missing:
            return before
        if missing - begun:
            break
        context.clock.sleep(pause_s)
    name = before.unsearched[0].key.name
    raise OutOfTurn(f"loops of {name} decide about those of {submap.submap_id}, and are not there yet", missing)


def _pauses() -> Iterator[float]:
    pause_s, rest_s = _PAUSE_S[0], WAIT_S
    while rest_s > 0.0:
        yield pause_s
        rest_s -= pause_s
        pause_s = min(1.5 * pause_s, _PAUSE_S[1])


def _drive(
    uow: UnitOfWork, submap: SubmapRecord, config: PipelineConfig
) -> tuple[StoredDrive, frozenset[str], frozenset[str]]:
    """The drive; the operations that look for the loops that it lacks; those of them that are under way."""
    before = drive_before(uow, submap, config)
    missing = uow.jobs.unfinished(submap.tenant, [one.operation_id for one in before.unsearched])
    return before, missing, uow.queue.under_way(submap.tenant, missing)
