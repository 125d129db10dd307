"""The metrics of a running gateway: each is explained and watched, none can be made to grow by what clients send."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import grpc
import httpx
import pytest
import trustme

from revisit.v1 import map_pb2
from tests.support.monitoring import queries
from tests.support.patience import PATIENCE_S
from tests.support.processes import ROOT, ForkedService
from tests.support.scraping import asked_by, families, scrape, values_by_label

PAGE = (ROOT / "docs/reference/metrics.md").read_text()
HEADINGS = set(re.findall(r"^## (\S+)$", PAGE, re.MULTILINE))
EXPIRES = datetime(2031, 5, 17, 12, 30, tzinfo=UTC)

OF_A_SCRAPE = {"job", "instance"}
"""Labels that Prometheus adds."""


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    running = ForkedService(tmp_path_factory.mktemp("metrics") / "home", metrics_port=0, workers=0)
    running.wait_for("metrics_listening")
    yield running
    running.close()


@pytest.fixture(scope="module")
def over_tls(tmp_path_factory):
    """The metrics of a gateway with a certificate."""
    folder = tmp_path_factory.mktemp("tls")
    certificate = trustme.CA().issue_cert("localhost", not_after=EXPIRES)
    certificate.cert_chain_pems[0].write_to_path(folder / "chain.pem")
    certificate.private_key_pem.write_to_path(folder / "key.pem")
    files = {"tls_certificate": folder / "chain.pem", "tls_key": folder / "key.pem"}
    running = ForkedService(folder / "home", metrics_port=0, workers=0, **files)
    yield scrape(running)
    running.close()


@pytest.fixture(scope="module")
def told(service, over_tls):
    """Series -> label -> values, with what Prometheus adds by itself."""
    ask(service, 0)
    series = values_by_label([scrape(service), over_tls])
    series["up"] = {}
    return series


def series(service):
    return [line for line in scrape(service).splitlines() if not line.startswith("#")]


def ask(service, number):
    """Requests with names of their own: paths, ids, methods, RPCs."""
    with httpx.Client(base_url=service.url, timeout=PATIENCE_S, trust_env=False) as client:
        client.get(f"/v1/maps/nowhere-{number}")
        client.get(f"/{number}/unknown")
        client.request(f"METHOD{number}", "/v1/maps")
        client.post(f"/v1/operations/op-{number}:retry")
    with grpc.insecure_channel(service.grpc_target) as channel:
        call(channel, f"Method{number}", b"")
        call(channel, "GetMap", map_pb2.GetMapRequest(name=f"maps/nowhere-{number}").SerializeToString())


def call(channel, method, message):
    with pytest.raises(grpc.RpcError):
        channel.unary_unary(f"/revisit.v1.MapService/{method}")(message, timeout=PATIENCE_S)


def refusals(service, transport, reason):
    line = f'revisit_refused_calls_total{{reason="{reason}",transport="{transport}"}} '
    return next(float(told.removeprefix(line)) for told in series(service) if told.startswith(line))


def test_every_metric_is_explained_and_every_explained_one_exists(service, over_tls):
    ask(service, 0)
    plain = families(scrape(service))
    assert plain == HEADINGS - {"revisit_certificate_expiry_seconds"}
    assert families(over_tls) == HEADINGS


def test_clients_cannot_add_series_by_what_they_send(service):
    ask(service, 1)
    before = len(series(service))
    for number in range(2, 12):
        ask(service, number)
    after = series(service)
    assert len(after) <= before
    assert not any(re.search("nowhere-|op-[0-9]|METHOD[0-9]|Method[0-9]", line) for line in after)


@pytest.mark.parametrize(("transport", "calls"), [("http", 3), ("grpc", 1)])
def test_a_refused_call_is_counted_under_its_reason(service, transport, calls):
    before = refusals(service, transport, "NOT_FOUND")
    ask(service, 12)
    assert refusals(service, transport, "NOT_FOUND") - before == calls


def test_the_end_of_the_certificate_is_told(over_tls):
    value = re.search(r"^revisit_certificate_expiry_seconds (\S+)$", over_tls, re.MULTILINE)[1]
    assert float(value) == EXPIRES.timestamp()


@pytest.mark.parametrize("query", queries().values(), ids=queries().keys())
def test_a_query_of_an_alert_or_a_panel_asks_for_what_there_is(told, query):
    selected, grouped_by = asked_by(query)
    assert selected
    for asked in selected:
        labels = told[asked.name].keys() | OF_A_SCRAPE if asked.name in told else set()
        assert labels, f"no series {asked.name}"
        assert grouped_by <= labels
        for label, operator, value in asked.conditions:
            assert label in labels
            named = value.split("|") if operator == "Re" else [value]
            assert label == "job" or set(named) <= told[asked.name][label]


def test_what_is_not_watched_is_said_to_be_so():
    watched = {
        re.sub("_(total|bucket|count|sum)$", "", asked.name) for q in queries().values() for asked in asked_by(q)[0]
    }
    said = set(re.findall("`(.*?)`", re.search("Neither on the dashboard nor in an alert: (.*)", PAGE)[1]))
    assert HEADINGS - watched == said
