"""A search in the index of another process, where there is one."""

from __future__ import annotations

import random
import threading
import time
from typing import TypeAlias

import grpc
import structlog

from revisit.core.errors import BadField
from revisit.internal.v1 import place_search_pb2 as pb
from revisit.service.domain.errors import Unavailable
from revisit.service.domain.placement import owners
from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.ports.place_search import PlaceAnswer, PlaceQuestion, PlaceSearch
from revisit.service.ports.transactions import Transactions, UnitOfWork
from revisit.service.search.messages import answer_of, question_message
from revisit.service.search.server import NEAREST, SERVICE, TOKEN, token_of

ALIVE_WITHIN_MS = 5_000
"""A search process that did not show itself for so long is asked no more."""

READ_AGAIN_S = 1.0
"""How often the list of search processes is read."""

PATIENCE_S = 15.0
"""How long a question waits for a process that answers: the next one may have to load the map."""

AGAIN_S = 0.2

WATCHED = tuple((f"grpc.{name}_ms", 2_000) for name in ("keepalive_time", "keepalive_timeout", "http2.ping_timeout"))
"""A process whose host was cut off resets no connection. One that loads a map answers pings, and is waited for."""


def search_processes(uow: UnitOfWork) -> list[LivingProcess]:
    """Those that live."""
    return uow.processes.alive(ProcessRole.SEARCH, ALIVE_WITHIN_MS)


Call: TypeAlias = "grpc.UnaryUnaryMultiCallable[pb.NearestRequest, pb.NearestResponse]"

log = structlog.get_logger(__name__)


class RemotePlaceSearch:
    """`PlaceSearch` in the search process that holds the map; in this process as long as none was ever seen."""

    def __init__(self, transactions: Transactions, secret: bytes, own: PlaceSearch) -> None:
        """`own` searches in this process."""
        self._transactions = transactions
        self._own = own
        self._token = ((TOKEN, token_of(secret)),)
        self._lock = threading.Lock()
        self._processes: list[LivingProcess] = []
        self._read_at_s = float("-inf")
        self._seen = False
        self._calls: dict[str, Call] = {}

    def anywhere(self) -> bool:
        """Whether this process needs no index, as search processes have been seen."""
        self._alive()
        return self._seen

    def nearest(self, question: PlaceQuestion) -> PlaceAnswer:
        """See `PlaceSearch`: asks until one answers."""
        until_s = time.monotonic() + PATIENCE_S
        while self.anywhere():
            answer = self._asked(question, until_s)
            if answer is not None:
                return answer
            if time.monotonic() >= until_s:
                raise Unavailable("no search process answers for this map")
            time.sleep(AGAIN_S)
        return self._own.nearest(question)

    def nearest_in(self, uow: UnitOfWork, question: PlaceQuestion, version: int | None) -> PlaceAnswer | None:
        """See `PlaceSearch`: another process knows no snapshot of this one."""
        return None if self._seen else self._own.nearest_in(uow, question, version)

    def _asked(self, question: PlaceQuestion, until_s: float) -> PlaceAnswer | None:
        """The answer of one that holds the map; None where it gave none."""
        held_by = owners(question.map_number, [one for one in self._alive() if one.ready])
        if not held_by:
            return None
        address = random.choice(held_by).address
        try:
            message = question_message(question)
            left_s = max(until_s - time.monotonic(), AGAIN_S)
            return answer_of(self._call(address)(message, timeout=left_s, metadata=self._token))
        except grpc.RpcError as error:
            self._failed(address, error)
            return None

    def _failed(self, address: str, error: grpc.RpcError) -> None:
        """Note that a process did not answer. Raises BadField where the question is at fault."""
        status, details = error.code(), error.details()
        if status is grpc.StatusCode.INVALID_ARGUMENT:
            raise BadField(str(details), field="descriptor") from error
        log.warning("search_process_silent", address=address, status=status.name, reason=str(details)[:200])
        with self._lock:
            self._processes = [one for one in self._processes if one.address != address]

    def _alive(self) -> list[LivingProcess]:
        with self._lock:
            if time.monotonic() - self._read_at_s >= READ_AGAIN_S:
                self._processes = self._transactions.read_here(search_processes)
                self._read_at_s = time.monotonic()
                self._seen = self._seen or bool(self._processes)
            return self._processes

    def _call(self, address: str) -> Call:
        with self._lock:
            if address not in self._calls:
                self._calls[address] = grpc.insecure_channel(address, WATCHED).unary_unary(
                    f"/{SERVICE}/{NEAREST}", pb.NearestRequest.SerializeToString, pb.NearestResponse.FromString
                )
            return self._calls[address]
