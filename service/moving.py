"""An installation that nobody serves moves to other engines (see `engines.move`)."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

from revisit.service.composition import build_blobs, build_context
from revisit.service.domain.processes import ProcessRole
from revisit.service.engines.findings import examine_rows
from revisit.service.engines.local.files.disk import durable_write
from revisit.service.engines.move import Moved, MoveRefused, Progress, digest, move_blobs, move_rows, require_empty
from revisit.service.engines.state import State, state_of
from revisit.service.features.upkeep.calls import WORKER_SEEN_WITHIN_MS
from revisit.service.ports.blobs import BlobStore
from revisit.service.ports.transactions import UnitOfWork
from revisit.service.settings import Settings

NOTE = "moving.json"
"""The file in the data folder of the source with the target of a move under way."""


def move_installation(source: Settings, target: Settings, progress: Progress) -> Moved:
    """Copy all rows and blobs, and compare what came; goes on where an earlier move to the same target was broken off.

    The source stays as it is. Raises MoveRefused where a process serves either, a row of the source is damaged, the
    target has rows of its own, or what came differs; HomeTaken; ForeignSchema, UnusableServer; DataLoss for a blob that
    is lost; StorageFull, StorageUncertain.
    """
    states = [state_of(one.home, one.database_url) for one in (source, target)]
    if not states[0].is_made():
        raise MoveRefused(f"there is nothing at {states[0].name}")
    with ExitStack() as held:
        for settings, state in zip((source, target), states, strict=True):
            settings.home.mkdir(parents=True, exist_ok=True)
            held.enter_context(state.sole_gateway())
            state.migrate()
            _require_unused(settings, state)
        if damaged := states[0].damaged_rows():
            raise MoveRefused(f"{examine_rows(damaged).detail}: they would be taken for whole there; restore a backup")
        rows, there = (held.enter_context(state.writer()) for state in states)
        if not _goes_on(source.home, target):
            require_empty(there)
            durable_write(source.home / NOTE, _leads_to(target), is_blob=False)
        blobs = 0 if _same_blobs(source, target) else move_blobs(rows, _blobs(source), _blobs(target), progress)
        move_rows(rows, there, progress)
        sent, came = digest(rows), digest(there)
        if sent != came:
            raise MoveRefused(f"what is at {states[1].name} differs from {states[0].name}: keep the source")
        (source.home / NOTE).unlink(missing_ok=True)
    return Moved(came[0], blobs, came[1])


def _blobs(settings: Settings) -> BlobStore:
    return build_blobs(settings)[0]


def _same_blobs(source: Settings, target: Settings) -> bool:
    here, there = (one.blob_url or str(one.blobs.resolve()) for one in (source, target))
    return here == there


def _goes_on(home: Path, target: Settings) -> bool:
    """Whether a move to the target was broken off."""
    note = home / NOTE
    return note.exists() and note.read_bytes() == _leads_to(target)


def _leads_to(target: Settings) -> bytes:
    state = state_of(target.home, target.database_url)
    return json.dumps([str(target.home.resolve()), state.name, target.blob_url]).encode()


def _require_unused(settings: Settings, state: State) -> None:
    """Raises MoveRefused where a process shows itself in the database."""
    context = build_context(settings, gateway=False)
    try:
        alive = context.transactions.read(_alive).result()
    finally:
        context.transactions.close()
    if alive:
        raise MoveRefused(f"{', '.join(alive)} serves {state.name}: stop it, and wait for ten seconds")


def _alive(uow: UnitOfWork) -> list[str]:
    gateways = uow.processes.alive(ProcessRole.GATEWAY, WORKER_SEEN_WITHIN_MS)
    workers = uow.workers.alive(WORKER_SEEN_WITHIN_MS)
    return [*(f"gateway {one.process_id}" for one in gateways), *(f"worker {one.worker_id}" for one in workers)]
