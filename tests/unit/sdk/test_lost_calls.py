"""Calls of which gRPC never says anything any more."""

from __future__ import annotations

import threading

import grpc
import pytest

from revisit.sdk import grpc_answers, scan_stream
from revisit.sdk.clouds import Cloud
from revisit.sdk.errors import AlreadyExists, Unavailable, unreachable
from revisit.sdk.grpc_answers import Answers, LostCall, answer
from revisit.sdk.grpc_transport import GrpcTransport, _api_error
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.scan_stream import GrpcScanSink
from revisit.v1 import ingest_pb2, system_pb2
from tests.support.patience import PATIENCE_S

ONCE = RetryPolicy(attempts=1)


class SilentCall:
    """Ends for nobody: neither at its deadline nor when it is cancelled."""

    def __iter__(self):
        return self

    def __next__(self):
        threading.Event().wait()

    def future(self, request, timeout, metadata):
        return self

    def result(self, timeout):
        assert timeout <= 0.07
        raise grpc.FutureTimeoutError

    def cancel(self):
        pass


class Failure(grpc.RpcError):
    def code(self):
        return grpc.StatusCode.UNAVAILABLE

    def details(self):
        return "gone"

    def trailing_metadata(self):
        return ()


def test_a_unary_call_that_never_returns_is_left(monkeypatch):
    monkeypatch.setattr(grpc_answers, "LOST_AFTER_S", 0.01)
    with pytest.raises(LostCall, match=r"0\.06 s"):
        answer(SilentCall(), None, 0.05, ())


def test_the_client_tells_a_lost_call_like_a_service_that_cannot_be_reached(monkeypatch):
    def lost(*_):
        raise LostCall(95.0)

    monkeypatch.setattr("revisit.sdk.grpc_transport.answer", lost)
    transport = GrpcTransport("127.0.0.1:1", ONCE)
    try:
        with pytest.raises(Unavailable) as failure:
            transport.call("GetStatus", system_pb2.GetStatusRequest())
    finally:
        transport.close()
    assert (failure.value.reason, failure.value.retryable) == ("UNREACHABLE", True)


def test_answers_of_a_call_come_in_order_and_end():
    assert list(Answers(iter([1, 2, 3])).all(PATIENCE_S)) == [1, 2, 3]


def test_a_failure_comes_behind_the_answers_before_it():
    def failing():
        yield 1
        raise Failure

    answers = Answers(failing())
    assert answers.next(PATIENCE_S) == 1
    with pytest.raises(Failure):
        answers.next(PATIENCE_S)


def test_answers_that_never_come_are_not_awaited_for_ever():
    with pytest.raises(LostCall):
        Answers(SilentCall()).next(0.01)


def test_a_stream_whose_opening_is_lost_is_opened_again(monkeypatch):
    monkeypatch.setattr(scan_stream, "OPENED_WITHIN_S", 0.05)
    opened = ingest_pb2.StreamScansResponse(opened=ingest_pb2.Opened(credits=4))
    calls = []

    class Acknowledging(SilentCall):
        def __init__(self, requests):
            self._requests = requests

        def __iter__(self):
            for request in self._requests:
                if request.HasField("open"):
                    yield opened
                else:
                    ack = ingest_pb2.Ack(committed_seq=request.scan.seq, credits=1)
                    yield ingest_pb2.StreamScansResponse(ack=ack)

    def call(requests):
        calls.append(requests)
        if len(calls) == 1:
            return SilentCall()
        monkeypatch.setattr(scan_stream, "OPENED_WITHIN_S", PATIENCE_S)
        return Acknowledging(requests)

    sink = GrpcScanSink(call, "maps/a/sessions/b", RetryPolicy(attempts=3), lambda error: _api_error(error, "robot:1"))
    sink.send(Cloud(b"cloud", "application/octet-stream"), {}, 1)
    sink.flush()
    assert (len(calls), sink.committed_seq) == (2, 1)
    sink.close()


def test_a_number_that_another_scan_has_ends_the_sending_with_what_to_do():
    opened = ingest_pb2.StreamScansResponse(opened=ingest_pb2.Opened(credits=4))
    taken = ingest_pb2.Nack(seq=1, reason="ALREADY_EXISTS", message="create a new session", expected_seq=6, credits=1)

    class Refusing(SilentCall):
        def __init__(self, requests):
            self._requests = requests

        def __iter__(self):
            for request in self._requests:
                answer = opened if request.HasField("open") else ingest_pb2.StreamScansResponse(nack=taken)
                yield answer

    sink = GrpcScanSink(Refusing, "maps/a/sessions/b", ONCE, lambda error: unreachable("robot:1", error))
    sink.send(Cloud(b"cloud", "application/octet-stream"), {}, 1)
    with pytest.raises(AlreadyExists, match="create a new session"):
        sink.flush()
    sink.close()


def test_a_stream_whose_openings_are_all_lost_gives_up(monkeypatch):
    monkeypatch.setattr(scan_stream, "OPENED_WITHIN_S", 0.01)
    with pytest.raises(Unavailable) as failure:
        GrpcScanSink(lambda _: SilentCall(), "maps/a/sessions/b", ONCE, lambda error: unreachable("robot:1", error))
    assert failure.value.reason == "UNREACHABLE"
