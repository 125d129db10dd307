"""Forgetting answers: a fleet asks without end, and each answer to a query by cloud is a row."""

from __future__ import annotations

from functools import partial

import structlog

from revisit.service.application.contract.context import Context
from revisit.service.application.contract.ports import UnitOfWork

PORTION = 500
"""Rows that are deleted at a time: robots and workers get their turn in between."""

log = structlog.get_logger(__name__)


async def forget_answers(context: Context, kept_s: float) -> int:
    """Delete the operations of queries that ended more than `kept_s` seconds ago; how many."""
    before_ns, forgotten = context.clock.wall_ns() - int(kept_s * 1e9), 0
    while portion := await context.write(partial(_forget, before_ns=before_ns)):
        forgotten += portion
    if forgotten:
        log.info("answers_forgotten", operations=forgotten)
    return forgotten


def _forget(uow: UnitOfWork, before_ns: int) -> int:
    return uow.jobs.forget_answers(before_ns, PORTION)
