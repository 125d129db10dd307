"""Names of resources as a person writes them: an id where it is enough, else the message shows the whole form."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from revisit import Client
from revisit.api.calls import CALLS
from revisit.sdk.errors import InvalidArgument


class Recording:
    """A transport that notes the names it is asked for, and answers nothing."""

    def __init__(self):
        self.asked = []

    def call(self, name, request):
        if name.startswith("List"):
            self.asked.append(request.parent)
            return CALLS[name].response()
        self.asked.append(request.name)
        raise LookupError


@pytest.mark.parametrize("named", ["courtyard", "maps/courtyard", SimpleNamespace(name="maps/courtyard")])
def test_a_map_may_be_named_by_its_id(named):
    transport = Recording()
    client = Client(transport=transport)
    assert client.loop_closures(named) == client.list_sessions(named) == client.map_versions(named) == []
    for call in (client.get_map, client.optimise_map):
        with pytest.raises(LookupError):
            call(named)
    assert set(transport.asked) == {"maps/courtyard"}


def test_operations_robots_and_webhooks_may_be_named_by_their_ids():
    transport = Recording()
    client = Client(transport=transport)
    for call in (client.get_robot, client.get_operation, client.retry_operation, client.get_webhook):
        with pytest.raises(LookupError):
            call("one")
    assert transport.asked == ["robots/one", "operations/one", "operations/one", "webhooks/one"]


@pytest.mark.parametrize(
    ("call", "form"),
    [
        ("get_session", "maps/MAP/sessions/SESSION"),
        ("finish_session", "maps/MAP/sessions/SESSION"),
        ("list_submaps", "maps/MAP/sessions/SESSION"),
        ("get_submap", "maps/MAP/sessions/SESSION/submaps/SUBMAP"),
        ("get_loop_closure", "maps/MAP/loopClosures/LOOP"),
        ("get_map_version", "maps/MAP/versions/VERSION"),
        ("delete", "maps/MAP"),
    ],
)
def test_an_id_that_is_not_enough_is_refused_with_the_form_of_the_whole_name(call, form):
    with pytest.raises(InvalidArgument) as refused:
        getattr(Client(transport=Recording()), call)("monday")
    assert "'monday'" in str(refused.value) and form in str(refused.value)
