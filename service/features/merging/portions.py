"""The verdicts of a merge so far, kept while it lasts: a run that follows a killed one goes on with them.

They are one blob that the progress of the job names, and no row. The run that ends a merge deletes it, and so does
whoever cancels a merge between two runs; that of a merge that failed goes as every blob that no row names.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable

from revisit.core.errors import DataLoss
from revisit.core.pair_verdict import PairVerdict, RejectedLoop, RejectionReason
from revisit.service.domain.errors import OutOfTurn
from revisit.service.domain.records import JobRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.loops.claims import Evidence, stored_verdict, verdict_of
from revisit.service.features.operations.progress import Progress, portion_of
from revisit.service.ports.blobs import MERGE_PORTION_BLOB, StoredBlob
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.storage import discard

STORE_EVERY_MS = 5_000
"""Verified pairs of so long, at most, are lost with a worker."""

PORTION_MS = 30_000
"""So long a run verifies pairs; then it lets other jobs run, and is queued again: no attempt counts."""


class VerdictsSoFar:
    """The verdicts on the pairs of one merge, by all that each of them rests on."""

    def __init__(self, context: JobContext, job: JobRecord, progress: Progress, most: int) -> None:
        """Those that earlier runs of `job` have stored; of more than `most` the last ones that were asked for stay."""
        self._context = context
        self._job = job
        self._progress = progress
        self._most = most
        kept = portion_of(job)
        self._blobs = [] if kept is None else [kept]
        self._known = {} if kept is None else self._read(kept)
        self._began_ms: int | None = None
        self._stored_ms = 0
        self._unstored = 0

    def verdict(self, rests_on: tuple[object, ...], verify: Callable[[], PairVerdict]) -> PairVerdict:
        """The verdict that is known, or that of `verify`. `rests_on` is told apart by its `repr`.

        Raises OutOfTurn where this run has done its portion.
        """
        key = hashlib.sha256(repr(rests_on).encode()).hexdigest()
        known = self._known.pop(key, None)
        if known is not None:
            self._known[key] = known
            return verdict_of(known)
        self._begin()
        verdict = verify()
        if not (isinstance(verdict, RejectedLoop) and verdict.reason is RejectionReason.PLACE_LOST):
            self._known[key] = stored_verdict(verdict)
            self._unstored += 1
            self._end_of_portion()
        return verdict

    def store(self) -> None:
        """Keep what is new."""
        if not self._unstored:
            return
        self._known = dict(list(self._known.items())[-self._most :])
        stored = {"operation": self._job.operation_id, "verdicts": self._known}
        data, tenant = zlib.compress(json.dumps(stored).encode(), 1), self._job.tenant
        sha256 = self._context.blobs.put(tenant, MERGE_PORTION_BLOB, data)
        failpoint("map_merge.after_portion")
        before = self._blobs
        self._blobs = [*before, StoredBlob(tenant, MERGE_PORTION_BLOB, sha256)]
        self._progress.name_portion(sha256)
        self._unstored, self._stored_ms = 0, self._context.clock.monotonic_ms()
        failpoint("map_merge.after_portion_named")
        discard(self._context.blobs, *before)
        self._blobs = self._blobs[-1:]

    def forget(self) -> None:
        """Delete them: the merge has ended."""
        discard(self._context.blobs, *self._blobs)

    def _begin(self) -> None:
        """With the first pair: both maps of a large merge are read for longer than a portion lasts."""
        if self._began_ms is None:
            self._began_ms = self._stored_ms = self._context.clock.monotonic_ms()

    def _end_of_portion(self) -> None:
        now_ms = self._context.clock.monotonic_ms()
        ended = self._began_ms is not None and now_ms >= self._began_ms + PORTION_MS
        if ended or now_ms >= self._stored_ms + STORE_EVERY_MS:
            self.store()
        if ended:
            raise OutOfTurn(f"{len(self._known)} pairs of the merge are verified: others may run", ())

    def _read(self, blob: StoredBlob) -> dict[str, Evidence]:
        """Nothing where the blob is gone: then all pairs are verified again."""
        try:
            stored = json.loads(zlib.decompress(self._context.blobs.get(blob.tenant, blob.kind, blob.sha256)))
        except DataLoss:
            return {}
        return dict(stored["verdicts"])
