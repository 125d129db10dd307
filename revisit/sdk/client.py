"""The client: methods named as the resources, over REST or gRPC alike."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from revisit.api.calls import CALLS
from revisit.sdk import names
from revisit.sdk.addresses import grpc_address, http_address
from revisit.sdk.clouds import PointsLike, encoded
from revisit.sdk.conversations import Conversation
from revisit.sdk.corrections import CorrectionWatch
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ErrorDetails, InvalidArgument
from revisit.sdk.explanations import NearMiss, explain
from revisit.sdk.groups.files import Files
from revisit.sdk.groups.group import Group
from revisit.sdk.groups.loops import Loops
from revisit.sdk.groups.maps import Maps
from revisit.sdk.groups.operations import Operations
from revisit.sdk.groups.plans import Plans
from revisit.sdk.groups.robots import Robots
from revisit.sdk.groups.sessions import Sessions
from revisit.sdk.groups.submaps import Submaps
from revisit.sdk.groups.versions import Versions
from revisit.sdk.groups.webhooks import Webhooks
from revisit.sdk.input_watch import InputWatch
from revisit.sdk.messages import pose_message, request_of
from revisit.sdk.names import name_in_map, name_of
from revisit.sdk.resources import Map, MapFile, Session, Status, Submap, Webhook
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.scan_choice import ScanChoice, Send
from revisit.sdk.spool import DEFAULT_MAX_BYTES, Spool
from revisit.sdk.spooled_stream import RECONNECT, SpooledStream
from revisit.sdk.transport import Forgetful, OnDelay, Refusal, ScanSink, Transport
from revisit.sdk.watching import Watch
from revisit.v1 import event_pb2, loop_closure_pb2, mapping_pb2, system_pb2

if TYPE_CHECKING:
    from typing import Self

DELETIONS = {
    "maps": "DeleteMap",
    "sessions": "DeleteSession",
    "submaps": "DeleteSubmap",
    "webhooks": "DeleteWebhook",
    "files": "DeleteMapFile",
    "plans": "DeletePlan",
}
"""The call that deletes a resource, by its collection."""


class Client:
    """A connection to the service. Resources are named as in the API: `maps/yard/sessions/monday`.

    A map, a robot, an operation and a webhook may be named by their id alone: `yard`.

    Creates are idempotent: the same id with the same content answers again. Retryable errors are retried. Every call
    raises `revisit.sdk.errors.ApiError`.
    """

    def __init__(
        self,
        http: str | None = None,
        *,
        api_key: str | None = None,
        ca: str | Path | None = None,
        transport: Transport | None = None,
        retry: RetryPolicy = RetryPolicy(),
    ) -> None:
        """Over REST at the URL `http`, by default $REVISIT_HTTP or port 8080 here; unless another transport is given.

        `api_key`, by default $REVISIT_API_KEY; `ca`, by default $REVISIT_CA: a PEM file of the authorities to trust.
        """
        if transport is None:
            from revisit.sdk.rest_transport import RestTransport

            credentials = Credentials.given(api_key, ca)
            transport = RestTransport(http_address(http), retry, credentials)
        self._transport: Transport = transport
        self._retry = retry
        self.maps = Maps(transport)
        self.robots = Robots(transport)
        self.sessions = Sessions(transport)
        self.submaps = Submaps(transport)
        self.loops = Loops(transport)
        self.versions = Versions(transport)
        self.files = Files(transport, retry)
        self.plans = Plans(transport)
        self.operations = Operations(transport)
        self.webhooks = Webhooks(transport)
        self._name_catalogue_calls()
        self._name_map_calls()
        self._name_other_calls()

    @property
    def groups(self) -> dict[str, Group]:
        """The groups of calls by name."""
        return {name: group for name, group in vars(self).items() if isinstance(group, Group)}

    @classmethod
    def grpc(
        cls,
        address: str | None = None,
        *,
        http: str | None = None,
        api_key: str | None = None,
        ca: str | Path | None = None,
        retry: RetryPolicy = RetryPolicy(),
    ) -> Self:
        """A client over gRPC at host:port, or `grpcs://host:port` for TLS, by default $REVISIT_GRPC.

        Without either, the service at the URL `http`, by default $REVISIT_HTTP or port 8080 here, is asked where its
        gRPC side is. Credentials as for REST; a client certificate from $REVISIT_CERTIFICATE and
        $REVISIT_CERTIFICATE_KEY.
        """
        from revisit.sdk.grpc_transport import GrpcTransport

        credentials = Credentials.given(api_key, ca)
        return cls(transport=GrpcTransport(grpc_address(address, http, credentials), retry, credentials), retry=retry)

    def _name_catalogue_calls(self) -> None:
        """Maps, robots, sessions and submaps, as programs of before there were groups name the calls."""
        self.create_map = self.maps.create
        self.get_map = self.maps.get
        self.list_maps = self.maps.list
        self.optimise_map = self.maps.optimise
        self.revert_map = self.maps.revert
        self.merge_map = self.maps.merge
        self.map_merges = self.maps.merges
        self.get_map_merge = self.maps.get_merge
        self.revert_merge = self.maps.revert_merge
        self.retention = self.maps.retention
        self.set_retention = self.maps.set_retention
        self.preview_retention = self.maps.preview_retention
        self.create_robot = self.robots.create
        self.get_robot = self.robots.get
        self.list_robots = self.robots.list
        self.create_session = self.sessions.create
        self.get_session = self.sessions.get
        self.list_sessions = self.sessions.list
        self.finish_session = self.sessions.finish
        self.correction = self.sessions.correction
        self.post_submap = self.submaps.post
        self.get_submap = self.submaps.get
        self.list_submaps = self.submaps.list
        self.download = self.submaps.download
        self.search = self.submaps.search
        self.localize = self.submaps.localize

    def _name_map_calls(self) -> None:
        """As `_name_catalogue_calls`: loop closures, versions and files of maps."""
        self.loop_closures = self.loops.list
        self.get_loop_closure = self.loops.get
        self.create_loop_closure = self.loops.create
        self.accept_loop_closure = self.loops.accept
        self.reject_loop_closure = self.loops.reject
        self.revert_loop_closure = self.loops.revert
        self.loop_closure_events = self.loops.events
        self.loop_keypoints = self.loops.keypoints
        self.map_versions = self.versions.list
        self.get_map_version = self.versions.get
        self.submap_poses = self.versions.poses
        self.map_tiles = self.versions.tiles
        self.map_changes = self.versions.changes
        self.download_tile = self.versions.download_tile
        self.map_distances = self.versions.distances
        self.map_points = self.versions.points
        self.publish_map = self.files.publish
        self.map_files = self.files.list
        self.get_map_file = self.files.get
        self.enable_map_file = self.files.enable
        self.download_map_file = self.files.download

    def _name_other_calls(self) -> None:
        """As `_name_catalogue_calls`: operations and webhooks."""
        self.get_operation = self.operations.get
        self.list_operations = self.operations.list
        self.retry_operation = self.operations.retry
        self.cancel_operation = self.operations.cancel
        self.wait = self.operations.wait
        self.create_webhook = self.webhooks.create
        self.get_webhook = self.webhooks.get
        self.list_webhooks = self.webhooks.list
        self.resume_webhook = self.webhooks.resume
        self.webhook_deliveries = self.webhooks.deliveries

    def delete(self, resource: str | Map | Session | Submap | Webhook | MapFile) -> None:
        """Delete a map, a session or a submap, with everything in it; or a webhook, or a file of a map."""
        name = name_of(resource, names.ANY)
        collection = name.split("/")[-2]
        if collection not in DELETIONS:
            raise InvalidArgument(
                ErrorDetails("INVALID_ARGUMENT", "BAD_FIELD", f"{name} cannot be deleted", field="name")
            )
        call = CALLS[DELETIONS[collection]]
        self._transport.call(call.name, request_of(call.request, {"name": name}))

    @contextmanager
    def spooled_stream(
        self,
        session: str | Session,
        spool: Path | str,
        *,
        max_bytes: int = DEFAULT_MAX_BYTES,
        full_wait_s: float = 0.0,
        prepare: Callable[[], None] | None = None,
        on_delay: OnDelay | None = None,
        send: Send = "described",
    ) -> Iterator[SpooledStream]:
        """A stream by way of the file `spool` on this machine's disk; needs no connection to be opened.

        `send` returns once the scan is on that disk; a full spool refuses it after `full_wait_s` with
        `SpoolFull`. On leaving, unacknowledged scans stay in the file, for the next stream on it.

        `prepare` is called in the sending thread before the first connection, again after a retryable error: a robot
        that starts without a link creates its session there. `on_delay` and `send`: see `stream`. Until the service
        was met, a scan is sent for each 0.3 m and each 10 degrees.
        """
        name = name_of(session, names.SESSION)
        opened = Spool(Path(spool), name, max_bytes)
        opened.on_delay = on_delay
        stream = SpooledStream(self._transport, name, opened, full_wait_s, RECONNECT, prepare, send)
        try:
            yield stream
        finally:
            stream.close()

    @contextmanager
    def stream(
        self, session: str | Session, *, send: Send = "described", on_delay: OnDelay | None = None
    ) -> Iterator[ScanStream]:
        """A stream of scans; on leaving, every scan was answered. Resumes by itself after a disconnect.

        It keeps unacknowledged scans in memory; `spooled_stream` keeps them on disk. Over gRPC it waits where the
        service takes no scan now (a full quota, busy workers): `on_delay` is then called with reason and message.

        Give it every scan of the robot. `send="described"` sends those that descriptions are made of, one each one or
        two metres; "all" sends all, as REST always does.
        """
        sink = self._transport.open_stream(name_of(session, names.SESSION), Forgetful(on_delay))
        stream = ScanStream(sink, send)
        try:
            yield stream
            stream.flush()
        finally:
            stream.close()

    @contextmanager
    def relocalise(
        self,
        map_: str | Map,
        *,
        storey: str | None = None,
        only_session: str | Session | None = None,
        exclude_session: str | Session | None = None,
    ) -> Iterator[Conversation]:
        """Where in a map is this robot, which moves? A conversation, over gRPC: each scan is answered at once.

        `with client.relocalise("yard") as conversation: answer = conversation.see(points, T_odom_sensor)`. The answer's
        `state` is PLACED with one pose, SEVERAL with poses that may be true, or UNKNOWN with a reason. `storey`: where
        the robot is; `exclude_session` (a session, its name or id): that which the robot itself streams.
        """
        opening = request_of(
            loop_closure_pb2.RelocaliseOpen,
            {
                "parent": name_of(map_, names.MAP),
                "storey": storey,
                "only_session": None if only_session is None else name_in_map(map_, only_session),
                "exclude_session": None if exclude_session is None else name_in_map(map_, exclude_session),
            },
        )
        conversation = Conversation(lambda: self._transport.open_conversation(opening), self._retry)
        try:
            yield conversation
        finally:
            conversation.close()

    def holds_scan(
        self, session: str | Session, seq: int, points: PointsLike, T_odom_sensor: Any, stamp_ns: int
    ) -> bool:
        """Whether a session has this very scan stored as its number `seq` (cloud, pose and time); stores nothing.

        Over gRPC it ends a stream of the session that is open, and raises FailedPrecondition of a finished session.
        """
        pose = pose_message(T_odom_sensor, "T_odom_sensor", required=True) or {}
        return self._transport.holds_scan(name_of(session, names.SESSION), seq, encoded(points), pose, stamp_ns)

    def watch(self, map_: str | Map, *, after: int | None = None, kinds: Sequence[str] = ()) -> Watch:
        """The events of a map as they happen, in a loop: `for event in client.watch("maps/yard"): ...`.

        `after` is the number of the last event that was seen, 0 for all that are kept; without it, from now on.
        `kinds` keeps LOOP_CLOSURE, OPERATION, MAP_VERSION, RETENTION, ANCHOR or MAP_CHANGED. It bridges lost
        connections; leave the loop to end it.
        """
        fields = {"parent": name_of(map_, names.MAP), "after": after, "kinds": list(kinds)}
        return Watch(self._transport, request_of(event_pb2.WatchEventsRequest, fields))

    def explain(self, submap: str | Submap, *, k: int = 20) -> list[NearMiss]:
        """Why a described submap has no loop with others of the `k` most like it: the gate that stopped each."""
        return explain(self, self.get_submap(name_of(submap, names.SUBMAP)), k)

    def watch_corrections(
        self, map_: str | Map, *, session: str | Session | None = None, after: int = 0
    ) -> CorrectionWatch:
        """The corrections by versions above `after`, also those to come: iterate over it, or give it a callback.

        `session` (a session, its name or id) keeps those of one.
        """
        of_session = "" if session is None else name_in_map(map_, session)
        fields = {"parent": name_of(map_, names.MAP), "session": of_session, "after": after}
        return CorrectionWatch(self._transport, request_of(mapping_pb2.WatchCorrectionsRequest, fields))

    def status(self) -> Status:
        """The state of the service."""
        return Status.of(self._transport.call("GetStatus", system_pb2.GetStatusRequest()))

    def call(self, name: str, **fields: Any) -> Any:
        """Make any call of the service by the name of its RPC and the fields of its request; the message of the answer.

        The groups have a method for each; this is for a call that is newer than they.
        """
        return self._transport.call(name, request_of(CALLS[name].request, fields))

    def close(self) -> None:
        """Let go of the connections."""
        self._transport.close()

    def __enter__(self) -> Self:
        """The client itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the connections."""
        self.close()


class ScanStream:
    """The open stream of a session."""

    def __init__(self, sink: ScanSink, send: Send = "described") -> None:
        self._sink = sink
        self._choice = ScanChoice(send, sink.way)
        self._watch = InputWatch()

    @property
    def committed_seq(self) -> int:
        """The last scan that is stored durably: an ingest that starts again goes on behind it."""
        return self._sink.committed_seq

    @property
    def submaps(self) -> list[str]:
        """Names of the submaps that the scans completed so far."""
        return self._sink.submaps

    @property
    def submap_seq(self) -> int:
        """The `seq` of the last submap that the scans completed, 0 for none: a query's `min_seq`."""
        return self._sink.submap_seq

    @property
    def skipped(self) -> int:
        """Scans of this stream that were not sent, as no description would be made of them."""
        return self._choice.left_out

    @property
    def left_out(self) -> int:
        """Scans that were sent and that the service does not keep, by the map's policy of retention."""
        return self._sink.left_out

    @property
    def rejected(self) -> list[tuple[int, str]]:
        """The refusals in short: number and reason."""
        return [(refusal.seq, refusal.reason) for refusal in self.refusals]

    @property
    def refusals(self) -> list[Refusal]:
        """Scans that the service refused for good and that were left out, oldest first."""
        return self._sink.refusals

    def send(self, points: PointsLike, T_odom_sensor: Any, stamp_ns: int) -> None:
        """Send the next scan, if it is one of those to send; waits while the service has enough to do.

        Warns of `SuspiciousInput`.
        """
        self._watch.look(points, T_odom_sensor, stamp_ns)
        pose = pose_message(T_odom_sensor, "T_odom_sensor", required=True) or {}
        scan = self._choice.look(pose, points, self._sink.marks)
        if scan.chosen is not None:
            self._sink.send(encoded(points), pose, stamp_ns, scan.way.travelled_m)
            self._choice.sent(scan.chosen)
        elif self._choice.passed_over():
            self._sink.live(pose, stamp_ns)

    def flush(self) -> None:
        """Wait until every scan was answered."""
        self._sink.flush()

    def close(self) -> None:
        """Let go of the stream."""
        self._sink.close()
