"""The operations of a transport, in resource names and messages of `proto/revisit/v1`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from revisit.core.scan_marks import ScanMarks, Way
from revisit.sdk.clouds import Cloud
from revisit.sdk.reading import Json
from revisit.v1 import event_pb2, loop_closure_pb2, mapping_pb2

MAX_FILE_BYTES = 2**30
"""Of a file that is downloaded into memory; those of maps go to the disk."""

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
    marks: ScanMarks | None
    """The scans that descriptions are made of; None where the service has not said so."""
    way: Way | None
    """Where the session stood when it was met first; None where that is not known."""
    left_out: int
    """Scans that the service has acknowledged and does not keep."""

    @property
    def committed_seq(self) -> int:
        """The last scan that is stored durably."""
        ...

    def send(self, cloud: Cloud, pose: Json, stamp_ns: int, travelled_m: float | None = None) -> None:
        """Take the next scan; may wait for the service. Raises ApiError."""
        ...

    def live(self, pose: Json, stamp_ns: int) -> None:
        """Tell that the robot is there, if there is a connection."""
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
    """The journal of a stream: it gets every answer before the stream goes on. Calls come from one thread."""

    def resume_point(self) -> tuple[str, int]:
        """The token of the session as it was met, empty before, and the last scan known to be stored."""
        ...

    def opened(self, committed_seq: int, resume_token: str, marks: ScanMarks | None = None) -> None:
        """The service has every scan up to `committed_seq`, and says by which `marks` it describes."""
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
    """`StreamJournal` of a stream with its scans in memory alone; `on_delay` gets delays."""

    def __init__(self, on_delay: OnDelay | None = None) -> None:
        self._on_delay = on_delay

    def resume_point(self) -> tuple[str, int]:
        """See StreamJournal."""
        return "", 0

    def opened(self, committed_seq: int, resume_token: str, marks: ScanMarks | None = None) -> None:
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


class ConversationCall(Protocol):
    """An open conversation with the service."""

    def ask(self, scan: loop_closure_pb2.RelocaliseScan) -> loop_closure_pb2.RelocaliseResponse:
        """The answer to a scan. Raises ApiError where the conversation has ended."""
        ...

    def close(self) -> None:
        """Let go of the connection."""
        ...


class Transport(Protocol):
    """REST or gRPC. Every call raises ApiError."""

    def call(self, name: str, request: Any) -> Any:
        """Make the call of an RPC with its request; the message of the answer's body, None where nothing is left."""
        ...

    def download(self, name: str, request: Any) -> bytes:
        """The whole file that a download answers with."""
        ...

    def map_file_bytes(self, name: str, offset: int) -> Iterator[bytes]:
        """The bytes of a map file from `offset` on, over one connection."""
        ...

    def watch(self, request: event_pb2.WatchEventsRequest) -> Iterator[event_pb2.Event | None]:
        """The events of a map over one connection, None for a sign of life; ends where the service ends it."""
        ...

    def corrections(self, request: mapping_pb2.WatchCorrectionsRequest) -> CorrectionFeed:
        """The corrections of a map as they come."""
        ...

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> ScanSink:
        """Open a session's stream of scans."""
        ...

    def open_conversation(self, opening: loop_closure_pb2.RelocaliseOpen) -> ConversationCall:
        """Begin a conversation about where in a map a robot is. Raises ApiError, also where the transport has none."""
        ...

    def holds_scan(self, session: str, seq: int, cloud: Cloud, pose: Json, stamp_ns: int) -> bool:
        """Whether the session has this very scan under the number `seq`; nothing is stored."""
        ...

    def close(self) -> None:
        """Let go of the connections."""
        ...


def listed(transport: Transport, name: str, request: Any) -> Iterator[Any]:
    """The messages of the resources that a List...Request asks for, page after page. Raises ApiError."""
    while True:
        page = transport.call(name, request)
        (field,) = (field for field in page.DESCRIPTOR.fields if field.is_repeated)
        yield from getattr(page, field.name)
        if not page.next_page_token:
            return
        request.page_token = page.next_page_token
