"""The context of every job of a worker: database, blobs, clock and rules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from revisit.service.domain.policy import Policy
from revisit.service.ports.blobs import BlobStore
from revisit.service.ports.clock import Clock
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.storage import write_naming
from revisit.service.ports.transactions import Transactions, UnitOfWork

T = TypeVar("T")


@dataclass(frozen=True)
class JobContext:
    """Given to each job; all of its calls block."""

    transactions: Transactions
    blobs: BlobStore
    clock: Clock
    policy: Policy

    def write_naming(self, work: Callable[[UnitOfWork], T], put: Callable[[], object]) -> T:
        """See `storage.write_naming`."""
        return write_naming(self.transactions, work, put)

    def complete(self, lease: Lease, result: dict[str, Any]) -> None:
        """End a job well, in a transaction of its own. Raises StaleLease where another worker holds it."""
        self.transactions.write(lambda uow: uow.queue.complete(lease, result)).result()
