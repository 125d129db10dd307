"""No call of the service is without a bound (P11): each waits for its turn and holds a slot, whoever asks for it."""

from __future__ import annotations

import grpc
import httpx
import pytest

from revisit.service.capacity.slots import Slots
from revisit.service.domain.errors import RateLimited
from tests.support.credentials import a_key, bearer, ended
from tests.support.every_call import PUBLIC_PATHS, rest_calls, rpcs
from tests.support.paced import BEFORE_REFUSAL, BURST

ROUTES = [call for call in rest_calls() if call.values[1] not in PUBLIC_PATHS]


@pytest.fixture(scope="module")
def key(paced):
    return bearer(a_key(paced.world))


@pytest.fixture(scope="module")
def http(paced):
    with httpx.Client(base_url=paced.http, trust_env=False) as opened:
        yield opened


@pytest.fixture(scope="module")
def channel(paced):
    with grpc.insecure_channel(paced.grpc) as opened:
        yield opened


@pytest.fixture
def no_turn_left(line, http, key):
    """The client has begun as many calls as may begin or wait."""
    line.start_anew()
    asked = [http.get("/v1/maps/nowhere", headers=key).status_code for _ in range(BEFORE_REFUSAL)]
    assert asked == [404] * BEFORE_REFUSAL


@pytest.fixture
def no_stranger_left(paced, line, http):
    """Callers of this address that nobody knows were refused so often that the next ones wait."""
    line.start_anew()
    paced.world.clock.ms += 600_000  # failed attempts of the tests before are forgotten
    asked = [http.get("/v1/maps/nowhere", headers=bearer("rv_none")).status_code for _ in range(BURST)]
    assert (asked, line.waited) == ([401] * BURST, 0)


@pytest.fixture
def no_slot_left(line, monkeypatch):
    """All slots, of whatever kind, are taken."""
    line.start_anew()

    def taken(*_):
        raise RateLimited("all slots are taken", retry_after_s=1.0)

    monkeypatch.setattr(Slots, "take", taken)


@pytest.mark.parametrize("bound", ["no_turn_left", "no_slot_left"])
@pytest.mark.parametrize(("method", "path", "_scopes"), ROUTES)
def test_no_route_is_answered_beyond_the_bounds_of_a_client(request, http, key, bound, method, path, _scopes):
    request.getfixturevalue(bound)
    answer = http.request(method, path, headers=key)
    assert (answer.status_code, answer.json()["reason"]) == (429, "RATE")


@pytest.mark.parametrize("bound", ["no_turn_left", "no_slot_left"])
@pytest.mark.parametrize(("_service", "method"), list(rpcs()))
def test_no_rpc_is_answered_beyond_the_bounds_of_a_client(request, channel, key, bound, _service, method):
    request.getfixturevalue(bound)
    code, _ = ended(channel, method, key.items())
    assert code is grpc.StatusCode.RESOURCE_EXHAUSTED


@pytest.mark.parametrize(("method", "path", "_scopes"), ROUTES)
def test_whatever_route_a_stranger_asks_for_it_waits_to_be_refused(no_stranger_left, line, http, method, path, _scopes):
    assert http.request(method, path, headers=bearer("rv_none")).status_code == 401
    assert line.waited == 1


@pytest.mark.parametrize(("_service", "method"), list(rpcs()))
def test_whatever_rpc_a_stranger_asks_for_it_waits_to_be_refused(no_stranger_left, line, channel, _service, method):
    code, _ = ended(channel, method, bearer("rv_none").items())
    assert (code, line.waited) == (grpc.StatusCode.UNAUTHENTICATED, 1)
