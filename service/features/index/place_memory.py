"""Place memory: searches a map's vector index after it has caught up with the database."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import LoopConfig
from revisit.core.errors import BadField
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.catalogue.storeys import comparable_sessions, storey_of
from revisit.service.features.graph.map_frames import KeptSessions, MapFrames
from revisit.service.features.index.answers import SearchCriteria, SearchHit, SearchResult
from revisit.service.features.index.own_drive import candidates_of
from revisit.service.ports.index import IndexChange, VectorFilter, VectorIndex, VectorMatch
from revisit.service.ports.transactions import Transactions, UnitOfWork

ReadFilter = Callable[[UnitOfWork], VectorFilter]

PORTION = 1024
"""Changes that are read at a time: a large map is loaded without holding all its descriptors twice, and 4 MB of them
lie in memory that the next portion uses again."""


@dataclass(frozen=True)
class RecalledPlace:
    """A submap of the map and its cosine similarity to the query."""

    submap: SubmapRecord
    similarity: float


@dataclass(frozen=True)
class Question:
    """The descriptor (d,) that is searched for, the map, and which of its submaps may be hits."""

    map_record: MapRecord
    vector: NDArray[np.float32]
    where: VectorFilter


@dataclass(frozen=True)
class _News:
    """The changes of a map's index that follow change `after`."""

    after: int
    changes: list[IndexChange]

    @property
    def seq(self) -> int:
        """The last of them."""
        return self.changes[-1].seq if self.changes else self.after


class PlaceMemory:
    """Searches that see every submap described before they began. Calls block: use them beside the event loop."""

    def __init__(self, transactions: Transactions, index: VectorIndex) -> None:
        """`index` is this process's own cache."""
        self._transactions = transactions
        self._index = index
        self._sessions = KeptSessions()
        self._caught_up: dict[int, tuple[int, int]] = {}

    def recall(
        self, map_record: MapRecord, vector: NDArray[np.float32], k: int, where: ReadFilter, before: int | None = None
    ) -> tuple[RecalledPlace, ...]:
        """The k places most like `vector` (d,), of those that entered the index before change `before`.

        `where` is read once the index has caught up, so that it knows every session that has a place there. Raises
        BadField for another dimension.
        """
        matches, _ = self._matches(map_record, vector, k, partial(self._where, map_record, where, before), to=before)
        return self._transactions.read_here(lambda uow: _places(uow, map_record.tenant, matches))

    def _where(self, map_record: MapRecord, where: ReadFilter, before: int | None) -> VectorFilter:
        """The filter, which leaves out what the index holds beyond change `before`."""
        beyond = before is not None and self._index.seq(map_record.number) > before

        def read(uow: UnitOfWork) -> VectorFilter:
            later = uow.changes.since(map_record.tenant, map_record.number, before or 0) if beyond else []
            found = where(uow)
            return replace(found, without=found.without.union(change.submap_number for change in later))

        return self._transactions.read_here(read)

    def _matches(
        self,
        map_record: MapRecord,
        vector: NDArray[np.float32],
        k: int,
        where: Callable[[], VectorFilter],
        news: _News | None = None,
        to: int | None = None,
    ) -> tuple[list[VectorMatch], int]:
        """The hits of the index, and the change up to which it is complete; `news` of it may have been read.

        With `to` no change behind that one is applied.
        """
        tenant, number = map_record.tenant, map_record.number
        while True:
            seq = self.catch_up(tenant, number, to) if news is None else self._apply(number, news)
            news = None
            matches = self._index.search(number, vector, k, where()) if self._index.size(number) else []
            if self._index.seq(number) >= seq:
                return matches, seq
            # The map was forgotten in between, to be loaded again.

    def catch_up(self, tenant: TenantId, number: int, to: int | None = None) -> int:
        """Apply the changes that the index lacks, up to change `to`, in portions; the last change that was read."""
        while True:
            before = self._index.seq(number) or self._loaded(tenant, number)
            changes = self._transactions.read_here(partial(_changes, tenant=tenant, number=number, seq=before))
            if to is not None:
                changes = [change for change in changes if change.seq <= to]
            more = len(changes) > PORTION
            seq = self._apply(number, _News(before, changes[:PORTION]), more)
            if not more:
                return seq

    def _apply(self, number: int, news: _News, more: bool = False) -> int:
        """Apply changes that were read, and `more` are to be; the last of them."""
        failpoint("index.before_apply")
        self._index.apply(number, news.changes, news.after, more=more)
        failpoint("index.after_apply")
        return news.seq

    def _loaded(self, tenant: TenantId, number: int) -> int:
        """Load the map from its file, if it has one; the last change that is in the index then."""
        record = self._transactions.read_here(lambda uow: uow.maps.numbered(tenant, [number])).get(number)
        if record is not None and record.index_file is not None:
            self._index.load(number, record.index_file)
        return self._index.seq(number)

    def answer(self, question: Callable[[UnitOfWork], Question], criteria: SearchCriteria) -> SearchResult:
        """The answer to the search that `question` reads. Raises its errors; BadField."""
        version = self._transactions.version()
        asked, news, found = self._transactions.read_here(lambda uow: self._answer(uow, question, criteria, version))
        if found is None:
            found = self.search(asked.map_record, asked.vector, criteria, asked.where)
        if news is not None and version is not None:
            self._caught_up[asked.map_record.number] = version, news.seq
        return found

    def _answer(
        self, uow: UnitOfWork, question: Callable[[UnitOfWork], Question], criteria: SearchCriteria, version: int | None
    ) -> tuple[Question, _News | None, SearchResult | None]:
        """As `_asked`, and the answer: if the index is in the end at this snapshot, and no further."""
        asked, news = self._asked(uow, question, version)
        record, where, found = asked.map_record, asked.where, None
        if news is not None:
            matches, seq = self._matches(record, asked.vector, criteria.k, lambda: where, news)
            if seq == news.seq == self._index.seq(record.number):
                hits = _hits(uow, record, _alike(matches, criteria), self._sessions, record)
                found = self._result(record, where, hits)
        return asked, news, found

    def _asked(
        self, uow: UnitOfWork, question: Callable[[UnitOfWork], Question], version: int | None
    ) -> tuple[Question, _News | None]:
        """The search, and in the same snapshot the changes that the index of the map lacks.

        Nothing where it knew everything as of `version`, and nothing was committed since. No news of an index that is
        still to be loaded, or that lacks more than a portion.
        """
        asked = question(uow)
        record = asked.map_record
        before = self._index.seq(record.number)
        if not before:
            return asked, None
        if version is not None and self._caught_up.get(record.number) == (version, before):
            return asked, _News(before, [])
        changes = _changes(uow, record.tenant, record.number, before)
        return asked, _News(before, changes) if len(changes) <= PORTION else None

    def search(
        self,
        map_record: MapRecord,
        vector: NDArray[np.float32],
        criteria: SearchCriteria,
        where: VectorFilter,
    ) -> SearchResult:
        """The answer to a client's search."""
        found, _ = self._matches(map_record, vector, criteria.k, lambda: where)
        matches = _alike(found, criteria)
        hits = self._transactions.read_here(partial(_hits, map_record=map_record, matches=matches, kept=self._sessions))
        return self._result(map_record, where, hits)

    def _result(self, map_record: MapRecord, where: VectorFilter, hits: tuple[SearchHit, ...]) -> SearchResult:
        return SearchResult(hits, self._index.size(map_record.number), self.on_other_storeys(map_record, where))

    def on_other_storeys(self, map_record: MapRecord, where: VectorFilter) -> int:
        """How many submaps of the map's index were left out, as they are on another storey."""
        number, comparable = map_record.number, where.only_sessions
        return 0 if comparable is None else self._index.size(number) - self._index.size(number, comparable)


def _changes(uow: UnitOfWork, tenant: TenantId, number: int, seq: int) -> list[IndexChange]:
    """A portion of the changes after `seq`, and one more, if there is any."""
    return uow.changes.since(tenant, number, seq, PORTION + 1)


def _alike(matches: list[VectorMatch], criteria: SearchCriteria) -> list[VectorMatch]:
    """Those that are as similar as is asked for."""
    floor = -1.0 if criteria.min_similarity is None else criteria.min_similarity
    return [match for match in matches if match.similarity >= floor]


def _hits(
    uow: UnitOfWork,
    map_record: MapRecord,
    matches: list[VectorMatch],
    kept: KeptSessions,
    as_of: MapRecord | None = None,
) -> tuple[SearchHit, ...]:
    """The matches as a client sees them; a submap that was deleted a moment ago is left out.

    `as_of` is the record of the map where it was read in this transaction.
    """
    submaps = uow.submaps.found(map_record.tenant, [match.submap_number for match in matches])
    poses = MapFrames(uow, map_record.tenant, map_record.map_id, kept, as_of).submaps(submaps)
    found = ((submaps[match.submap_number], match) for match in matches if match.submap_number in submaps)
    return tuple(
        SearchHit(submap.key, match.similarity, submap.position_m, poses.get(submap.number)) for submap, match in found
    )


def vector_filter(
    uow: UnitOfWork, tenant: TenantId, map_id: str, criteria: SearchCriteria, query: SubmapRecord | None
) -> VectorFilter:
    """The filter of a client's search; `query` is the stored submap that asks, if one does: its storey is known.

    Raises NotFound; BadField for a prior without the session of its odometry frame, where there are several.
    """
    storey = criteria.storey if query is None else storey_of(uow, tenant, map_id, query.session_id)
    if criteria.prior_position_m is not None and criteria.only_session is None and _has_sessions(uow, tenant, map_id):
        raise BadField("sessions have own frames: only_session says in which the prior is", field="only_session")
    return VectorFilter(
        exclude_session=_session_number(uow, tenant, map_id, criteria.exclude_session),
        only_session=_session_number(uow, tenant, map_id, criteria.only_session),
        only_sessions=comparable_sessions(uow, tenant, map_id, storey),
        of_session=None if query is None else query.session_number,
        without=frozenset() if query is None else _left_out(uow, query, criteria),
        position_m=criteria.prior_position_m,
        radius_m=criteria.radius_m,
    )


def _left_out(uow: UnitOfWork, query: SubmapRecord, criteria: SearchCriteria) -> frozenset[int]:
    """The submap itself, and those of its drive that are no loop with it, if the client asks for that."""
    if criteria.leave_distance_m is None:
        return frozenset({query.number})
    return candidates_of(uow, query, LoopConfig(leave_distance=criteria.leave_distance_m)).too_near


def _has_sessions(uow: UnitOfWork, tenant: TenantId, map_id: str) -> bool:
    """Whether a map has more than one."""
    return uow.sessions.count(tenant, map_id=map_id) > 1


def _session_number(uow: UnitOfWork, tenant: TenantId, map_id: str, session_id: str | None) -> int | None:
    if session_id is None:
        return None
    session = uow.sessions.get(tenant, map_id, session_id)
    if session is None:
        raise NotFound(f"there is no session {session_id!r} in map {map_id!r}"[:300])
    return session.number


def _places(uow: UnitOfWork, tenant: TenantId, matches: list[VectorMatch]) -> tuple[RecalledPlace, ...]:
    """The submaps behind the matches; one that was deleted a moment ago is left out."""
    submaps = uow.submaps.numbered(tenant, [match.submap_number for match in matches])
    present = (match for match in matches if match.submap_number in submaps)
    return tuple(RecalledPlace(submaps[match.submap_number], match.similarity) for match in present)
