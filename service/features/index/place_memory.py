"""Place memory: the places of a map that are most like a descriptor, with what the database knows of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import LoopConfig
from revisit.core.errors import BadField
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.features.catalogue.storeys import comparable_sessions, storey_of
from revisit.service.features.graph.map_frames import KeptSessions, MapFrames
from revisit.service.features.index.answers import SearchCriteria, SearchHit, SearchResult
from revisit.service.features.index.own_drive import candidates_of
from revisit.service.ports.index import VectorFilter, VectorMatch
from revisit.service.ports.place_search import PlaceAnswer, PlaceQuestion, PlaceSearch
from revisit.service.ports.transactions import Transactions, UnitOfWork

ReadFilter = Callable[[UnitOfWork], VectorFilter]


@dataclass(frozen=True)
class RecalledPlace:
    """A submap of the map and its cosine similarity to the query."""

    submap: SubmapRecord
    similarity: float


@dataclass(frozen=True)
class Recall:
    """The places most like a query, and how many submaps were left out, as they are on another storey."""

    places: tuple[RecalledPlace, ...]
    on_other_storeys: int = 0


@dataclass(frozen=True)
class Question:
    """The descriptor (d,) that is searched for, the map, and which of its submaps may be hits."""

    map_record: MapRecord
    vector: NDArray[np.float32]
    where: VectorFilter


class PlaceMemory:
    """Searches that see every submap described before they began. Calls block: use them beside the event loop."""

    def __init__(self, transactions: Transactions, search: PlaceSearch) -> None:
        """`search` knows what is like a descriptor, the database all else of a submap."""
        self._transactions = transactions
        self._search = search
        self._sessions = KeptSessions()

    def recall(
        self, map_record: MapRecord, vector: NDArray[np.float32], k: int, where: ReadFilter, before: int | None = None
    ) -> Recall:
        """The k places most like `vector` (d,), of those that entered the index before change `before`.

        Raises BadField for another dimension, Unavailable.
        """
        tenant = map_record.tenant
        asked = PlaceQuestion(tenant, map_record.number, vector, k, self._transactions.read_here(where), before)
        answer = self._search.nearest(asked)
        places = self._transactions.read_here(lambda uow: _places(uow, tenant, answer.matches))
        return Recall(places, answer.on_other_storeys)

    def answer(self, question: Callable[[UnitOfWork], Question], criteria: SearchCriteria) -> SearchResult:
        """The answer to the search that `question` reads. Raises its errors; BadField, Unavailable."""
        version = self._transactions.version()
        asked, found = self._transactions.read_here(lambda uow: self._answer(uow, question, criteria, version))
        return found or self.search(asked.map_record, asked.vector, criteria, asked.where)

    def _answer(
        self, uow: UnitOfWork, question: Callable[[UnitOfWork], Question], criteria: SearchCriteria, version: int | None
    ) -> tuple[Question, SearchResult | None]:
        """The search, and its answer as of the same snapshot, where there is one at once."""
        asked = question(uow)
        record = asked.map_record
        of_index = PlaceQuestion(record.tenant, record.number, asked.vector, criteria.k, asked.where)
        answer = self._search.nearest_in(uow, of_index, version)
        return asked, None if answer is None else self._result(uow, record, answer, criteria, record)

    def search(
        self,
        map_record: MapRecord,
        vector: NDArray[np.float32],
        criteria: SearchCriteria,
        where: VectorFilter,
    ) -> SearchResult:
        """The answer to a client's search. Raises as `answer`."""
        asked = PlaceQuestion(map_record.tenant, map_record.number, vector, criteria.k, where)
        answer = self._search.nearest(asked)
        return self._transactions.read_here(lambda uow: self._result(uow, map_record, answer, criteria))

    def _result(
        self,
        uow: UnitOfWork,
        map_record: MapRecord,
        answer: PlaceAnswer,
        criteria: SearchCriteria,
        as_of: MapRecord | None = None,
    ) -> SearchResult:
        """As a client sees it; `as_of` is the record of the map where it was read in this transaction."""
        hits = _hits(uow, map_record, _alike(answer.matches, criteria), self._sessions, as_of)
        return SearchResult(hits, answer.searched, answer.on_other_storeys)


def _alike(matches: Sequence[VectorMatch], criteria: SearchCriteria) -> list[VectorMatch]:
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


def _places(uow: UnitOfWork, tenant: TenantId, matches: Sequence[VectorMatch]) -> tuple[RecalledPlace, ...]:
    """The submaps behind the matches; one that was deleted a moment ago is left out."""
    submaps = uow.submaps.numbered(tenant, [match.submap_number for match in matches])
    present = (match for match in matches if match.submap_number in submaps)
    return tuple(RecalledPlace(submaps[match.submap_number], match.similarity) for match in present)
