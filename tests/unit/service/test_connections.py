"""Connections without authentication, by address."""

from __future__ import annotations

import pytest

from revisit.service.capacity.addresses import holder_of
from revisit.service.capacity.limits import KNOWN_S, ArrivalRates
from revisit.service.edge.connections import Shown, UnauthenticatedConnections


@pytest.fixture
def ended():
    """The names of the connections that had to leave."""
    return []


def arriving(unauthenticated, ended, *arrivals):
    """The functions to call once each is authenticated or closed."""
    return [unauthenticated.arrive(address, lambda name=name: ended.append(name)) for name, address in arrivals]


def test_the_oldest_newcomer_of_an_address_leaves_where_it_has_too_many(ended):
    unauthenticated = UnauthenticatedConnections(2)
    arriving(unauthenticated, ended, ("a", "10.0.0.1"), ("b", "10.0.0.1"), ("other", "10.0.0.2"), ("c", "10.0.0.1"))
    assert (ended, unauthenticated.of("10.0.0.1"), unauthenticated.of("10.0.0.2")) == (["a"], 2, 1)


def test_one_that_has_settled_leaves_no_more_and_makes_room_once(ended):
    unauthenticated = UnauthenticatedConnections(2)
    settle_a, _ = arriving(unauthenticated, ended, ("a", "10.0.0.1"), ("b", "10.0.0.1"))
    settle_a()
    settle_a()
    arriving(unauthenticated, ended, ("c", "10.0.0.1"), ("d", "10.0.0.1"))
    assert ended == ["b"]


@pytest.mark.parametrize(
    ("address", "holder"),
    [
        ("10.0.0.1", "10.0.0.1"),
        ("2001:db8:1:2:3::4", "2001:db8:1:2::/64"),
        ("2001:db8:1:2:ffff::", "2001:db8:1:2::/64"),
        ("::ffff:10.0.0.1", "10.0.0.1"),
        ("a socket without an address", "a socket without an address"),
    ],
)
def test_an_ipv6_address_stands_for_its_network(address, holder):
    assert holder_of(address) == holder


RATES = ArrivalRates(
    anonymous_per_s=2.0, unknown_per_s=4.0, network_times=1.5, all_times=2.5, client_per_s=2.0, burst_s=1.0
)


class Time:
    now_s = 0.0


@pytest.fixture
def time():
    return Time()


@pytest.fixture
def arrivals(time):
    return UnauthenticatedConnections(rates=RATES, now_s=lambda: time.now_s)


def begun(arrivals, *addresses):
    return [arrivals.may_begin(address) for address in addresses]


def test_connections_of_an_address_begin_at_its_pace_and_those_of_others_at_theirs(arrivals, time):
    assert begun(arrivals, *["10.0.0.1"] * 3) == [True, True, False]
    assert begun(arrivals, "10.1.0.1") == [True]
    time.now_s += 0.5
    assert begun(arrivals, *["10.0.0.1"] * 2) == [True, False]


@pytest.mark.parametrize(
    "addresses",
    [["10.0.0.1", "10.0.0.2", "10.0.0.3", "10.0.0.4"], [f"2001:db8:1:2::{host}" for host in range(4)]],
    ids=["/24", "/64"],
)
def test_addresses_that_begin_alike_have_a_pace_together(arrivals, addresses):
    assert begun(arrivals, *addresses)[-1] is False


def test_all_addresses_have_a_pace_together(arrivals):
    assert begun(arrivals, *(f"10.{net}.0.1" for net in range(6))) == [True] * 5 + [False]


def test_connections_over_which_somebody_is_admitted_do_not_count(arrivals):
    for number in range(50):
        assert arrivals.may_begin("10.0.0.1")
        arrivals.vouch("10.0.0.1", f"rv_{number}")


def test_connections_of_one_credential_count_where_they_are_too_many(arrivals):
    begun_of_it = 0
    while arrivals.may_begin("10.0.0.1"):
        arrivals.vouch("10.0.0.1", "rv_key")
        begun_of_it += 1
    assert begun_of_it == 2 * 2


def test_where_anyone_is_admitted_connections_do_not_count(arrivals):
    for _ in range(50):
        assert arrivals.may_begin("10.0.0.1")
        arrivals.vouch("10.0.0.1", None)


def test_a_credential_is_known_for_a_while_after_it_was_admitted_and_has_a_pace(arrivals, time):
    assert not arrivals.is_known("rv_key")
    arrivals.vouch("10.0.0.1", "rv_key")
    assert (arrivals.is_known("rv_key"), arrivals.is_known("rv_other")) == (True, False)
    assert [arrivals.may_return("rv_key") for _ in range(2)] == [True, False]
    time.now_s += KNOWN_S
    assert not arrivals.is_known("rv_key")


def test_connections_that_show_something_have_a_pace_of_their_own(arrivals):
    assert begun(arrivals, *["10.0.0.1"] * 3)[-1] is False
    assert [arrivals.may_begin("10.0.0.1", Shown.UNKNOWN) for _ in range(5)] == [True] * 4 + [False]


def test_addresses_that_have_not_come_for_long_are_forgotten(arrivals, monkeypatch):
    monkeypatch.setattr(arrivals._budget._buckets, "most", 20)
    for host in range(100):
        arrivals.may_begin(f"10.{host}.0.1")
    assert len(arrivals._budget._buckets) == 20
