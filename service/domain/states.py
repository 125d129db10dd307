"""The states of each resource and the kinds of jobs, as they are stored, compared and shown to clients."""

from __future__ import annotations

from enum import StrEnum


class SessionState(StrEnum):
    """Whether a session still takes data."""

    ACTIVE = "ACTIVE"
    FINISHED = "FINISHED"


class SubmapState(StrEnum):
    """Whether a submap has its description; RETIRED: retention has taken it out of the index again."""

    QUEUED = "QUEUED"
    DESCRIBED = "DESCRIBED"
    FAILED = "FAILED"
    RETIRED = "RETIRED"


class LoopState(StrEnum):
    """The verdict on a loop closure, of geometry or of a person; PROPOSED has none yet.

    A person has made such a loop, or, with reason AWAITS_CHAIN, it waits for its drive to go on.
    """

    ACCEPTED = "ACCEPTED"
    REJECTED = "REJECTED"
    PROPOSED = "PROPOSED"


class AnchorKind(StrEnum):
    """The source of an anchor."""

    GNSS = "GNSS"
    CONTROL_POINT = "CONTROL_POINT"
    KNOWN_POSE = "KNOWN_POSE"
    FIDUCIAL = "FIDUCIAL"


class AnchorFrame(StrEnum):
    """The frame of an anchor's place: earth, metres from the origin of the map, or a tag, whose place nobody knows."""

    WGS84 = "WGS84"
    LOCAL = "LOCAL"
    TAG = "TAG"


class LoopEventKind(StrEnum):
    """The kind of a change of a loop closure."""

    VERIFIED = "VERIFIED"
    PROPOSED = "PROPOSED"
    ACCEPTED = "ACCEPTED"
    REJECTED = "REJECTED"
    REVERTED = "REVERTED"
    JUDGED = "JUDGED"


class BlobState(StrEnum):
    """How far the collection of a blob has come that rows named: COLLECTED may be deleted at any moment, GONE was."""

    UNREFERENCED = "UNREFERENCED"
    COLLECTED = "COLLECTED"
    GONE = "GONE"


class EventKind(StrEnum):
    """The kind of an event."""

    LOOP_CLOSURE = "LOOP_CLOSURE"
    OPERATION = "OPERATION"
    MAP_VERSION = "MAP_VERSION"
    RETENTION = "RETENTION"
    ANCHOR = "ANCHOR"
    MAP_CHANGED = "MAP_CHANGED"
    OPENED = "OPENED"
    FORGOTTEN = "FORGOTTEN"


class WebhookState(StrEnum):
    """Whether a webhook is sent to: SUSPENDED after too many failures in a row, until somebody resumes it."""

    ENABLED = "ENABLED"
    SUSPENDED = "SUSPENDED"


class OperationKind(StrEnum):
    """The kind of a job."""

    DESCRIBE_SUBMAP = "DESCRIBE_SUBMAP"
    SEARCH_CLOUD = "SEARCH_CLOUD"
    LOCALIZE = "LOCALIZE"
    RELOCALISE = "RELOCALISE"
    OPTIMISE_MAP = "OPTIMISE_MAP"
    VERIFY_LOOP = "VERIFY_LOOP"
    MERGE_MAP = "MERGE_MAP"
    MAKE_TILE = "MAKE_TILE"
    MEASURE_MAP = "MEASURE_MAP"
    PUBLISH_MAP = "PUBLISH_MAP"
    RECALL_LOOPS = "RECALL_LOOPS"
    MAKE_MESH = "MAKE_MESH"
    FIND_CHANGES = "FIND_CHANGES"
    PREVIEW_ANCHORS = "PREVIEW_ANCHORS"


class MapFileState(StrEnum):
    """Whether robots are to use a map file, in the words of VDA 5050's mapStatus."""

    ENABLED = "ENABLED"
    DISABLED = "DISABLED"


class MergeVerdict(StrEnum):
    """The outcome of a merge: done, refused, or possible (`validate_only`)."""

    MERGED = "MERGED"
    REFUSED = "REFUSED"
    MERGEABLE = "MERGEABLE"


class OperationState(StrEnum):
    """The state of a job, which clients see as an operation."""

    QUEUED = "QUEUED"
    RUNNING = "RUNNING"
    DONE = "DONE"
    FAILED = "FAILED"
