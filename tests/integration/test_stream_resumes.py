"""A robot's stream outlives kill -9 and SIGTERM of the service: every scan is stored once, in order."""

from __future__ import annotations

import pytest

from revisit import Client
from revisit.sdk.retry import RetryPolicy
from tests.faults.proxy import bad_link
from tests.support.processes import ForkedService
from tests.support.service_world import cloud_points, pose


@pytest.fixture
def service(tmp_path):
    running = ForkedService(tmp_path / "home", workers=0)
    yield running
    running.close()


def test_a_stream_outlives_kill_9_and_a_drain(service):
    with (
        bad_link(service.grpc_target) as link,
        Client.grpc(link.address, retry=RetryPolicy(base_s=0.05, cap_s=0.5)) as client,
    ):
        session = client.create_session(client.create_map("town"), "monday")
        with client.stream(session) as stream:
            for seq in range(1, 31):
                stream.send(cloud_points(seq), pose(0.5 * seq), seq)
                if seq == 10:
                    service.kill()
                if seq == 20:
                    assert service.terminate()[0] == 0
                if seq in (10, 20):
                    service.start()
                    link.target = service.grpc_target
        assert (stream.committed_seq, stream.rejected) == (30, [])
        stored = client.get_session(session.name)
    # Half a metre between scans: one lost, repeated or misplaced would give another number or another distance.
    assert (stored.committed_seq, stored.travelled_m) == (30, pytest.approx(14.5))
