"""What a transport can do, in resource names and JSON shaped like `proto/revisit/v1`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

from revisit.sdk.clouds import Cloud
from revisit.sdk.resources import Json


class ScanSink(Protocol):
    """Takes the scans of a session in order and delivers them."""

    submaps: list[str]
    submap_seq: int
    rejected: list[tuple[int, str]]

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


class Forgetful:
    """`StreamJournal` of a stream whose scans live in memory alone."""

    def resume_point(self) -> tuple[str, int]:
        """See StreamJournal."""
        return "", 0

    def opened(self, committed_seq: int, resume_token: str) -> None:
        """See StreamJournal."""

    def committed(self, committed_seq: int) -> None:
        """See StreamJournal."""

    def refused(self, seq: int, reason: str, message: str) -> None:
        """See StreamJournal."""


class Transport(Protocol):
    """REST or gRPC. Every call raises ApiError."""

    def create(self, parent: str, collection: str, resource_id: str, fields: Json) -> Json:
        """Create a map, robot or session."""
        ...

    def get(self, name: str, *, full: bool = False) -> Json:
        """Any resource by name; `full` is for submaps alone."""
        ...

    def list(self, parent: str, collection: str, filters: Json) -> Iterator[Json]:
        """The resources of a collection, page after page."""
        ...

    def delete(self, name: str) -> None:
        """Delete a map, session or submap."""
        ...

    def finish_session(self, name: str) -> Json:
        """Finish a session."""
        ...

    def wait_operation(self, name: str, timeout_s: float) -> Json:
        """The operation once it has ended, or as it stands after `timeout_s` (at most 60)."""
        ...

    def retry_operation(self, name: str) -> Json:
        """Queue a failed operation again."""
        ...

    def post_submap(self, session: str, submap_id: str, pose: Json, stamp_ns: int, cloud: Cloud) -> Json:
        """Post a submap."""
        ...

    def download(self, submap: str, file_format: str) -> bytes:
        """A submap as a file."""
        ...

    def search(self, map_name: str, query: Any, criteria: Json) -> Json:
        """Search by submap name (str), by cloud (Cloud) or by descriptor (JSON of vector and model_version)."""
        ...

    def localize(self, map_name: str, cloud: Cloud, options: Json) -> Json:
        """Localise a cloud."""
        ...

    def status(self) -> Json:
        """What the service is doing."""
        ...

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> ScanSink:
        """Open a session's stream of scans."""
        ...

    def close(self) -> None:
        """Let go of the connections."""
        ...
