"""The client: methods named as the resources, over REST or gRPC alike."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from google.protobuf.json_format import ParseDict

from revisit.core.errors import RevisitError
from revisit.sdk import names
from revisit.sdk.clouds import PointsLike, encoded
from revisit.sdk.corrections import CorrectionWatch
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ErrorDetails, InvalidArgument, OperationFailed
from revisit.sdk.explanations import NearMiss, explain
from revisit.sdk.input_watch import InputWatch, warn_of_session
from revisit.sdk.map_downloads import fetch_file
from revisit.sdk.messages import cloud_message, request_of, vector
from revisit.sdk.names import name_in_map, name_of
from revisit.sdk.resources import (
    Correction,
    Json,
    Localization,
    LoopClosure,
    LoopClosureEvent,
    LoopKeypoints,
    LoopPolicy,
    Map,
    MapDistances,
    MapFile,
    MapMerge,
    MapPoints,
    MapTile,
    MapVersion,
    Operation,
    Robot,
    SearchHit,
    Session,
    Status,
    Submap,
    SubmapPose,
    Webhook,
    WebhookDelivery,
    pose_json,
)
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.spool import DEFAULT_MAX_BYTES, Spool
from revisit.sdk.spooled_stream import RECONNECT, SpooledStream
from revisit.sdk.transport import Forgetful, OnDelay, Refusal, ScanSink, Transport
from revisit.sdk.watching import Watch
from revisit.v1 import (
    event_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_pb2,
    map_tile_pb2,
    mapping_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    webhook_pb2,
)

DEFAULT_HTTP = "http://127.0.0.1:8080"
DEFAULT_GRPC = "127.0.0.1:8090"
MAX_WAIT_S = 60.0
MAX_PAGE = 500


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
        """Over REST at the URL `http`, by default $REVISIT_URL or port 8080 here; unless another transport is given.

        `api_key`, by default $REVISIT_API_KEY; `ca`, by default $REVISIT_CA: a PEM file of the authorities to trust.
        """
        if transport is None:
            from revisit.sdk.rest_transport import RestTransport

            credentials = Credentials.given(api_key, ca)
            transport = RestTransport(http or os.environ.get("REVISIT_URL", DEFAULT_HTTP), retry, credentials)
        self._transport: Transport = transport
        self._retry = retry

    @classmethod
    def grpc(
        cls,
        address: str | None = None,
        *,
        api_key: str | None = None,
        ca: str | Path | None = None,
        retry: RetryPolicy = RetryPolicy(),
    ) -> Self:
        """A client over gRPC at host:port, by default $REVISIT_GRPC or port 8090 here; `grpcs://host:port` for TLS.

        Credentials as for REST; a client certificate from $REVISIT_CERTIFICATE and $REVISIT_CERTIFICATE_KEY.
        """
        from revisit.sdk.grpc_transport import GrpcTransport

        address = address or os.environ.get("REVISIT_GRPC", DEFAULT_GRPC)
        return cls(transport=GrpcTransport(address, retry, Credentials.given(api_key, ca)), retry=retry)

    def create_map(
        self,
        map_id: str,
        *,
        display_name: str = "",
        tau_m: float | None = None,
        stride_m: float | None = None,
        leave_distance_m: float | None = None,
        scene_scale: float | None = None,
        loop_policy: LoopPolicy = LoopPolicy(),
    ) -> Map:
        """Create a map; what is None is as the service is configured.

        `scene_scale` is the size of the scene compared with a street, e.g. 0.25 for rooms; it cannot be changed later.
        """
        fields = {
            "map_id": map_id,
            "display_name": display_name,
            "tau_m": tau_m,
            "stride_m": stride_m,
            "leave_distance_m": leave_distance_m,
            "scene_scale": scene_scale,
            "loop_policy": {name: value for name, value in asdict(loop_policy).items() if value is not None} or None,
        }
        return Map.of(self._transport.create("maps", request_of(map_pb2.CreateMapRequest, fields)))

    def get_map(self, name: str) -> Map:
        """Get `maps/{map}`."""
        return Map.of(self._transport.get(name_of(name, names.MAP)))

    def list_maps(self) -> list[Map]:
        """All maps, oldest first."""
        return [Map.of(item) for item in self._transport.list("maps", map_pb2.ListMapsRequest())]

    def delete(self, resource: str | Map | Session | Submap | Webhook | MapFile) -> None:
        """Delete a map, a session or a submap, with everything in it; or a webhook, or a file of a map."""
        self._transport.delete(name_of(resource, names.ANY))

    def create_robot(self, robot_id: str, *, display_name: str = "") -> Robot:
        """Create a robot."""
        fields = {"robot_id": robot_id, "display_name": display_name}
        return Robot.of(self._transport.create("robots", request_of(robot_pb2.CreateRobotRequest, fields)))

    def get_robot(self, name: str) -> Robot:
        """Get `robots/{robot}`."""
        return Robot.of(self._transport.get(name_of(name, names.ROBOT)))

    def list_robots(self) -> list[Robot]:
        """All robots, oldest first."""
        return [Robot.of(item) for item in self._transport.list("robots", robot_pb2.ListRobotsRequest())]

    def create_session(
        self, map_: str | Map, session_id: str, *, robot: str | Robot | None = None, storey: str | None = None
    ) -> Session:
        """Create a session in a map.

        `storey` is the storey of a building that all of it is driven on, as B2: it is never compared with sessions on
        storeys of another name. Without it, it is compared with all.
        """
        of_robot = None if robot is None else name_of(robot, names.ROBOT)
        fields = {"parent": name_of(map_, names.MAP), "session_id": session_id, "robot": of_robot, "storey": storey}
        return Session.of(self._transport.create("sessions", request_of(session_pb2.CreateSessionRequest, fields)))

    def get_session(self, name: str) -> Session:
        """Get `maps/{map}/sessions/{session}`."""
        return Session.of(self._transport.get(name_of(name, names.SESSION)))

    def list_sessions(self, map_: str | Map) -> list[Session]:
        """The sessions of a map, oldest first."""
        request = session_pb2.ListSessionsRequest(parent=name_of(map_, names.MAP))
        return [Session.of(item) for item in self._transport.list("sessions", request)]

    def finish_session(self, session: str | Session) -> Session:
        """Finish a session; the scans of its last, shorter window become a submap.

        Warns of what the service has found in it so far (`SuspiciousInput`, `Session.findings`).
        """
        finished = Session.of(self._transport.finish_session(name_of(session, names.SESSION)))
        warn_of_session(finished.findings)
        return finished

    def post_submap(
        self, session: str | Session, submap_id: str, points: PointsLike, T_odom_submap: Any, stamp_ns: int
    ) -> Operation:
        """Store a submap, (n, 3) or (n, 4) points in its own frame; the operation that describes it."""
        fields = {
            "parent": name_of(session, names.SESSION),
            "submap_id": submap_id,
            "t_odom_submap": _pose(T_odom_submap, "T_odom_submap"),
            "stamp_ns": stamp_ns,
        }
        request = request_of(submap_pb2.PostSubmapRequest, fields)
        request.cloud.CopyFrom(cloud_message(encoded(points)))
        answer = self._transport.post_submap(request)
        return replace(Operation.of(answer.operation), seq=answer.submap.seq)

    def get_submap(self, name: str, *, full: bool = False) -> Submap:
        """Get `maps/{map}/sessions/{session}/submaps/{submap}`; with its descriptor where `full`."""
        return Submap.of(self._transport.get(name_of(name, names.SUBMAP), full=full))

    def list_submaps(self, session: str | Session) -> list[Submap]:
        """The submaps of a session in their order."""
        request = submap_pb2.ListSubmapsRequest(parent=name_of(session, names.SESSION))
        return [Submap.of(item) for item in self._transport.list("submaps", request)]

    def download(self, submap: str | Submap, file_format: str = "ply") -> bytes:
        """A submap as a file: pcd, ply, npy, mesh, neural or descriptor."""
        return self._transport.download(name_of(submap, names.SUBMAP), file_format)

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
    ) -> Iterator[SpooledStream]:
        """A stream by way of the file `spool` on this machine's disk; needs no connection to be opened.

        `send` returns once the scan is on that disk; a full spool refuses it after `full_wait_s` with
        `SpoolFull`. On leaving, what was not acknowledged stays in the file, for the next stream on it.

        `prepare` is called in the sending thread before the first connection, again after a retryable error: a robot
        that starts without a link creates its session there. `on_delay`: see `stream`.
        """
        name = name_of(session, names.SESSION)
        opened = Spool(Path(spool), name, max_bytes)
        opened.on_delay = on_delay
        stream = SpooledStream(self._transport, name, opened, full_wait_s, RECONNECT, prepare)
        try:
            yield stream
        finally:
            stream.close()

    @contextmanager
    def stream(self, session: str | Session, *, on_delay: OnDelay | None = None) -> Iterator[ScanStream]:
        """A stream of scans; on leaving, every scan was answered. Resumes by itself after a disconnect.

        It keeps what is not acknowledged in memory; `spooled_stream` keeps it on disk. Over gRPC it waits where the
        service takes no scan now (a full quota, busy workers): `on_delay` is then called with reason and message.
        """
        stream = ScanStream(self._transport.open_stream(name_of(session, names.SESSION), Forgetful(on_delay)))
        try:
            yield stream
            stream.flush()
        finally:
            stream.close()

    def holds_scan(
        self, session: str | Session, seq: int, points: PointsLike, T_odom_sensor: Any, stamp_ns: int
    ) -> bool:
        """Whether a session has this very scan stored as its number `seq` (cloud, pose and time); stores nothing.

        Over gRPC it ends a stream of the session that is open, and raises FailedPrecondition of a finished session.
        """
        pose = _pose(T_odom_sensor, "T_odom_sensor")
        return self._transport.holds_scan(name_of(session, names.SESSION), seq, encoded(points), pose, stamp_ns)

    def search(
        self,
        map_: str | Map,
        *,
        submap: str | Submap | None = None,
        points: PointsLike | None = None,
        descriptor: Sequence[float] | None = None,
        model_version: str = "",
        T_level_query: Any = None,
        k: int = 20,
        **criteria: Any,
    ) -> list[SearchHit]:
        """The submaps most like a submap, a cloud or a descriptor (give one), most similar first.

        `T_level_query` (4, 4): the pose of `points` in a frame whose z points up; its rotation turns them upright.

        `criteria`: min_similarity, exclude_session, only_session (a session, its name or id), leave_distance_m,
        prior_position_m with radius_m (in the frame of only_session), storey (where a cloud or descriptor was taken:
        sessions on another one are left out). `min_seq` (of an operation, a submap or a
        stream): the answer sees every submap up to it, or `DeadlineExceeded` is raised after `min_seq_timeout_s` (10 by
        default).
        """
        for field in ("exclude_session", "only_session"):
            if criteria.get(field) is not None:
                criteria[field] = name_in_map(map_, criteria[field])
        if criteria.get("prior_position_m") is not None:
            criteria["prior_position_m"] = vector(criteria["prior_position_m"])
        request = request_of(
            loop_closure_pb2.SearchSubmapsRequest, {"parent": name_of(map_, names.MAP), "k": k, **criteria}
        )
        if submap is not None:
            request.submap = name_of(submap, names.SUBMAP)
        elif points is not None:
            request.cloud.CopyFrom(cloud_message(encoded(points)))
            _turn_upright(request, T_level_query)
        else:
            of_descriptor = {"vector": [float(v) for v in descriptor or ()], "model_version": model_version}
            request.place_descriptor.CopyFrom(request_of(loop_closure_pb2.Descriptor, of_descriptor))
        return [SearchHit.of(hit) for hit in self._transport.search(request).hits]

    def localize(
        self,
        map_: str | Map,
        points: PointsLike,
        *,
        prior_position_m: Sequence[float] | None = None,
        radius_m: float | None = None,
        candidates: int = 10,
        exclude_session: str | Session | None = None,
        only_session: str | Session | None = None,
        T_level_query: Any = None,
        storey: str | None = None,
        **freshness: Any,
    ) -> Localization:
        """Where in the map a cloud was taken; `best` is None where the place is unknown.

        `T_level_query` (4, 4) is the cloud's pose in a frame whose z points up (from odometry or an IMU); its rotation
        turns the cloud upright. Without it the cloud's own surfaces tell the vertical, within 40 degrees of its z, or z
        does. `exclude_session` (a session, its name or id): a robot that asks with a place it has just posted finds its
        own submap else. `prior_position_m` is in the odometry frame of `only_session`, the only one that is searched.
        Sessions that are known to be on another `storey` are not compared. `freshness`: min_seq with min_seq_timeout_s,
        as in `search`.
        """
        fields = {
            "parent": name_of(map_, names.MAP),
            "storey": storey,
            "prior_position_m": None if prior_position_m is None else vector(prior_position_m),
            "radius_m": radius_m,
            "candidates": candidates,
            "exclude_session": None if exclude_session is None else name_in_map(map_, exclude_session),
            "only_session": None if only_session is None else name_in_map(map_, only_session),
        }
        request = request_of(loop_closure_pb2.LocalizeRequest, {**fields, **freshness})
        request.cloud.CopyFrom(cloud_message(encoded(points)))
        _turn_upright(request, T_level_query)
        return Localization.of(self._transport.localize(request))

    def loop_closures(
        self,
        map_: str | Map,
        *,
        state: str | None = None,
        graph_state: str | None = None,
        session: str | Session | None = None,
        reason: str | None = None,
        **freshness: Any,
    ) -> list[LoopClosure]:
        """The loop closures of a map to rely on, oldest first: accepted, and not set aside by the map.

        Any of three filters asks for others in their place: `state` ACCEPTED, REJECTED, PROPOSED or ALL, `graph_state`
        IN_MAP, SET_ASIDE or UNCONNECTED (the map's verdict on an accepted loop), and the `reason` of a rejection, e.g.
        AMBIGUOUS. `session` (a session, its name or id) keeps the loops of its query submaps; NotFound where there is
        none. `freshness`: min_seq with min_seq_timeout_s, as in `search`.
        """
        asked = {"state": None if state == "ALL" else state, "graph_state": graph_state, "reason": reason}
        reliable = state is None and not any(asked.values())
        if reliable:
            asked["state"] = "ACCEPTED"
        of_session = None if session is None else name_in_map(map_, session)
        fields = {"parent": name_of(map_, names.MAP), "session": of_session, **asked, **freshness}
        request = request_of(loop_closure_pb2.ListLoopClosuresRequest, fields)
        found = (LoopClosure.of(item) for item in self._transport.list("loopClosures", request))
        return [loop for loop in found if not (reliable and loop.graph_state == "SET_ASIDE")]

    def get_loop_closure(self, name: str) -> LoopClosure:
        """Get `maps/{map}/loopClosures/{loop_closure}` with its evidence."""
        return LoopClosure.of(self._transport.get(name_of(name, names.LOOP_CLOSURE)))

    def create_webhook(
        self, webhook_id: str, url: str, *, map_: str | Map | None = None, kinds: Sequence[str] = ()
    ) -> Webhook:
        """Send the events from now on to a URL (https), those of one map where given; `kinds` as in `watch`.

        The answer holds the `secret` that signs them, this once: `revisit.sdk.webhooks.verified` checks with it.
        """
        of_map = "" if map_ is None else name_of(map_, names.MAP)
        fields = {"webhook_id": webhook_id, "url": url, "map": of_map, "kinds": list(kinds)}
        created = self._transport.create_webhook(request_of(webhook_pb2.CreateWebhookRequest, fields))
        return Webhook.of(created.webhook, created.secret)

    def get_webhook(self, name: str) -> Webhook:
        """Get `webhooks/{webhook}`."""
        return Webhook.of(self._transport.get(name_of(name, names.WEBHOOK)))

    def list_webhooks(self) -> list[Webhook]:
        """All webhooks, oldest first."""
        return [Webhook.of(item) for item in self._transport.list("webhooks", webhook_pb2.ListWebhooksRequest())]

    def resume_webhook(self, webhook: str | Webhook) -> Webhook:
        """Try again at once, also where it was suspended."""
        return Webhook.of(self._transport.resume_webhook(name_of(webhook, names.WEBHOOK)))

    def webhook_deliveries(self, webhook: str | Webhook) -> list[WebhookDelivery]:
        """The last attempts to deliver, oldest first."""
        return [
            WebhookDelivery.of(item) for item in self._transport.webhook_deliveries(name_of(webhook, names.WEBHOOK))
        ]

    def create_loop_closure(
        self, query: str | Submap, match: str | Submap, *, T_match_query: Any = None, note: str = ""
    ) -> Operation:
        """Store a loop closure that a person has found: the operation that verifies it, whose subject is the loop.

        `T_match_query` (4, 4) is roughly how the two lie to each other: where registration starts.
        """
        fields = {
            "parent": "/".join(name_of(query, names.SUBMAP).split("/")[:2]),
            "query": name_of(query, names.SUBMAP),
            "match": name_of(match, names.SUBMAP),
            "t_match_query": None if T_match_query is None else _pose(T_match_query, "T_match_query"),
            "note": note,
        }
        request = request_of(loop_closure_pb2.CreateLoopClosureRequest, fields)
        return Operation.of(self._transport.propose_loop(request).operation)

    def accept_loop_closure(self, loop: str | LoopClosure, *, note: str = "") -> LoopClosure:
        """Accept a loop closure whatever its verdict was; `note` says why."""
        return LoopClosure.of(self._transport.decide_loop("accept", name_of(loop, names.LOOP_CLOSURE), note))

    def reject_loop_closure(self, loop: str | LoopClosure, *, note: str = "") -> LoopClosure:
        """Reject a loop closure, so that the map does not rest on it; `note` says why."""
        return LoopClosure.of(self._transport.decide_loop("reject", name_of(loop, names.LOOP_CLOSURE), note))

    def revert_loop_closure(self, loop: str | LoopClosure, *, note: str = "") -> LoopClosure:
        """Take back the last decision of a person on a loop closure."""
        return LoopClosure.of(self._transport.decide_loop("revert", name_of(loop, names.LOOP_CLOSURE), note))

    def loop_closure_events(self, loop: str | LoopClosure) -> list[LoopClosureEvent]:
        """What happened to a loop closure, oldest first."""
        request = loop_closure_pb2.ListLoopClosureEventsRequest(parent=name_of(loop, names.LOOP_CLOSURE))
        return [LoopClosureEvent.of(item) for item in self._transport.list("events", request)]

    def loop_keypoints(self, loop: str | LoopClosure) -> LoopKeypoints:
        """What was compared: the keypoints of both submaps, which look alike, and which of these the pose joins."""
        return LoopKeypoints.of(self._transport.loop_keypoints(name_of(loop, names.LOOP_CLOSURE)))

    def watch(self, map_: str | Map, *, after: int | None = None, kinds: Sequence[str] = ()) -> Watch:
        """The events of a map as they happen, in a loop: `for event in client.watch("maps/yard"): ...`.

        `after` is the number of the last event that was seen, 0 for all that are kept; without it, from now on.
        `kinds` keeps LOOP_CLOSURE, OPERATION or MAP_VERSION. It bridges lost connections; leave the loop to end it.
        """
        fields = {"parent": name_of(map_, names.MAP), "after": after, "kinds": list(kinds)}
        return Watch(self._transport, request_of(event_pb2.WatchEventsRequest, fields))

    def explain(self, submap: str | Submap, *, k: int = 20) -> list[NearMiss]:
        """Why a described submap has no loop with others of the `k` most like it: the gate that stopped each."""
        return explain(self, self.get_submap(name_of(submap, names.SUBMAP)), k)

    def optimise_map(self, map_: str | Map) -> Operation:
        """Optimise the pose graph of a map: the operation whose end is a new version. One that waits is answered."""
        return Operation.of(self._transport.optimise_map(name_of(map_, names.MAP)))

    def map_versions(self, map_: str | Map) -> list[MapVersion]:
        """The versions of a map that are kept, oldest first."""
        request = mapping_pb2.ListMapVersionsRequest(parent=name_of(map_, names.MAP))
        return [MapVersion.of(item) for item in self._transport.list("versions", request)]

    def get_map_version(self, name: str) -> MapVersion:
        """Get `maps/{map}/versions/{version}`."""
        return MapVersion.of(self._transport.get(name_of(name, names.VERSION)))

    def submap_poses(self, version: str | MapVersion) -> list[SubmapPose]:
        """The poses of the submaps in a version of a map, by session and in the order of their drive."""
        request = mapping_pb2.ListSubmapPosesRequest(parent=name_of(version, names.VERSION), page_size=MAX_PAGE)
        return [SubmapPose.of(item) for item in self._transport.list("poses", request)]

    def map_tiles(self, version: str | Map | MapVersion) -> list[MapTile]:
        """The tiles that submaps of a version may reach into; of a map, those of the version in force."""
        request = map_tile_pb2.ListMapTilesRequest(parent=self._version(version), page_size=MAX_PAGE)
        return [MapTile.of(item) for item in self._transport.list("tiles", request)]

    def download_tile(self, tile: str | MapTile, file_format: str = "glb") -> bytes:
        """The surface of a tile in the map: `glb` or `mesh` (ply); points as pcd, ply or npy; `neural`.

        A worker makes it when it is asked for first. Raises DeadlineExceeded (NO_ANSWER) where that takes long.
        """
        return self._transport.download_tile(name_of(tile, names.TILE), file_format)

    def map_distances(self, version: str | Map | MapVersion, points_m: Any, *, frame: str = "") -> MapDistances:
        """Signed distances of up to 1000 points (n, 3) to the surface of a map, in one of its frames ("": the only)."""
        request = map_tile_pb2.MeasureMapDistancesRequest(parent=self._version(version), frame=frame)
        for x, y, z in np.asarray(points_m, dtype=np.float64).reshape(-1, 3).tolist():
            request.points_m.add(x=x, y=y, z=z)
        return MapDistances.of(self._transport.measure_distances(request))

    def map_points(
        self, version: str | Map | MapVersion, centre_m: Any, within_m: float, *, frame: str = "", limit: int = 1000
    ) -> MapPoints:
        """The points of the surface of a map within a radius of one point, the nearest first."""
        centre = vector(centre_m)
        fields = {"parent": self._version(version), "centre_m": centre, "within_m": within_m, "frame": frame}
        request = request_of(map_tile_pb2.FindMapPointsRequest, {**fields, "limit": limit})
        return MapPoints.of(self._transport.find_points(request))

    def publish_map(self, version: str | Map | MapVersion, description: str = "") -> Operation:
        """Make a file of a version: the operation, whose result names `map_file` and `map_hash`."""
        return Operation.of(self._transport.publish_map_file(self._version(version), description))

    def map_files(self, map_: str | Map) -> list[MapFile]:
        """The files of a map, oldest first."""
        request = map_file_pb2.ListMapFilesRequest(parent=name_of(map_, names.MAP))
        return [MapFile.of(item) for item in self._transport.list("files", request)]

    def get_map_file(self, name: str) -> MapFile:
        """Get `maps/{map}/files/{version}`."""
        return MapFile.of(self._transport.get(name_of(name, names.MAP_FILE)))

    def enable_map_file(self, file: str | MapFile) -> MapFile:
        """Say that robots are to use this file, and no other of its map."""
        return MapFile.of(self._transport.enable_map_file(name_of(file, names.MAP_FILE)))

    def download_map_file(self, file: str | MapFile, out: Path | str) -> MapFile:
        """Download a file; what a download before has left in OUT.part is not sent again.

        Raises DataLoss where the bytes do not have the hash that the service names: then OUT.part is deleted.
        """
        found = self.get_map_file(name_of(file, names.MAP_FILE))
        fetch_file(found, Path(out), self._transport.map_file_bytes, self._retry)
        return found

    def _version(self, version: str | Map | MapVersion) -> str:
        """The name of a version; of a map, that of the one in force."""
        name = name_of(version, names.MAP)
        if name.count("/") != 1:
            return name
        return f"{name}/versions/{self.get_map(name).map_version}"

    def revert_map(self, map_: str | Map, version: int) -> MapVersion:
        """Bring back the poses of an earlier version, bit for bit, as a new version."""
        return MapVersion.of(self._transport.revert_map(name_of(map_, names.MAP), version))

    def merge_map(
        self,
        map_: str | Map,
        source: str | Map | Session,
        *,
        validate_only: bool = False,
        T_map_source: Any = None,
        radius_m: float | None = None,
    ) -> Operation:
        """Merge `source`, another map or a session of it, into a map: the operation whose end is a new version.

        Its result has `verdict` MERGED, REFUSED (with `refusal`) or, with `validate_only`, MERGEABLE, and alignment and
        evidence. `T_map_source` (4, 4) is roughly where the frame of the source lies in that of the map.
        """
        into, of = name_of(map_, names.MAP), name_of(source, names.MAP)
        fields = {"name": into, "source": of, "validate_only": validate_only, "radius_m": radius_m}
        near = {} if T_map_source is None else {"t_map_source": _pose(T_map_source, "T_map_source")}
        return Operation.of(self._transport.merge_map(request_of(mapping_pb2.MergeMapRequest, {**fields, **near})))

    def map_merges(self, map_: str | Map) -> list[MapMerge]:
        """The merges into a map, oldest first, with what changed between the days."""
        request = mapping_pb2.ListMapMergesRequest(parent=name_of(map_, names.MAP))
        return [MapMerge.of(item) for item in self._transport.list("merges", request)]

    def get_map_merge(self, name: str) -> MapMerge:
        """Get `maps/{map}/merges/{merge}`."""
        return MapMerge.of(self._transport.get(name_of(name, names.MERGE)))

    def revert_merge(self, merge: str | MapMerge) -> MapMerge:
        """Take the last merge into a map back: its copies are deleted, the poses from before it come back."""
        return MapMerge.of(self._transport.revert_merge(name_of(merge, names.MERGE)))

    def cancel_operation(self, operation: str | Operation) -> Operation:
        """End an operation that optimises or merges maps, at once or at its next step; it changes nothing then."""
        return Operation.of(self._transport.cancel_operation(name_of(operation, names.OPERATION)))

    def correction(self, session: str | Session) -> Correction:
        """Where the odometry frame of a session lies in the map.

        Raises FailedPrecondition (NOT_READY) where no version of the map has the session yet.
        """
        return Correction.of(self._transport.correction(name_of(session, names.SESSION)))

    def watch_corrections(
        self, map_: str | Map, *, session: str | Session | None = None, after: int = 0
    ) -> CorrectionWatch:
        """The corrections by versions above `after`, also those to come: iterate over it, or give it a callback.

        `session` (a session, its name or id) keeps those of one.
        """
        of_session = "" if session is None else name_in_map(map_, session)
        return CorrectionWatch(self._transport, name_of(map_, names.MAP), of_session, after)

    def get_operation(self, name: str) -> Operation:
        """Get `operations/{operation}`."""
        return Operation.of(self._transport.get(name_of(name, names.OPERATION)))

    def list_operations(self, *, state: str | None = None) -> list[Operation]:
        """The operations, oldest first; `state` QUEUED, RUNNING, DONE or FAILED."""
        request = request_of(operation_pb2.ListOperationsRequest, {"state": state})
        return [Operation.of(item) for item in self._transport.list("operations", request)]

    def retry_operation(self, operation: str | Operation) -> Operation:
        """Queue a failed description again; an operation that has not failed is left as it is."""
        return Operation.of(self._transport.retry_operation(name_of(operation, names.OPERATION)))

    def wait(self, operation: str | Operation, timeout_s: float = 300.0) -> Operation:
        """The operation once it is DONE. Raises OperationFailed; TimeoutError after `timeout_s`."""
        deadline = time.monotonic() + timeout_s
        while True:
            left_s = max(0.0, deadline - time.monotonic())
            current = Operation.of(
                self._transport.wait_operation(name_of(operation, names.OPERATION), min(left_s, MAX_WAIT_S))
            )
            if current.state == "FAILED":
                details = ErrorDetails("UNKNOWN", current.failure_reason or "", current.failure_message or "")
                raise OperationFailed(details)
            if current.done:
                return current
            if left_s == 0.0:
                raise TimeoutError(f"{current.name} is {current.state} after {timeout_s:g} s")

    def status(self) -> Status:
        """What the service is doing."""
        return Status.of(self._transport.status())

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

    def __init__(self, sink: ScanSink) -> None:
        self._sink = sink
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
    def rejected(self) -> list[tuple[int, str]]:
        """The refusals in short: number and reason."""
        return [(refusal.seq, refusal.reason) for refusal in self.refusals]

    @property
    def refusals(self) -> list[Refusal]:
        """Scans that the service refused for good and that were left out, oldest first."""
        return self._sink.refusals

    def send(self, points: PointsLike, T_odom_sensor: Any, stamp_ns: int) -> None:
        """Send the next scan; waits while the service has enough to do. Warns of `SuspiciousInput`."""
        self._watch.look(points, T_odom_sensor, stamp_ns)
        self._sink.send(encoded(points), _pose(T_odom_sensor, "T_odom_sensor"), stamp_ns)

    def flush(self) -> None:
        """Wait until every scan was answered."""
        self._sink.flush()

    def close(self) -> None:
        """Let go of the stream."""
        self._sink.close()


def _turn_upright(request: Any, T_level_query: Any) -> None:
    if T_level_query is not None:
        ParseDict(_pose(T_level_query, "T_level_query"), request.t_level_query)


def _pose(transform: Any, field: str) -> Json:
    try:
        return pose_json(transform)
    except RevisitError as error:
        details = ErrorDetails("INVALID_ARGUMENT", error.code.value, error.message, field=field)
        raise InvalidArgument(details) from error
