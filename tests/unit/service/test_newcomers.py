"""Connections that have not shown who they are, by address."""

from __future__ import annotations

import pytest

from revisit.service.application.capacity.newcomers import Newcomers, holder_of


@pytest.fixture
def ended():
    """The names of the connections that had to leave."""
    return []


def arriving(newcomers, ended, *arrivals):
    """What to call for each once it is no newcomer any more."""
    return [newcomers.arrive(address, lambda name=name: ended.append(name)) for name, address in arrivals]


def test_the_oldest_newcomer_of_an_address_leaves_where_it_has_too_many(ended):
    newcomers = Newcomers(2)
    arriving(newcomers, ended, ("a", "10.0.0.1"), ("b", "10.0.0.1"), ("other", "10.0.0.2"), ("c", "10.0.0.1"))
    assert (ended, newcomers.of("10.0.0.1"), newcomers.of("10.0.0.2")) == (["a"], 2, 1)


def test_one_that_has_settled_leaves_no_more_and_makes_room_once(ended):
    newcomers = Newcomers(2)
    settle_a, _ = arriving(newcomers, ended, ("a", "10.0.0.1"), ("b", "10.0.0.1"))
    settle_a()
    settle_a()
    arriving(newcomers, ended, ("c", "10.0.0.1"), ("d", "10.0.0.1"))
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
