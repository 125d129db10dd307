"""The metrics of a running gateway: each is explained, none can be made to grow by what clients send."""

from __future__ import annotations

import re
from pathlib import Path

import grpc
import httpx
import pytest

from tests.support.patience import PATIENCE_S
from tests.support.processes import ROOT, ServiceProcess

PAGE = (Path(ROOT) / "docs/reference/metrics.md").read_text()


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    running = ServiceProcess(tmp_path_factory.mktemp("metrics") / "home", metrics_port=0, workers=0)
    running.wait_for("metrics_listening")
    yield running
    running.close()


def scrape(service):
    port = service.wait_for("metrics_listening")["port"]
    return httpx.get(f"http://127.0.0.1:{port}/metrics", trust_env=False, timeout=PATIENCE_S).text.splitlines()


def families(lines):
    found = {line.split()[2] for line in lines if line.startswith("# TYPE")}
    return {name.removesuffix("_total") for name in found if not name.endswith("_created")}


def series(lines):
    return [line for line in lines if not line.startswith("#")]


def ask(service, number):
    """Requests with names of their own: paths, ids, methods, RPCs."""
    with httpx.Client(base_url=service.url, timeout=PATIENCE_S, trust_env=False) as client:
        client.get(f"/v1/maps/nowhere-{number}")
        client.get(f"/{number}/unknown")
        client.request(f"METHOD{number}", "/v1/maps")
        client.post(f"/v1/operations/op-{number}:retry")
    with grpc.insecure_channel(service.grpc_target) as channel, pytest.raises(grpc.RpcError):
        channel.unary_unary(f"/revisit.v1.MapService/Method{number}")(b"", timeout=PATIENCE_S)


def test_every_metric_is_explained_and_every_explained_one_exists(service):
    ask(service, 0)
    headings = set(re.findall(r"^## (\S+)$", PAGE, re.MULTILINE))
    found = families(scrape(service))
    assert found - headings == set()
    assert headings - found == set()


def test_clients_cannot_add_series_by_what_they_send(service):
    ask(service, 1)
    before = len(series(scrape(service)))
    for number in range(2, 12):
        ask(service, number)
    after = series(scrape(service))
    assert len(after) <= before
    assert not any(re.search("nowhere-|op-[0-9]|METHOD|Method[0-9]", line) for line in after)
