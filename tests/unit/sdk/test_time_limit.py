"""Calls within a limit of time: repeated no longer, and told of by an error of their own."""

from __future__ import annotations

import asyncio
import socket
import time

import pytest

from revisit import AsyncClient, Client, within
from revisit.sdk.errors import ApiError, DeadlineExceeded, ErrorDetails, InvalidArgument, NotFound, Unavailable
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.time_limit import exceeded, remaining_s

BUSY = Unavailable(ErrorDetails("UNAVAILABLE", "WORKERS_BUSY", "busy", retryable=True))


@pytest.fixture
def silent():
    """A port that takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"127.0.0.1:{server.getsockname()[1]}"


def fail(error: ApiError):
    raise error


def test_without_a_limit_a_call_has_all_the_time_there_is():
    assert remaining_s(90.0) == 90.0 and exceeded(1e9) is None


def test_the_shorter_of_two_limits_holds_and_the_outer_one_comes_back():
    with within(5.0):
        with within(60.0):
            assert 4.0 < remaining_s(90.0) <= 5.0
        with within(1.0):
            assert remaining_s(90.0) <= 1.0
        assert 4.0 < remaining_s(90.0) <= 5.0
    assert remaining_s(90.0) == 90.0


def test_a_call_is_not_repeated_past_the_limit():
    patient = RetryPolicy(attempts=1000, base_s=0.01, cap_s=0.02)
    began = time.monotonic()
    with pytest.raises(DeadlineExceeded) as late, within(0.2):
        patient.run(lambda: fail(BUSY))
    assert late.value.reason == "TIME_LIMIT" and late.value.__cause__ is BUSY
    assert time.monotonic() - began < 5.0


def test_an_answer_within_the_limit_is_the_answer():
    missing = NotFound(ErrorDetails("NOT_FOUND", "NOT_FOUND", "no such map"))
    with within(30.0):
        assert RetryPolicy().run(lambda: 7) == 7
        with pytest.raises(NotFound):
            RetryPolicy().run(lambda: fail(missing))


@pytest.mark.parametrize("client", [lambda at: Client(f"http://{at}"), Client.grpc], ids=["rest", "grpc"])
def test_a_service_that_is_silent_is_waited_for_as_long_as_the_program_wants(silent, client):
    with client(silent) as made, pytest.raises(DeadlineExceeded) as late, within(0.3):
        made.list_maps()
    assert late.value.reason == "TIME_LIMIT"


def test_an_awaited_call_has_the_limit_of_its_task(silent):
    async def asked() -> None:
        client = AsyncClient(f"http://{silent}")
        with within(0.3):
            await client.maps.list()

    with pytest.raises(DeadlineExceeded):
        asyncio.run(asked())


@pytest.mark.parametrize("timeout_s", [0.0, -1.0, float("nan")])
def test_a_limit_that_is_none_is_refused(timeout_s):
    with pytest.raises(InvalidArgument), within(timeout_s):
        pass
