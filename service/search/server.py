"""The gRPC server of a search process: for processes of the same secret alone."""

from __future__ import annotations

import hashlib
import hmac
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc

from revisit.core.errors import BadField
from revisit.internal.v1 import place_search_pb2 as pb
from revisit.service.ports.place_search import PlaceSearch
from revisit.service.search.load import MapLoad
from revisit.service.search.messages import answer_message, question_of

SERVICE, NEAREST = "revisit.internal.v1.PlaceSearchService", "Nearest"

TOKEN = "revisit-search-token"
"""The metadata of a call that proves the secret."""

PINGED = (("grpc.http2.max_ping_strikes", 0),)
"""Whoever waits for an answer may ask as often as it likes whether this process is still there."""

THREADS = 4
"""Answers at a time: one computes while others read what was committed."""


def token_of(secret: bytes) -> str:
    """The proof of a secret."""
    return hmac.digest(secret, b"search", hashlib.sha256).hex()


class PlaceSearchServer:
    """Answers questions from the index of its process."""

    def __init__(self, search: PlaceSearch, secret: bytes, load: MapLoad) -> None:
        """`load` is told how long each map takes."""
        self._search = search
        self._load = load
        self._token = token_of(secret).encode()
        self._server = grpc.server(ThreadPoolExecutor(THREADS, thread_name_prefix="search"), options=PINGED)
        nearest = grpc.unary_unary_rpc_method_handler(
            self._answer, pb.NearestRequest.FromString, pb.NearestResponse.SerializeToString
        )
        self._server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler(SERVICE, {NEAREST: nearest})])

    def start(self, address: str) -> int:
        """Listen on `host:port`; the port. Raises OSError where it is taken."""
        try:
            port = int(self._server.add_insecure_port(address))
        except RuntimeError as error:
            raise OSError(f"cannot listen on {address}") from error
        self._server.start()
        return port

    def stop(self, grace_s: float) -> None:
        """Let running answers end."""
        self._server.stop(grace_s).wait()

    def _answer(self, request: pb.NearestRequest, context: Any) -> pb.NearestResponse:
        given = str(dict(context.invocation_metadata()).get(TOKEN, ""))
        if not hmac.compare_digest(given.encode(), self._token):
            context.abort(grpc.StatusCode.UNAUTHENTICATED, "no process of this installation")
        began_s = time.thread_time()
        try:
            return answer_message(self._search.nearest(question_of(request)))
        except (BadField, ValueError) as error:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))
            raise
        finally:
            self._load.note(request.map_number, time.thread_time() - began_s)
