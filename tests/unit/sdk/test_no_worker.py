"""A wait says within seconds that no worker is ready: at its first start a service compiles its kernels."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import pytest

from revisit.cli.waiting import waited
from revisit.sdk.errors import NoWorker
from revisit.sdk.groups import operations
from revisit.sdk.groups.operations import Operations
from revisit.sdk.resources import Operation
from revisit.v1 import operation_pb2, system_pb2

NAME = "operations/1"


class Waiting:
    """A transport to a service of so many workers, which has the operation in these states, one at each call."""

    def __init__(self, *states, workers=0):
        self.states, self.asked, self.workers = list(states), [], workers

    def call(self, name, request):
        self.asked.append(name)
        if name == "GetStatus":
            return system_pb2.GetStatusResponse(workers=[{"worker_id": str(n)} for n in range(self.workers)])
        state = operation_pb2.Operation.State.Value(self.states.pop(0))
        return operation_pb2.Operation(name=NAME, state=state)


def test_a_wait_of_the_sdk_warns_once_that_no_worker_is_ready():
    transport = Waiting("QUEUED", "QUEUED", "RUNNING", "DONE")
    with pytest.warns(NoWorker, match="compiles its kernels") as told:
        assert Operations(transport).wait(NAME).done
    assert len(told) == 1 and told[0].filename == __file__
    assert transport.asked.count("GetStatus") == 1


@pytest.mark.parametrize(("states", "workers"), [(("DONE",), 0), (("RUNNING", "DONE"), 0), (("QUEUED", "DONE"), 2)])
def test_a_wait_that_a_worker_ends_warns_of_nothing(states, workers):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Operations(Waiting(*states, workers=workers)).wait(NAME).done


def test_the_first_look_comes_within_two_seconds():
    assert operations.SILENT_S <= 2.0


@pytest.mark.parametrize("workers", [0, 1])
def test_a_command_that_waits_says_once_that_no_worker_is_ready(workers, capsys):
    queued, looks = Operation.of(operation_pb2.Operation(name=NAME, state=operation_pb2.Operation.QUEUED)), iter("ab")

    def wait(_operation, _timeout_s):
        if next(looks, None):
            raise TimeoutError
        return queued

    client = SimpleNamespace(
        wait=wait,
        get_operation=lambda _name: queued,
        status=lambda: SimpleNamespace(workers=("w",) * workers),
    )
    waited(client, queued, quiet=True)
    assert capsys.readouterr().err.count("compiles its kernels") == (not workers)
