"""Questions and answers of a search as messages of `revisit.internal.v1`, there and back."""

from __future__ import annotations

import numpy as np

from revisit.internal.v1 import place_search_pb2 as pb
from revisit.service.domain.identity import TenantId
from revisit.service.ports.index import VectorFilter, VectorMatch
from revisit.service.ports.place_search import PlaceAnswer, PlaceQuestion


def question_message(question: PlaceQuestion) -> pb.NearestRequest:
    """A question to send."""
    return pb.NearestRequest(
        tenant=question.tenant,
        map_number=question.map_number,
        vector=np.ascontiguousarray(question.vector, dtype="<f4").tobytes(),
        k=question.k,
        where=_filter_message(question.where),
        before=question.before,
    )


def question_of(message: pb.NearestRequest) -> PlaceQuestion:
    """A question that came. Raises ValueError for a vector of half a number."""
    return PlaceQuestion(
        TenantId(message.tenant),
        message.map_number,
        np.frombuffer(message.vector, dtype="<f4"),
        message.k,
        _filter_of(message.where),
        message.before if message.HasField("before") else None,
    )


def answer_message(answer: PlaceAnswer) -> pb.NearestResponse:
    """An answer to send."""
    return pb.NearestResponse(
        submap_numbers=[match.submap_number for match in answer.matches],
        similarities=[match.similarity for match in answer.matches],
        searched=answer.searched,
        on_other_storeys=answer.on_other_storeys,
    )


def answer_of(message: pb.NearestResponse) -> PlaceAnswer:
    """An answer that came."""
    pairs = zip(message.submap_numbers, message.similarities, strict=True)
    return PlaceAnswer(tuple(VectorMatch(*pair) for pair in pairs), message.searched, message.on_other_storeys)


def _filter_message(where: VectorFilter) -> pb.Filter:
    sessions = where.only_sessions
    return pb.Filter(
        exclude_session=where.exclude_session,
        only_session=where.only_session,
        only_sessions=None if sessions is None else pb.Numbers(numbers=sorted(sessions)),
        of_session=where.of_session,
        without=sorted(where.without),
        position_m=where.position_m,
        radius_m=where.radius_m,
    )


def _filter_of(message: pb.Filter) -> VectorFilter:
    def given(name: str) -> bool:
        return bool(message.HasField(name))

    x_y_z = tuple(message.position_m)
    return VectorFilter(
        exclude_session=message.exclude_session if given("exclude_session") else None,
        only_session=message.only_session if given("only_session") else None,
        only_sessions=frozenset(message.only_sessions.numbers) if given("only_sessions") else None,
        of_session=message.of_session if given("of_session") else None,
        without=frozenset(message.without),
        position_m=(x_y_z[0], x_y_z[1], x_y_z[2]) if x_y_z else None,
        radius_m=message.radius_m if given("radius_m") else None,
    )
