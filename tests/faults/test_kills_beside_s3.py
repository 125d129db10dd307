"""kill -9 of gateway, worker and S3 server while robots post and stream, over a link that loses and refuses."""

from __future__ import annotations

import random
from contextlib import closing

import pytest

from revisit.service.engines.s3.blobs import S3BlobStore
from tests.faults.fleet import fleet_of
from tests.faults.robots import EXPECTED
from tests.faults.test_kill_campaign import kill_gateway, kill_worker
from tests.support.campaigns import Campaign, sizes
from tests.support.processes import ServiceProcess
from tests.support.s3 import Nanio, variables
from tests.support.s3_link import SLOW_DOWN, WHOLE, Fault, s3_link

FAULTS = (SLOW_DOWN, Fault(answer_lost=True), Fault(body_cut=10), Fault(refused=(500, "InternalError")))
FAULTY = 0.1


@pytest.fixture
def server(tmp_path):
    (tmp_path / "s3").mkdir()
    server = Nanio(tmp_path / "s3")
    yield server
    server.kill()


@pytest.mark.parametrize("kills", sizes("KILLS", 1, 300)[1:])
@pytest.mark.timeout(7200)
def test_nothing_is_acknowledged_whose_blob_is_not_in_the_bucket(server, tmp_path, monkeypatch, kills):
    rng, campaign, bucket = random.Random(36), Campaign("P1 with S3", kills), f"s3://{server.new_bucket()}/fleet"
    faulty = lambda _: rng.choice(FAULTS) if rng.random() < FAULTY else WHOLE  # noqa: E731
    with s3_link(server.address, faulty) as link:
        for name, value in variables(link.url).items():
            monkeypatch.setenv(name, value)
        settings = {"blob_url": bucket, "workers": 1, "fake_delay_s": 0.01}
        with (
            closing(ServiceProcess(tmp_path / "home", **settings)) as service,
            fleet_of(service, expected=EXPECTED) as fleet,
        ):
            for number in fleet.moments(campaign, seed=7):
                if number % 3 == 1:
                    kill_gateway(fleet)
                elif number % 3 == 2:
                    kill_worker(fleet, rng)
                else:
                    server.kill()
                    server.start()
            link.fault = lambda _: WHOLE
            found = fleet.require_kept(tmp_path / "home", S3BlobStore(bucket))
    assert set(found.states) == {"DESCRIBED"}, (found.states, found.failures)
    assert fleet.acknowledged() > campaign.done and fleet.scanner.committed_seq > 0
    assert not (tmp_path / "home" / "blobs").exists()
    campaign.publish(f"0 of {fleet.acknowledged()} acknowledged lost, 0 twice, each with its blobs in the bucket")
