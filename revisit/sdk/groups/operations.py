"""Operations: work that goes on after the answer."""

from __future__ import annotations

import builtins
import time
import warnings

from revisit.api.words import NO_WORKER
from revisit.sdk import names
from revisit.sdk.errors import ApiError, ErrorDetails, NoWorker, OperationFailed
from revisit.sdk.groups.group import Group
from revisit.sdk.names import name_of
from revisit.sdk.resources import Operation

MAX_WAIT_S = 60.0
SILENT_S = 2.0
"""After so long a wait says why the operation has not begun."""


class Operations(Group):
    """`client.operations`."""

    def get(self, name: str) -> Operation:
        """Get `operations/{operation}`."""
        return Operation.of(self._ask("GetOperation", name=name_of(name, names.OPERATION)))

    def list(self, *, state: str | None = None) -> builtins.list[Operation]:
        """The operations, oldest first; `state` QUEUED, RUNNING, DONE or FAILED."""
        return self._list(Operation, "ListOperations", state=state)

    def retry(self, operation: str | Operation) -> Operation:
        """Queue a failed description again; an operation that has not failed is left as it is."""
        return Operation.of(self._ask("RetryOperation", name=name_of(operation, names.OPERATION)))

    def cancel(self, operation: str | Operation) -> Operation:
        """End an operation that optimises or merges maps, at once or at its next step; it changes nothing then."""
        return Operation.of(self._ask("CancelOperation", name=name_of(operation, names.OPERATION)))

    def wait(self, operation: str | Operation, timeout_s: float = 300.0) -> Operation:
        """The operation once it is DONE. Raises OperationFailed; TimeoutError after `timeout_s`.

        Warns (`NoWorker`) where it has not begun after 2 s, because no worker is ready.
        """
        name, deadline = name_of(operation, names.OPERATION), time.monotonic() + timeout_s
        longest_s = SILENT_S
        while True:
            left_s = max(0.0, deadline - time.monotonic())
            current = Operation.of(self._ask("WaitOperation", name=name, timeout_s=min(left_s, longest_s)))
            if current.state == "FAILED":
                details = ErrorDetails("UNKNOWN", current.failure_reason or "", current.failure_message or "")
                raise OperationFailed(details)
            if current.done:
                return current
            if left_s == 0.0:
                raise TimeoutError(f"{current.name} is {current.state} after {timeout_s:g} s")
            if longest_s < MAX_WAIT_S and time.monotonic() < deadline:
                longest_s = MAX_WAIT_S
                if current.state == "QUEUED" and self._no_worker():
                    warnings.warn(f"{current.name} waits: {NO_WORKER}", NoWorker, stacklevel=2)

    def _no_worker(self) -> bool:
        try:
            return not self._ask("GetStatus").workers
        except ApiError:
            return False
