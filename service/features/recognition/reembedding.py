"""Maps of an older model get the descriptors of today's, from their stored neural maps, or from scans without one.

The new description of each submap is kept as a draft, so that an interrupted run goes on where it ended. The map
changes in one transaction: before it, everything is as the old model left it, and after it as the new one. Loop
closures stay as they were judged; each names its model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from revisit.core.codec.container import Container
from revisit.core.errors import DataLoss, RevisitError
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.features.catalogue.maps import model_for_map
from revisit.service.features.deletion.blob_references import blobs_of_submap
from revisit.service.features.ingest.rows import load_submap, submap_source
from revisit.service.ports.blobs import NEURAL_MAP_BLOB, PLACE_BLOB, BlobStore
from revisit.service.ports.recogniser import PlaceRecogniser, SubmapDescription
from revisit.service.ports.storage import require_map, write_naming
from revisit.service.ports.transactions import Transactions, UnitOfWork

Progress = Callable[[int, int], None]

_DRAFT = Container(magic=b"RVDRAFT2", noun="draft of a description", level=3, max_body_bytes=64 * 2**20)


class Drafts(Protocol):
    """Bytes under a name that outlast this process, until they are no longer needed."""

    def read(self, name: str) -> bytes | None:
        """The draft `name`, if there is one."""
        ...

    def write(self, name: str, data: bytes) -> None:
        """Keep `data`, all or nothing."""
        ...

    def discard(self) -> None:
        """Forget everything."""
        ...


@dataclass(frozen=True)
class Reembedded:
    """The result for a map: number of submaps, of those described from their scans, and reasons of failures."""

    map: MapRecord
    model_version: str
    submaps: int
    from_scans: int
    failures: dict[str, str]


@dataclass(frozen=True)
class _Renewed:
    """The result for one submap: a description, or the error."""

    submap: SubmapRecord
    description: SubmapDescription | None
    from_scans: bool = False
    error: RevisitError | None = None


class Reembedding:
    """Bring maps to the model of `recogniser`; all calls block."""

    def __init__(
        self, transactions: Transactions, blobs: BlobStore, policy: Policy, recogniser: PlaceRecogniser, drafts: Drafts
    ) -> None:
        """`drafts` belong to this data folder."""
        self._transactions = transactions
        self._blobs = blobs
        self._policy = policy
        self._recogniser = recogniser
        self._drafts = drafts

    def stale_maps(self) -> list[MapRecord]:
        """The maps of all tenants with descriptors of another model."""
        return [one for one in self._described_maps() if one.model_version != self._model(one)]

    def named_maps(self, map_ids: Sequence[str]) -> list[MapRecord]:
        """The described maps of all tenants with these ids, of any model."""
        return [one for one in self._described_maps() if one.map_id in map_ids]

    def _described_maps(self) -> list[MapRecord]:
        every = self._transactions.read(lambda uow: uow.maps.of_all_tenants()).result()
        return [one for one in every if one.model_version is not None]

    def reembed(self, record: MapRecord, progress: Progress = lambda *_: None) -> Reembedded:
        """Describe every described submap of the map again and commit; `told` hears how many of how many are done.

        A submap without a readable neural map is described from its scans; one that cannot be described has FAILED,
        with the reason. Raises storage errors.
        """
        renewed: list[_Renewed] = []
        while True:
            submaps = self._transactions.read(partial(_described, record=record)).result()
            known = {one.submap.number: one for one in renewed}
            renewed = []
            for number, submap in enumerate(submaps, 1):
                renewed.append(known.get(submap.number) or self._renew(record, submap))
                progress(number, len(submaps))
            put = partial(self._rows, record, renewed)
            if write_naming(self._transactions, partial(self._commit, record=record, renewed=renewed, rows=put()), put):
                break
        self._drafts.discard()
        return Reembedded(
            record,
            self._model(record),
            len(renewed),
            sum(one.from_scans for one in renewed),
            {one.submap.submap_id: one.error.message for one in renewed if one.error is not None},
        )

    def _model(self, record: MapRecord) -> str:
        return model_for_map(record, self._recogniser)

    def _renew(self, record: MapRecord, submap: SubmapRecord) -> _Renewed:
        name = f"{record.number}-{submap.number}-{self._model(record)}"
        kept = _read_draft(self._drafts.read(name))
        if kept is not None:
            return _Renewed(submap, kept)
        try:
            renewed = self._described_again(record, submap)
        except RevisitError as error:
            return _Renewed(submap, None, error=error)
        if renewed.description is not None:
            self._drafts.write(name, _draft(renewed.description))
        return renewed

    def _described_again(self, record: MapRecord, submap: SubmapRecord) -> _Renewed:
        config = self._policy.for_map(record)
        try:
            stored = self._blobs.get(submap.tenant, NEURAL_MAP_BLOB, str(submap.neural_map_sha256))
            return _Renewed(submap, self._recogniser.describe_again(stored, self._place_before(submap), config))
        except RevisitError:
            source = self._transactions.read(lambda uow: submap_source(uow, self._policy, submap)).result()
            whole = self._recogniser.describe(load_submap(self._blobs, submap, source), config)
            return _Renewed(submap, whole, from_scans=True)

    def _place_before(self, submap: SubmapRecord) -> bytes | None:
        """The place of the older model, with values that need the scans; None where it is gone."""
        try:
            return self._blobs.get(submap.tenant, PLACE_BLOB, str(submap.place_sha256))
        except DataLoss:
            return None

    def _commit(
        self, uow: UnitOfWork, record: MapRecord, renewed: Sequence[_Renewed], rows: Sequence[SubmapRecord]
    ) -> bool:
        """Commit, or change nothing and return False where the map has other submaps by now."""
        current = require_map(uow, record.tenant, record.map_id, hold=True)
        if [one.number for one in _described(uow, record)] != [row.number for row in rows]:
            return False
        for one, row in zip(renewed, rows, strict=True):
            uow.submaps.replace(row)
            if one.description is None:
                uow.changes.record_removed(record, [row.number])
            else:
                uow.blobs.refer(row.tenant, blobs_of_submap(row))
                uow.blobs.release(row.tenant, blobs_of_submap(one.submap) - blobs_of_submap(row))
                uow.changes.record_described(record, row.number)
        uow.maps.replace(replace(current, model_version=self._model(record)))
        return True

    def _rows(self, record: MapRecord, renewed: Sequence[_Renewed]) -> list[SubmapRecord]:
        """The rows as they are to be; their blobs are stored."""
        return [self._row(record, one) for one in renewed]

    def _row(self, record: MapRecord, renewed: _Renewed) -> SubmapRecord:
        """The submap's row as it is to be; its blobs are stored before any row names them."""
        submap, again, error = renewed.submap, renewed.description, renewed.error
        if again is None or error is not None:
            code, message = (None, None) if error is None else (error.code.value, error.message)
            failed = SubmapState.FAILED.value
            return replace(submap, state=failed, descriptor=None, failure_code=code, failure_message=message)
        if again.neural_map is not None:
            sha256 = self._blobs.put(submap.tenant, NEURAL_MAP_BLOB, again.neural_map)
            submap = replace(submap, neural_map_sha256=sha256, neural_map_bytes=len(again.neural_map))
        return replace(
            submap,
            model_version=self._model(record),
            descriptor=np.asarray(again.descriptor, dtype="<f4").tobytes(),
            place_sha256=self._blobs.put(submap.tenant, PLACE_BLOB, again.place),
        )


def _described(uow: UnitOfWork, record: MapRecord) -> list[SubmapRecord]:
    """In the order in which they entered: those of which the loops are still searched for keep their place in it."""
    described = uow.submaps.find(record.tenant, map_id=record.map_id, state=SubmapState.DESCRIBED.value)
    return sorted(described, key=lambda one: (one.entered, one.number))


def _draft(described: SubmapDescription) -> bytes:
    descriptor = np.asarray(described.descriptor, dtype="<f4").tobytes()
    lengths = {
        "descriptor": len(descriptor),
        "place": len(described.place),
        "renewed": described.neural_map is not None,
    }
    return _DRAFT.pack(lengths, descriptor + described.place + (described.neural_map or b""))


def _read_draft(data: bytes | None) -> SubmapDescription | None:
    """The stored draft; None where there is none or it was damaged."""
    if data is None:
        return None
    try:
        header, body = _DRAFT.unpack(data)
    except DataLoss:
        return None
    start, end = header["descriptor"], header["descriptor"] + header["place"]
    neural_map = body[end:] if header["renewed"] else None
    return SubmapDescription(np.frombuffer(body[:start], dtype="<f4"), body[start:end], neural_map)
