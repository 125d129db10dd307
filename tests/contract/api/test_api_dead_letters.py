"""Dead letters: what has failed for good is listed with its reason and can be queued again, on both transports."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.core.errors import BadField, DegenerateCloud
from revisit.sdk.errors import ApiError, OperationFailed
from revisit.service.capacity.backlog import JobPosting
from revisit.service.domain.errors import NotFound, WorkersBusy
from revisit.service.domain.identity import SubmapKey
from revisit.service.domain.states import OperationKind
from revisit.service.features.index.answers import SearchCriteria, criteria_to_json
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED, FakeRecogniser
from tests.support.service_world import SESSION, TENANT, cloud_points, memory_world, open_session, submap


@pytest.fixture
def failed(client, session):
    """The operation of a submap that cannot be described, once it has failed for good."""
    posted = client.post_submap(session, "poison", cloud_points(1, CANNOT_BE_DESCRIBED), np.eye(4), 1)
    with pytest.raises(OperationFailed):
        client.wait(posted)
    return client.get_operation(posted.name)


@pytest.fixture
async def world():
    made = memory_world()
    await open_session(made)
    yield made
    made.context.transactions.close()


async def state_of(world, submap_id="poison"):
    found = await world.use_cases.submaps.get(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, submap_id))
    return found.state, found.failure_message


def test_a_failed_description_is_listed_with_its_reason(client, failed):
    assert (failed.state, failed.attempts, failed.failure_reason) == ("FAILED", 1, "UNUSABLE_CLOUD")
    assert failed.failure_message == DegenerateCloud().message
    assert failed.name in [operation.name for operation in client.list_operations(state="FAILED")]


def test_a_failed_description_is_queued_again_with_new_attempts_and_fails_again(client, failed):
    again = client.retry_operation(failed)
    assert (again.name, again.state, again.attempts, again.failure_reason) == (failed.name, "QUEUED", 1, None)
    with pytest.raises(OperationFailed):
        client.wait(again)
    assert client.get_operation(failed.name).attempts == 2


def test_an_unknown_operation_cannot_be_queued_again(client):
    with pytest.raises(ApiError) as refused:
        client.retry_operation("operations/op-nowhere")
    assert refused.value.reason == "NOT_FOUND"


def test_the_command_line_lists_the_failed_and_queues_them_again(service, failed):
    service.working.clear()
    runner = CliRunner()
    listed = runner.invoke(app, ["operations", "--http", service.http, "--json"])
    found = {operation["name"]: operation for operation in json.loads(listed.output)}
    assert found[failed.name]["failure_reason"] == "UNUSABLE_CLOUD"
    operation_id = failed.name.partition("/")[2]
    again = runner.invoke(app, ["operations", "--retry", operation_id, "--http", service.http, "--json"])
    assert [operation["state"] for operation in json.loads(again.output)] == ["QUEUED"]
    service.working.set()
    for refused in (
        ["--retry"],
        ["--retry", "--all", "op-1"],
        ["op-1"],
        ["--all"],
        ["--cancel"],
        ["--retry", "--cancel", "op-1"],
    ):
        assert runner.invoke(app, ["operations", *refused, "--http", service.http]).exit_code == 1


async def test_a_description_that_was_queued_again_succeeds_once_the_method_is_mended(world):
    posted = await world.use_cases.posting.post(TENANT, submap("poison", 1, points=CANNOT_BE_DESCRIBED))
    world.work_off()
    assert await state_of(world) == ("FAILED", DegenerateCloud().message)
    await world.use_cases.dead_letters.retry(TENANT, posted.operation.operation_id)
    assert await state_of(world) == ("QUEUED", None)

    class Mended(FakeRecogniser):
        def describe(self, submap, config):
            kept = {"points": submap.points[:300], "scan_index": submap.scan_index[:300]}
            return super().describe(replace(submap, **kept), config)

    assert world.work_off(Mended()) == 1
    assert await state_of(world) == ("DESCRIBED", None)
    operation = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert (operation.state, operation.attempts, operation.failure_code) == ("DONE", 2, None)


async def test_what_has_not_failed_is_left_alone(world):
    posted = await world.use_cases.posting.post(TENANT, submap("good", 1))
    retry, operation_id = world.use_cases.dead_letters.retry, posted.operation.operation_id
    assert (await retry(TENANT, operation_id)).state == "QUEUED"
    world.work_off()
    assert (await retry(TENANT, operation_id)).state == "DONE"
    assert world.work_off() == 0


async def test_the_failed_description_of_a_deleted_submap_cannot_be_queued_again(world):
    posted = await world.use_cases.posting.post(TENANT, submap("poison", 1, points=CANNOT_BE_DESCRIBED))
    world.work_off()
    await world.use_cases.submaps.delete(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, "poison"))
    with pytest.raises(NotFound, match="was deleted"):
        await world.use_cases.dead_letters.retry(TENANT, posted.operation.operation_id)


async def test_a_failed_search_cannot_be_queued_again(world):
    # Its cloud was never stored, so it fails at once.
    payload = {"map_id": "town", "criteria": criteria_to_json(SearchCriteria()), "cloud_sha256": "0" * 64}
    jobs = JobPosting(world.context.backlog, world.clock, world.context.policy)
    job = world.context.transactions.write(
        lambda uow: jobs.post(uow, TENANT, OperationKind.LOCALIZE, "maps/town", payload)
    ).result()
    world.work_off()
    with pytest.raises(BadField, match="ask again"):
        await world.use_cases.dead_letters.retry(TENANT, job.operation_id)


async def test_a_full_queue_takes_no_dead_letters():
    world = memory_world(max_queued_jobs=1)
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("poison", 1, points=CANNOT_BE_DESCRIBED))
    world.work_off()
    await world.use_cases.posting.post(TENANT, submap("good", 2))
    with pytest.raises(WorkersBusy):
        await world.use_cases.dead_letters.retry(TENANT, posted.operation.operation_id)
    world.context.transactions.close()


async def test_another_tenants_failed_operation_does_not_exist(world):
    posted = await world.use_cases.posting.post(TENANT, submap("poison", 1, points=CANNOT_BE_DESCRIBED))
    world.work_off()
    with pytest.raises(NotFound):
        await world.use_cases.dead_letters.retry("another", posted.operation.operation_id)
