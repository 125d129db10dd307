"""Sends what a case holds through one transport and reads the answer into one form."""

from __future__ import annotations

import contextlib
import queue
import socket
from dataclasses import dataclass
from typing import Any

import grpc
from google.protobuf.json_format import MessageToDict, ParseDict
from google.protobuf.message_factory import GetMessageClass
from google.rpc import error_details_pb2, status_pb2

from revisit.v1 import (
    cloud_pb2,
    geometry_pb2,
    ingest_pb2,
    ingest_pb2_grpc,
    loop_closure_pb2,
    map_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
)
from tests.corpus.rows import CloudToSend
from tests.corpus.write import body_of
from tests.support.patience import PATIENCE_S

_FILES = (ingest_pb2, loop_closure_pb2, map_pb2, operation_pb2, robot_pb2, session_pb2, submap_pb2, system_pb2)
METHODS = {
    f"{service.name}/{method.name}": method
    for file in _FILES
    for service in file.DESCRIPTOR.services_by_name.values()
    for method in service.methods
}


@dataclass(frozen=True)
class Answer:
    """Status (HTTP number or gRPC code name), reason of the error table, and the body as JSON."""

    status: int | str
    reason: str
    body: Any
    size: int = 0
    replay: bool = False


def filled(value: Any, places: dict[str, str]) -> Any:
    """`value` with {names} filled in, at any depth."""
    if isinstance(value, str):
        for name, place in places.items():
            value = value.replace(f"{{{name}}}", place)
        return value
    if isinstance(value, dict):
        return {key: filled(item, places) for key, item in value.items()}
    return [filled(item, places) for item in value] if isinstance(value, list) else value


def rest_answer(response) -> Answer:
    """An HTTP response."""
    is_json = "json" in response.headers.get("content-type", "")
    body = response.json() if is_json and response.content else {}
    replay = response.headers.get("idempotent-replay") == "true"
    return Answer(response.status_code, body.get("reason", ""), body, len(response.content), replay)


def rest_request(http, request: dict[str, Any], places: dict[str, str]) -> Answer:
    """An entry of `rest`."""
    request = filled(request, places)
    content = body_of(request["body"]) if "body" in request else request.get("json", "").encode()
    is_cloud = "body" in request and not request["body"].endswith(".json")
    content_type = request.get("type", "application/vnd.revisit.quantised" if is_cloud else "application/json")
    headers = {"content-type": content_type}
    if "override" in request:
        headers["x-http-method-override"] = request["override"]
    if "ranges" in request:
        headers["range"] = "bytes=" + ",".join(f"{n}-{n}" for n in range(request["ranges"]))
    return rest_answer(http.request(request["method"], request["path"], content=content, headers=headers))


def rest_cloud(http, path: str, cloud: CloudToSend, **query: Any) -> Answer:
    """A cloud as a submap or a scan."""
    headers = {"content-type": cloud.type, **({"content-encoding": cloud.encoding} if cloud.encoding else {})}
    pose = ",".join(repr(value) for value in cloud.pose)
    name = "T_odom_submap" if "submap_id" in query else "T_odom_sensor"
    params = {"stamp_ns": cloud.stamp_ns, name: pose, **query}
    return rest_answer(http.post(path, params=params, content=cloud.data, headers=headers))


def transform(pose: tuple[float, ...]) -> geometry_pb2.Transform:
    """Seven numbers as a message."""
    x, y, z, qx, qy, qz, qw = pose
    rotation = geometry_pb2.Quaternion(x=qx, y=qy, z=qz, w=qw)
    return geometry_pb2.Transform(translation=geometry_pb2.Vector3(x=x, y=y, z=z), rotation=rotation)


def cloud_message(cloud: CloudToSend) -> cloud_pb2.Cloud:
    """A file as a message."""
    return cloud_pb2.Cloud(encoded=cloud_pb2.EncodedCloud(content_type=cloud.type, data=cloud.data))


def grpc_cloud(channel, session: str, cloud: CloudToSend, submap_id: str) -> Answer:
    """A cloud as a submap."""
    request = submap_pb2.PostSubmapRequest(
        parent=session, submap_id=submap_id, t_odom_submap=transform(cloud.pose), stamp_ns=cloud.stamp_ns,
        cloud=cloud_message(cloud),
    )  # fmt: skip
    return grpc_call(channel, METHODS["SubmapService/PostSubmap"], request.SerializeToString())


def grpc_request(channel, entry: dict[str, Any], places: dict[str, str]) -> Answer:
    """An entry of `rpc`."""
    entry = filled(entry, places)
    method = METHODS.get(entry["method"])
    wire = body_of(entry["body"]) if "body" in entry else bytes.fromhex(entry.get("wire", ""))
    if "message" in entry:
        request = GetMessageClass(method.input_type)()
        wire = ParseDict(entry["message"], request).SerializeToString() + wire
    return grpc_call(channel, method or entry["method"], wire)


def grpc_call(channel, method: Any, wire: bytes, timeout_s: float = 30.0) -> Answer:
    """Raw bytes to a unary method, or to a method that does not exist."""
    if isinstance(method, str):
        path = method if method.startswith("/") else f"/revisit.v1.{method}"
    else:
        path = f"/{method.containing_service.full_name}/{method.name}"
    try:
        answer = channel.unary_unary(path)(wire, timeout=timeout_s)
    except grpc.RpcError as error:
        return Answer(error.code().name, grpc_reason(error), {"expected_seq": grpc_expected_seq(error)})
    return Answer("OK", "", as_json(GetMessageClass(method.output_type).FromString(answer)))


def as_json(message) -> dict[str, Any]:
    """A message as JSON, absent fields included."""
    return MessageToDict(message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)


def _error_info(error: grpc.RpcError) -> error_details_pb2.ErrorInfo:
    packed = dict(error.trailing_metadata() or ()).get("grpc-status-details-bin", b"")
    info = error_details_pb2.ErrorInfo()
    for detail in status_pb2.Status.FromString(packed).details:
        if detail.Is(info.DESCRIPTOR):
            detail.Unpack(info)
    return info


def grpc_reason(error: grpc.RpcError) -> str:
    """The reason of the error table, where the service itself refused."""
    return _error_info(error).reason


def grpc_expected_seq(error: grpc.RpcError) -> str:
    """The scan that the session expects, where the error says so."""
    return dict(_error_info(error).metadata).get("expected_seq", "")


class ScanTalk:
    """An open stream of scans."""

    def __init__(self, channel, session: str) -> None:
        self._requests: queue.SimpleQueue = queue.SimpleQueue()
        stub = ingest_pb2_grpc.IngestServiceStub(channel)
        self._answers = stub.StreamScans(iter(self._requests.get, None), timeout=PATIENCE_S)
        self._requests.put(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=session)))
        assert next(self._answers).HasField("opened")

    def send(self, cloud: CloudToSend, seq: int) -> Answer:
        """One scan; its Ack or Nack."""
        scan = ingest_pb2.Scan(
            seq=seq, stamp_ns=cloud.stamp_ns, t_odom_sensor=transform(cloud.pose), cloud=cloud_message(cloud)
        )
        self._requests.put(ingest_pb2.StreamScansRequest(scan=scan))
        answer = next(self._answers)
        while answer.WhichOneof("response") not in ("ack", "nack"):
            answer = next(self._answers)
        if answer.HasField("ack"):
            return Answer("OK", "", as_json(answer.ack))
        return Answer("NACK", answer.nack.reason, as_json(answer.nack))

    def end(self) -> None:
        """Close the client's side; the stream must end with OK."""
        self._requests.put(None)
        for _ in self._answers:
            pass


def raw_status(address: str, sent: bytes) -> int:
    """The status of the first answer to bytes on a TCP connection, 0 where it is closed without one."""
    host, _, port = address.removeprefix("http://").rpartition(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as connection:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.sendall(sent)
        try:
            answer = connection.recv(65536)
        except ConnectionResetError:
            return 0
    return int(answer.split(b" ", 2)[1]) if answer else 0
