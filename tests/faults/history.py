"""What clients did and were told, in order, and what that allows the store to hold afterwards.

An operation is invoked and later settled: `ok` (acknowledged), `fail` (refused for good: it had no effect) or `unknown`
(no answer, or one that leaves it open: it may have had its effect, or may still have it). An operation that is never
settled is unknown. Contents are compared by a hash that the client computes itself.
"""

from __future__ import annotations

import json
import math
import threading
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any


class Kind(StrEnum):
    """PUT a key with a content, DELETE it, READ it; RESUME a stream: the service tells the last durable number."""

    PUT = "put"
    DELETE = "delete"
    READ = "read"
    RESUME = "resume"


class Outcome(StrEnum):
    """What the client knows about the operation."""

    OK = "ok"
    FAIL = "fail"
    UNKNOWN = "unknown"


@dataclass
class Operation:
    """One call of one client; `value` is the content put or read (None: nothing there), or the number resumed from."""

    client: str
    kind: Kind
    key: str
    value: str | int | None
    invoked_at: int
    outcome: Outcome = Outcome.UNKNOWN
    settled_at: float = math.inf

    @property
    def had_effect(self) -> bool:
        """Whether it may have changed the store."""
        return self.outcome is not Outcome.FAIL


@dataclass(frozen=True)
class Stored:
    """A row that the store holds in the end."""

    key: str
    content: str


class History:
    """The operations of all clients, on one logical clock; safe for threads.

    With a path, it goes on with what that file holds, and every step is appended there before the client goes on, so
    that it outlives the process.
    """

    def __init__(self, path: Path | None = None, log: bytes = b"") -> None:
        self.operations: list[Operation] = []
        self._now = 0
        self._lock = threading.Lock()
        self._file = None
        for line in (path.read_bytes() if path is not None and path.exists() else log).splitlines(keepends=True):
            # A last line that was cut off never happened.
            if line.endswith(b"\n"):
                self._replay(json.loads(line))
        if path is not None:
            self._file = path.open("ab", buffering=0)

    @classmethod
    def parse(cls, log: bytes) -> History:
        """The history that another process has written."""
        return cls(log=log)

    def invoke(self, client: str, kind: Kind, key: str, value: str | int | None = None) -> Operation:
        """The client is about to call."""
        with self._lock:
            self._now += 1
            operation = Operation(client, kind, key, value, self._now)
            self.operations.append(operation)
            self._append({"invoked": [client, kind, key, value]})
        return operation

    def settle(self, operation: Operation, outcome: Outcome, value: str | int | None = None) -> None:
        """The client has its answer; `value` is what it read."""
        with self._lock:
            self._now += 1
            operation.outcome = outcome
            operation.value = operation.value if value is None else value
            # What has an unknown outcome may happen at any later time.
            operation.settled_at = math.inf if outcome is Outcome.UNKNOWN else self._now
            self._append({"settled": [operation.invoked_at, outcome, value]})

    def acknowledged(self, kind: Kind = Kind.PUT) -> list[Operation]:
        """The operations of a kind that were answered well."""
        return [operation for operation in self.operations if (operation.kind, operation.outcome) == (kind, Outcome.OK)]

    def _append(self, step: dict[str, list[Any]]) -> None:
        if self._file is not None:
            self._file.write(json.dumps(step).encode() + b"\n")

    def _replay(self, step: dict[str, list[Any]]) -> None:
        if "invoked" in step:
            client, kind, key, value = step["invoked"]
            self.invoke(client, Kind(kind), key, value)
        else:
            invoked_at, outcome, value = step["settled"]
            # Clients settle soon after they invoke: look from the end.
            operation = next(known for known in reversed(self.operations) if known.invoked_at == invoked_at)
            self.settle(operation, Outcome(outcome), value)


def violations(operations: Iterable[Operation], final: Iterable[Stored]) -> list[str]:
    """Every way in which `final`, or an answer on the way, contradicts what clients were told; empty is good."""
    by_key: dict[str, list[Operation]] = defaultdict(list)
    for operation in operations:
        by_key[operation.key].append(operation)
    stored: dict[str, list[str]] = defaultdict(list)
    for row in final:
        stored[row.key].append(row.content)
    found: list[str] = []
    for key in sorted(by_key.keys() | stored.keys()):
        found += _of_key(key, by_key.get(key, []), stored.get(key, []))
    return found


def sequence_violations(stream: str, numbers: Iterable[int], committed: int) -> list[str]:
    """A stream's stored numbers are 1, 2, 3, ... up to the one that is committed: no gap, none twice."""
    counted = Counter(numbers)
    found = [f"{stream}: {number} is stored {times} times" for number, times in sorted(counted.items()) if times > 1]
    found += [f"{stream}: gap at {number}" for number in range(1, committed + 1) if number not in counted]
    return found + [f"{stream}: {n} is stored beyond {committed}" for n in sorted(counted) if n > committed]


def _of_key(key: str, operations: list[Operation], contents: list[str]) -> list[str]:
    puts = [operation for operation in operations if operation.kind is Kind.PUT]
    deletes = [operation for operation in operations if operation.kind is Kind.DELETE and operation.had_effect]
    found = _final_state(key, puts, deletes, contents)
    found += _changed_answers(key, puts, deletes)
    reads = [operation for operation in operations if operation.kind is Kind.READ and operation.outcome is Outcome.OK]
    found += [problem for read in reads for problem in _read(key, read, puts, deletes)]
    return found + _resumed(key, [operation for operation in operations if operation.kind is Kind.RESUME])


def _final_state(key: str, puts: list[Operation], deletes: list[Operation], contents: list[str]) -> list[str]:
    found = [f"{key}: stored {len(contents)} times"] if len(contents) > 1 else []
    if not contents:
        lost = [put for put in puts if put.outcome is Outcome.OK and not _overtaken(put, deletes)]
        return [f"{key}: acknowledged to {put.client} and lost" for put in lost]
    effective = [put for put in puts if put.had_effect]
    if not effective:
        return [*found, f"{key}: stored although it was refused" if puts else f"{key}: stored and never sent"]
    gone = [d for d in deletes if d.outcome is Outcome.OK and not _overtaken(d, effective)]
    found += [f"{key}: deleted for {delete.client} and still there" for delete in gone]
    sent = {put.value for put in effective}
    acknowledged = {put.value for put in puts if put.outcome is Outcome.OK and not _overtaken(put, deletes)}
    found += [f"{key}: holds {content}, which nobody sent" for content in contents if content not in sent]
    return found + [
        f"{key}: holds {content}, acknowledged was {sorted(map(str, acknowledged))}"
        for content in contents
        if content in sent and acknowledged and content not in acknowledged
    ]


def _changed_answers(key: str, puts: list[Operation], deletes: list[Operation]) -> list[str]:
    """Two contents were acknowledged under one key that nobody deleted."""
    acknowledged = {str(put.value) for put in puts if put.outcome is Outcome.OK}
    return (
        [f"{key}: acknowledged with contents {sorted(acknowledged)}"] if len(acknowledged) > 1 and not deletes else []
    )


def _read(key: str, read: Operation, puts: list[Operation], deletes: list[Operation]) -> list[str]:
    """A read shows what was acknowledged before it began, and nothing that was not sent before it ended."""
    before = [put for put in puts if put.settled_at < read.invoked_at and put.outcome is Outcome.OK]
    if read.value is None:
        missed = [put for put in before if not _overtaken(put, deletes)]
        return [f"{key}: {read.client} does not see what {put.client} stored before" for put in missed]
    sent = {put.value for put in puts if put.had_effect and put.invoked_at < read.settled_at}
    return [] if read.value in sent else [f"{key}: {read.client} reads {read.value}, which nobody sent"]


def _resumed(key: str, resumes: list[Operation]) -> list[str]:
    """Whoever resumes a stream after another was told its number is not told a smaller one."""
    told = [resume for resume in resumes if resume.outcome is Outcome.OK]
    ended = sorted(told, key=lambda resume: resume.settled_at)
    found, highest, number = [], 0, 0
    for later in sorted(told, key=lambda resume: resume.invoked_at):
        while ended[number].settled_at < later.invoked_at:
            highest = max(highest, int(ended[number].value or 0))
            number += 1
        if int(later.value or 0) < highest:
            found.append(f"{key}: resumes at {later.value} after {highest}")
    return found


def _overtaken(operation: Operation, others: list[Operation]) -> bool:
    """Whether one of `others` may have had its effect after `operation` had."""
    return any(other.settled_at > operation.invoked_at for other in others)
