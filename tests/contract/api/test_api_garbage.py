"""What a call leaves is freed when it ends: the garbage collector would hold up every other call for it (P11)."""

from __future__ import annotations

import gc
import time
from collections import Counter
from pathlib import Path
from types import FrameType

import pytest

import revisit
from revisit import ApiError
from tests.support.service_world import cloud_points, pose

CALLS = 20
SERVICE = str(Path(revisit.__file__).parent / "service")


def refused(call):
    """The call, which the service refuses."""

    def refusal():
        with pytest.raises(ApiError):
            call()

    return refusal


@pytest.fixture
def calls(client, session, town):
    client.wait(client.post_submap(session, "here", cloud_points(7), pose(0.0), 1_000))
    return {
        "read": lambda: client.get_map(town),
        "search": lambda: client.search(town, submap=f"{session.name}/submaps/here"),
        "not found": refused(lambda: client.get_map("maps/nowhere")),
        "other content": refused(lambda: client.post_submap(session, "here", cloud_points(8), pose(0.0), 1_000)),
        "bad field": refused(lambda: client.search(town, submap=f"{session.name}/submaps/here", k=0)),
    }


@pytest.mark.parametrize("kind", ["read", "search", "not found", "other content", "bad field"])
def test_a_call_leaves_nothing_that_the_garbage_collector_must_find(calls, kind):
    calls[kind]()
    gc.freeze()  # what is there by now does not count
    generators = _generators()
    gc.disable()
    try:
        for _ in range(CALLS):
            calls[kind]()
        time.sleep(0.1)  # the answer has come before the service is through
        generators = _generators() - generators
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        frames = [thing.f_code for thing in gc.garbage if isinstance(thing, FrameType)]
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
    # The client, which is in this process, may leave some of its own.
    of_service = Counter(code.co_qualname for code in frames if code.co_filename.startswith(SERVICE))
    assert of_service.total() < CALLS / 2, of_service
    assert generators < CALLS / 2


def _generators():
    """How many asynchronous generators there are; gRPC's holds the message of a call, of 15 MiB perhaps."""
    return sum(type(thing).__name__ == "async_generator" for thing in gc.get_objects())
