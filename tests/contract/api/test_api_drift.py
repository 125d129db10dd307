"""The drift of a session's odometry, as its client states it, the same over REST and gRPC (docs/decisions/0349)."""

from __future__ import annotations

import itertools

import pytest

from revisit.sdk.errors import AlreadyExists, InvalidArgument

_numbers = itertools.count(1)


@pytest.fixture
def town(client):
    return client.create_map(f"drift-{next(_numbers)}").name


def test_a_session_tells_the_drift_that_it_was_created_with(client, town):
    made = client.create_session(town, "first", drift="WHEEL")
    assert made.drift == client.get_session(made.name).drift == "WHEEL"
    assert client.create_session(town, "second", drift="0.02 m/m 0.1 deg/m").drift == "0.02 m/m 0.1 deg/m"
    assert client.create_session(town, "third").drift is None


def test_a_session_with_another_drift_is_another_one(client, town):
    client.create_session(town, "first", drift="WHEEL")
    assert client.create_session(town, "first", drift="WHEEL").drift == "WHEEL"
    for other in ("VISUAL", None):
        with pytest.raises(AlreadyExists):
            client.create_session(town, "first", drift=other)


@pytest.mark.parametrize("bad", ["wheels", "3 %", "0.9 m/m 0.1 deg/m", "0.03 m/m"])
def test_what_is_no_drift_is_refused(client, town, bad):
    with pytest.raises(InvalidArgument) as refused:
        client.create_session(town, "first", drift=bad)
    assert refused.value.field == "drift"
