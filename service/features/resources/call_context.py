"""The context of every use case of the gateway: database, lists, admission, jobs, clock and rules."""

from __future__ import annotations

from dataclasses import dataclass

from revisit.service.capacity.admission import Admission
from revisit.service.capacity.backlog import JobPosting
from revisit.service.domain.policy import Policy
from revisit.service.features.resources.paging import Lists
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage


@dataclass(frozen=True)
class CallContext:
    """Given to each use case; `JobContext` is its counterpart in a worker."""

    storage: Storage
    lists: Lists
    admission: Admission
    jobs: JobPosting
    clock: Clock
    policy: Policy
