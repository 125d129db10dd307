"""Credentials sent in every way through every call of a running service are found nowhere behind it (P21)."""

from __future__ import annotations

import asyncio
import json
import re
import secrets
from pathlib import Path

import grpc
import httpx
import pytest

from revisit.api.calls import CALLS
from revisit.service.features.keys.calls import CreateKey, parse_key
from revisit.service.rest.app import create_app
from tests.support.campaigns import Campaign, sizes
from tests.support.credentials import ALL_SCOPES, ended
from tests.support.patience import PATIENCE_S
from tests.support.processes import ForkedService
from tests.support.service_world import memory_world, sqlite_world
from tests.support.trace_receiver import TraceReceiver, trace_receiver

GOOD_KEYS = 5
IDS = {"robot": "rover", "map": "town", "session": "monday", "submap": "a", "operation": "op-1", "loop": "l-1"}
IDS |= {"version": "1", "webhook": "hook", "merge": "m-1", "tile": "f1-0-0", "anchor": "a-1", "plan": "p-1"}


def planted_keys(home: Path) -> list[str]:
    """Keys that open, made beside the service as an operator makes them; their secret part alone."""
    world = sqlite_world(home)
    made = [
        asyncio.run(world.use_cases.keys.create(CreateKey("acme", ALL_SCOPES, "a test", None)))
        for _ in range(GOOD_KEYS)
    ]
    world.context.transactions.close()
    return [key.text for key in made]


def wrong_credentials(count: int) -> list[str]:
    """What strangers and careless clients send: keys that open nothing, tokens, passwords."""
    makers = (
        lambda: f"rv_{secrets.token_hex(6)}_{secrets.token_hex(22)}",
        lambda: f"eyJhbGciOiJSUzI1NiJ9.{secrets.token_urlsafe(30)}.{secrets.token_urlsafe(30)}",
        lambda: secrets.token_urlsafe(32),
    )
    return [makers[number % len(makers)]() for number in range(count)]


def secret_part(credential: str) -> str:
    """The public id of a key is no secret, and the header of a token is that of every token."""
    return credential[16:] if credential.startswith("rv_") else credential.removeprefix("eyJhbGciOiJSUzI1NiJ9.")


@pytest.fixture
def traces():
    with trace_receiver() as receiver:
        yield receiver


@pytest.fixture
def keys_and_service(tmp_path, traces):
    keys = planted_keys(tmp_path / "home")
    settings = {"metrics_port": 0, "log_level": "DEBUG", "authentication": "on", "otlp_endpoint": traces.endpoint}
    running = ForkedService(tmp_path / "home", workers=0, **settings)
    yield keys, running
    running.close()


def send_over_rest(http: httpx.Client, credential: str, calls: list[tuple[str, str]], number: int) -> str:
    """One call that shows the credential in one of the ways clients try; all that is answered."""
    method, path = calls[number % len(calls)]
    url = re.sub(r"{(\w+)_id}", lambda m: IDS[m[1]], path)
    ways = (
        {"headers": {"authorization": f"Bearer {credential}"}},
        {"headers": {"authorization": f"bearer  {credential}"}},
        {"headers": {"x-api-key": credential, "cookie": f"session={credential}"}},
        {"headers": {"proxy-authorization": f"Basic {credential}"}, "auth": ("robot", credential)},
        {"headers": {"tracestate": f"vendor={credential}", "traceparent": credential, "baggage": f"key={credential}"}},
        {"params": {"api_key": credential, "access_token": credential}},
        {"url": f"{url}/{credential}", "headers": {"user-agent": credential, "referer": f"http://{credential}/"}},
    )
    answer = http.request(method, **{"url": url, **ways[number % len(ways)]})
    return f"{answer.headers} {answer.text}"


def send_over_grpc(channel: grpc.Channel, credential: str, methods: list, number: int) -> str:
    return repr(ended(channel, methods[number % len(methods)], [("authorization", f"Bearer {credential}")]))


def everything_left(service: ForkedService, home: Path, answers: list[str], traces: TraceReceiver) -> dict[str, bytes]:
    """What could give a secret away once the service has ended: answers, log, metrics with labels, traces, files."""
    port = service.wait_for("metrics_listening")["port"]
    metrics = httpx.get(f"http://127.0.0.1:{port}/metrics", trust_env=False, timeout=PATIENCE_S).content
    assert service.terminate()[0] == 0
    log = json.dumps(service.events).encode() + "\n".join(service.other_lines).encode()
    files = {path.name: path.read_bytes() for path in home.rglob("*") if path.is_file()}
    return {"answers": "\n".join(answers).encode(), "metrics": metrics, "log": log, "traces": traces.content(), **files}


@pytest.mark.parametrize("count", sizes("PLANTED_SECRETS", 60, 1_000))
@pytest.mark.timeout(1800)
def test_no_planted_secret_is_found_in_answers_logs_metrics_traces_or_files(keys_and_service, traces, tmp_path, count):
    keys, service = keys_and_service
    paths = create_app(memory_world().use_cases).openapi()["paths"]
    calls = [(method, path) for path, methods in paths.items() for method in methods]
    methods = [call.method for call in CALLS.values()]
    planted = [*keys, *wrong_credentials(count - len(keys))]
    answers, campaign = [], Campaign("P21", count)
    with (
        httpx.Client(base_url=service.url, trust_env=False, timeout=PATIENCE_S) as http,
        grpc.insecure_channel(service.grpc_target) as channel,
    ):
        for number in campaign:
            answers.append(send_over_rest(http, planted[number - 1], calls, number))
            answers.append(send_over_grpc(channel, planted[number - 1], methods, number))
    left = everything_left(service, tmp_path / "home", answers, traces)
    # The search does find what is there: the public id of a key, the names of the calls.
    assert parse_key(keys[0]).key_id.encode() in left["revisit.db"]
    assert all(b"PostSubmap" in left[where] and b"/v1/maps/{map_id}" in left[where] for where in ("metrics", "traces"))
    assert len(traces.spans()) > 1.8 * campaign.done, "only probes leave no span"
    found = [
        (where, secret) for secret in planted for where, text in left.items() if secret_part(secret).encode() in text
    ]
    assert found == []
    campaign.publish(f"0 of {campaign.done} planted secrets in answers, log, metrics, traces and {len(left) - 4} files")
