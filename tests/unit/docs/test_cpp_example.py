"""The C++ example uses messages, fields and calls of the protocol. No test compiles it: gRPC for C++ is not here."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

from revisit.v1 import cloud_pb2, geometry_pb2, ingest_pb2, loop_closure_pb2, map_pb2, session_pb2

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = (ROOT / "docs/examples/stream_scans.cc").read_text()
FILES = [file.DESCRIPTOR for file in (cloud_pb2, geometry_pb2, ingest_pb2, loop_closure_pb2, map_pb2, session_pb2)]
MESSAGES = {name: message for file in FILES for name, message in file.message_types_by_name.items()}
FIELDS = {field.name for message in MESSAGES.values() for field in message.fields}
OF_GRPC = {"ok", "error_message", "data", "size", "takes", "go_on", "begin", "end", "clear", "push_back"}
"""And of the example and of the standard library."""


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


def test_no_field_has_a_name_that_the_code_of_every_message_has_already() -> None:
    # With protoc 3.21 (Debian 12, Ubuntu 24.04) a field `descriptor` gives C++ that no compiler takes.
    taken = {"descriptor", "default_instance", "swap", "unknown_fields", "byte_size_long", "get_metadata"}
    names = [file.stem for file in (ROOT / "proto/revisit/v1").glob("*.proto")]
    files = [import_module(f"revisit.v1.{name}_pb2").DESCRIPTOR for name in names]
    fields = {
        f"{message.name}.{field.name}" for file in files for message in file.message_types_by_name.values()
        for field in message.fields if field.name in taken
    }  # fmt: skip
    assert fields == set()
