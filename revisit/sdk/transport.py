"""What a transport can do, in resource names and messages of `proto/revisit/v1`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from revisit.sdk.clouds import Cloud
from revisit.sdk.resources import Json
from revisit.v1 import (
    event_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_tile_pb2,
    mapping_pb2,
    operation_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
    webhook_pb2,
)

SILENT_S = 45.0
"""A watch of which nothing was heard for so long is dead: the service gives a sign of life every 15 s."""


@dataclass(frozen=True)
class Refusal:
    """A scan that the service refused for good: the number that its successor got instead, and why."""

    seq: int
    reason: str
    message: str


class ScanSink(Protocol):
    """Takes the scans of a session in order and delivers them."""

    submaps: list[str]
    submap_seq: int
    refusals: list[Refusal]

    @property
    def committed_seq(self) -> int:
        """The last scan that is stored durably."""
        ...

    def send(self, cloud: Cloud, pose: Json, stamp_ns: int) -> None:
        """Take the next scan; may wait for the service. Raises ApiError."""
        ...

    def check(self) -> None:
        """Raises ApiError where the stream has ended."""
        ...

    def flush(self) -> None:
        """Wait until every scan was answered. Raises ApiError."""
        ...

    def close(self) -> None:
        """Let go of the connection."""
        ...


OnDelay = Callable[[str, str], None]
"""Hears the reason and the message of each delay, in a thread of the stream."""


class StreamJournal(Protocol):
    """What a stream must not forget: told of every answer before the stream goes on. Calls come from one thread."""

    def resume_point(self) -> tuple[str, int]:
        """The token of the session as it was met, empty before, and the last scan known to be stored."""
        ...

    def opened(self, committed_seq: int, resume_token: str) -> None:
        """The service has every scan up to `committed_seq`."""
        ...

    def committed(self, committed_seq: int) -> None:
        """The service has every scan up to `committed_seq` by now."""
        ...

    def refused(self, seq: int, reason: str, message: str) -> None:
        """The first scan that is not committed will never be taken; the next one gets its number."""
        ...

    def delayed(self, reason: str, message: str) -> None:
        """The first scan that is not committed is not taken now; it is sent again after a pause."""
        ...


class Forgetful:
    """`StreamJournal` of a stream whose scans live in memory alone; `on_delay` hears of delays."""

    def __init__(self, on_delay: OnDelay | None = None) -> None:
        self._on_delay = on_delay

    def resume_point(self) -> tuple[str, int]:
        """See StreamJournal."""
        return "", 0

    def opened(self, committed_seq: int, resume_token: str) -> None:
        """See StreamJournal."""

    def committed(self, committed_seq: int) -> None:
        """See StreamJournal."""

    def refused(self, seq: int, reason: str, message: str) -> None:
        """See StreamJournal."""

    def delayed(self, reason: str, message: str) -> None:
        """See StreamJournal."""
        if self._on_delay is not None:
            self._on_delay(reason, message)


class CorrectionFeed(Protocol):
    """Corrections as they come."""

    def next(self, timeout_s: float) -> mapping_pb2.Correction | None:
        """The next one, None where none has come after `timeout_s`. Raises ApiError where the feed has ended."""
        ...

    def close(self) -> None:
        """Let go of the connection."""
        ...


class Transport(Protocol):
    """REST or gRPC. Every call raises ApiError."""

    def create(self, collection: str, request: Any) -> Any:
        """Create a map, robot or session with its Create...Request; the resource's message."""
        ...

    def get(self, name: str, *, full: bool = False) -> Any:
        """The message of any resource by name; `full` is for submaps alone."""
        ...

    def list(self, collection: str, request: Any) -> Iterator[Any]:
        """The messages of the resources that a List...Request asks for, page after page."""
        ...

    def delete(self, name: str) -> None:
        """Delete a map, session or submap."""
        ...

    def finish_session(self, name: str) -> session_pb2.Session:
        """Finish a session."""
        ...

    def wait_operation(self, name: str, timeout_s: float) -> operation_pb2.Operation:
        """The operation once it has ended, or as it stands after `timeout_s` (at most 60)."""
        ...

    def retry_operation(self, name: str) -> operation_pb2.Operation:
        """Queue a failed operation again."""
        ...

    def post_submap(self, request: submap_pb2.PostSubmapRequest) -> submap_pb2.PostSubmapResponse:
        """Post a submap."""
        ...

    def download(self, submap: str, file_format: str) -> bytes:
        """A submap as a file."""
        ...

    def download_tile(self, tile: str, file_format: str) -> bytes:
        """A tile of a map as a file."""
        ...

    def measure_distances(
        self, request: map_tile_pb2.MeasureMapDistancesRequest
    ) -> map_tile_pb2.MeasureMapDistancesResponse:
        """Signed distances of points to the surface of a map."""
        ...

    def find_points(self, request: map_tile_pb2.FindMapPointsRequest) -> map_tile_pb2.FindMapPointsResponse:
        """The points of the surface of a map around one."""
        ...

    def publish_map_file(self, version: str, description: str) -> operation_pb2.Operation:
        """Queue the making of a map file."""
        ...

    def enable_map_file(self, name: str) -> map_file_pb2.MapFile:
        """Say that robots are to use a map file."""
        ...

    def map_file_bytes(self, name: str, offset: int) -> Iterator[bytes]:
        """The bytes of a map file from `offset` on, over one connection."""
        ...

    def search(self, request: loop_closure_pb2.SearchSubmapsRequest) -> loop_closure_pb2.SearchSubmapsResponse:
        """Search by submap, by cloud or by descriptor."""
        ...

    def localize(self, request: loop_closure_pb2.LocalizeRequest) -> loop_closure_pb2.LocalizeResponse:
        """Localise a cloud."""
        ...

    def create_webhook(self, request: webhook_pb2.CreateWebhookRequest) -> webhook_pb2.CreateWebhookResponse:
        """Create a webhook; the answer holds its secret."""
        ...

    def resume_webhook(self, name: str) -> webhook_pb2.Webhook:
        """Try again at once."""
        ...

    def webhook_deliveries(self, name: str) -> Iterator[webhook_pb2.WebhookDelivery]:
        """The last attempts to deliver."""
        ...

    def propose_loop(
        self, request: loop_closure_pb2.CreateLoopClosureRequest
    ) -> loop_closure_pb2.CreateLoopClosureResponse:
        """Store a loop closure that a person has found."""
        ...

    def decide_loop(self, decision: str, name: str, note: str) -> loop_closure_pb2.LoopClosure:
        """`accept`, `reject` or `revert` a loop closure."""
        ...

    def loop_keypoints(self, name: str) -> loop_closure_pb2.GetLoopClosureKeypointsResponse:
        """The keypoints of a loop closure's two submaps."""
        ...

    def watch(self, request: event_pb2.WatchEventsRequest) -> Iterator[event_pb2.Event | None]:
        """The events of a map over one connection, None for a sign of life; ends where the service ends it."""
        ...

    def optimise_map(self, name: str) -> operation_pb2.Operation:
        """Queue the optimisation of a map."""
        ...

    def revert_map(self, name: str, version: int) -> mapping_pb2.MapVersion:
        """Bring an earlier version of a map back."""
        ...

    def merge_map(self, request: mapping_pb2.MergeMapRequest) -> operation_pb2.Operation:
        """Queue a merge into a map."""
        ...

    def revert_merge(self, name: str) -> mapping_pb2.MapMerge:
        """Take a merge back."""
        ...

    def cancel_operation(self, name: str) -> operation_pb2.Operation:
        """End an operation that optimises or merges maps."""
        ...

    def correction(self, session: str) -> mapping_pb2.Correction:
        """Where the odometry frame of a session lies in the map."""
        ...

    def corrections(self, map_name: str, session: str, after: int) -> CorrectionFeed:
        """The corrections by versions above `after`; `session` is "" for those of all sessions."""
        ...

    def status(self) -> system_pb2.GetStatusResponse:
        """What the service is doing."""
        ...

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> ScanSink:
        """Open a session's stream of scans."""
        ...

    def holds_scan(self, session: str, seq: int, cloud: Cloud, pose: Json, stamp_ns: int) -> bool:
        """Whether the session has this very scan under the number `seq`; nothing is stored."""
        ...

    def close(self) -> None:
        """Let go of the connections."""
        ...
