"""The C++ example uses messages, fields and calls of the protocol. It is not compiled: gRPC for C++ is not here."""

from __future__ import annotations

import re
from pathlib import Path

from revisit.v1 import cloud_pb2, geometry_pb2, ingest_pb2, loop_closure_pb2, map_pb2, session_pb2

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = (ROOT / "docs/examples/stream_scans.cc").read_text()
FILES = [file.DESCRIPTOR for file in (cloud_pb2, geometry_pb2, ingest_pb2, loop_closure_pb2, map_pb2, session_pb2)]
MESSAGES = {name: message for file in FILES for name, message in file.message_types_by_name.items()}
FIELDS = {field.name for message in MESSAGES.values() for field in message.fields}
OF_GRPC = {"ok", "error_message", "data", "size"}


def test_every_message_exists() -> None:
    named = set(re.findall(r"rv::(\w+(?:Request|Response)|Scan)\b", EXAMPLE))
    assert len(named) == 7 and named <= MESSAGES.keys()


def test_every_accessor_is_one_of_a_field() -> None:
    called = set(re.findall(r"(?:->|\.)([a-z]\w*)\(", EXAMPLE)) - OF_GRPC
    fields = {re.sub(r"^(set|mutable|add|has)_", "", name) for name in called}
    assert {"set_seq", "mutable_t_odom_sensor", "has_loop_closed"} <= called
    assert fields <= FIELDS


def test_every_call_is_one_of_the_services() -> None:
    services = {name: service for file in FILES for name, service in file.services_by_name.items()}
    calls = re.findall(r"rv::(\w+)::NewStub\(channel\)(?:->(\w+)\()?", EXAMPLE)
    assert len(calls) == 3
    for service, call in [*calls, ("IngestService", "StreamScans")]:
        assert not call or call in services[service].methods_by_name
