from revisit.v1 import anchor_pb2 as _anchor_pb2
from revisit.v1 import geometry_pb2 as _geometry_pb2
from revisit.v1 import operation_pb2 as _operation_pb2
from revisit.v1 import session_pb2 as _session_pb2
from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MapVersion(_message.Message):
    __slots__ = ("name", "version", "in_force", "restored_from", "content_hash", "operation", "created_at_ns", "summary")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    IN_FORCE_FIELD_NUMBER: _ClassVar[int]
    RESTORED_FROM_FIELD_NUMBER: _ClassVar[int]
    CONTENT_HASH_FIELD_NUMBER: _ClassVar[int]
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    name: str
    version: int
    in_force: bool
    restored_from: int
    content_hash: str
    operation: str
    created_at_ns: int
    summary: MapVersionSummary
    def __init__(self, name: _Optional[str] = ..., version: _Optional[int] = ..., in_force: _Optional[bool] = ..., restored_from: _Optional[int] = ..., content_hash: _Optional[str] = ..., operation: _Optional[str] = ..., created_at_ns: _Optional[int] = ..., summary: _Optional[_Union[MapVersionSummary, _Mapping]] = ...) -> None: ...

class MapVersionSummary(_message.Message):
    __slots__ = ("sessions", "submaps", "frames", "loops_in_map", "loops_set_aside", "loops_unconnected", "chi2", "degrees_of_freedom", "mean_change_m", "max_change_m", "refused_joins", "odometry_faults", "georeferences")
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    LOOPS_IN_MAP_FIELD_NUMBER: _ClassVar[int]
    LOOPS_SET_ASIDE_FIELD_NUMBER: _ClassVar[int]
    LOOPS_UNCONNECTED_FIELD_NUMBER: _ClassVar[int]
    CHI2_FIELD_NUMBER: _ClassVar[int]
    DEGREES_OF_FREEDOM_FIELD_NUMBER: _ClassVar[int]
    MEAN_CHANGE_M_FIELD_NUMBER: _ClassVar[int]
    MAX_CHANGE_M_FIELD_NUMBER: _ClassVar[int]
    REFUSED_JOINS_FIELD_NUMBER: _ClassVar[int]
    ODOMETRY_FAULTS_FIELD_NUMBER: _ClassVar[int]
    GEOREFERENCES_FIELD_NUMBER: _ClassVar[int]
    sessions: int
    submaps: int
    frames: int
    loops_in_map: int
    loops_set_aside: int
    loops_unconnected: int
    chi2: float
    degrees_of_freedom: int
    mean_change_m: float
    max_change_m: float
    refused_joins: _containers.RepeatedCompositeFieldContainer[RefusedJoin]
    odometry_faults: _containers.RepeatedCompositeFieldContainer[_session_pb2.OdometryFault]
    georeferences: _containers.RepeatedCompositeFieldContainer[_anchor_pb2.Georeference]
    def __init__(self, sessions: _Optional[int] = ..., submaps: _Optional[int] = ..., frames: _Optional[int] = ..., loops_in_map: _Optional[int] = ..., loops_set_aside: _Optional[int] = ..., loops_unconnected: _Optional[int] = ..., chi2: _Optional[float] = ..., degrees_of_freedom: _Optional[int] = ..., mean_change_m: _Optional[float] = ..., max_change_m: _Optional[float] = ..., refused_joins: _Optional[_Iterable[_Union[RefusedJoin, _Mapping]]] = ..., odometry_faults: _Optional[_Iterable[_Union[_session_pb2.OdometryFault, _Mapping]]] = ..., georeferences: _Optional[_Iterable[_Union[_anchor_pb2.Georeference, _Mapping]]] = ...) -> None: ...

class RefusedJoin(_message.Message):
    __slots__ = ("sessions", "other_sessions", "reason", "loops", "common_points", "residual_m", "seen_through_share", "worst_stretch_share")
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    OTHER_SESSIONS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    LOOPS_FIELD_NUMBER: _ClassVar[int]
    COMMON_POINTS_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_M_FIELD_NUMBER: _ClassVar[int]
    SEEN_THROUGH_SHARE_FIELD_NUMBER: _ClassVar[int]
    WORST_STRETCH_SHARE_FIELD_NUMBER: _ClassVar[int]
    sessions: _containers.RepeatedScalarFieldContainer[str]
    other_sessions: _containers.RepeatedScalarFieldContainer[str]
    reason: str
    loops: int
    common_points: int
    residual_m: float
    seen_through_share: float
    worst_stretch_share: float
    def __init__(self, sessions: _Optional[_Iterable[str]] = ..., other_sessions: _Optional[_Iterable[str]] = ..., reason: _Optional[str] = ..., loops: _Optional[int] = ..., common_points: _Optional[int] = ..., residual_m: _Optional[float] = ..., seen_through_share: _Optional[float] = ..., worst_stretch_share: _Optional[float] = ...) -> None: ...

class SubmapPose(_message.Message):
    __slots__ = ("submap", "t_map_submap", "frame", "covariance")
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    T_MAP_SUBMAP_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    submap: str
    t_map_submap: _geometry_pb2.Transform
    frame: str
    covariance: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, submap: _Optional[str] = ..., t_map_submap: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., frame: _Optional[str] = ..., covariance: _Optional[_Iterable[float]] = ...) -> None: ...

class Correction(_message.Message):
    __slots__ = ("session", "t_map_odom", "frame", "map_version", "covariance", "created_at_ns", "early_loops", "odometry_faults")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    T_MAP_ODOM_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    EARLY_LOOPS_FIELD_NUMBER: _ClassVar[int]
    ODOMETRY_FAULTS_FIELD_NUMBER: _ClassVar[int]
    session: str
    t_map_odom: _geometry_pb2.Transform
    frame: str
    map_version: int
    covariance: _containers.RepeatedScalarFieldContainer[float]
    created_at_ns: int
    early_loops: int
    odometry_faults: _containers.RepeatedCompositeFieldContainer[_session_pb2.OdometryFault]
    def __init__(self, session: _Optional[str] = ..., t_map_odom: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., frame: _Optional[str] = ..., map_version: _Optional[int] = ..., covariance: _Optional[_Iterable[float]] = ..., created_at_ns: _Optional[int] = ..., early_loops: _Optional[int] = ..., odometry_faults: _Optional[_Iterable[_Union[_session_pb2.OdometryFault, _Mapping]]] = ...) -> None: ...

class OptimiseMapRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class OptimiseMapResponse(_message.Message):
    __slots__ = ("operation", "replay")
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    operation: _operation_pb2.Operation
    replay: bool
    def __init__(self, operation: _Optional[_Union[_operation_pb2.Operation, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class ListMapVersionsRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListMapVersionsResponse(_message.Message):
    __slots__ = ("map_versions", "next_page_token")
    MAP_VERSIONS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    map_versions: _containers.RepeatedCompositeFieldContainer[MapVersion]
    next_page_token: str
    def __init__(self, map_versions: _Optional[_Iterable[_Union[MapVersion, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class GetMapVersionRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetMapVersionResponse(_message.Message):
    __slots__ = ("map_version",)
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    map_version: MapVersion
    def __init__(self, map_version: _Optional[_Union[MapVersion, _Mapping]] = ...) -> None: ...

class ListSubmapPosesRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListSubmapPosesResponse(_message.Message):
    __slots__ = ("submap_poses", "next_page_token")
    SUBMAP_POSES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    submap_poses: _containers.RepeatedCompositeFieldContainer[SubmapPose]
    next_page_token: str
    def __init__(self, submap_poses: _Optional[_Iterable[_Union[SubmapPose, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class RevertMapRequest(_message.Message):
    __slots__ = ("name", "version")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    name: str
    version: int
    def __init__(self, name: _Optional[str] = ..., version: _Optional[int] = ...) -> None: ...

class RevertMapResponse(_message.Message):
    __slots__ = ("map_version",)
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    map_version: MapVersion
    def __init__(self, map_version: _Optional[_Union[MapVersion, _Mapping]] = ...) -> None: ...

class GetCorrectionRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetCorrectionResponse(_message.Message):
    __slots__ = ("correction",)
    CORRECTION_FIELD_NUMBER: _ClassVar[int]
    correction: Correction
    def __init__(self, correction: _Optional[_Union[Correction, _Mapping]] = ...) -> None: ...

class WatchCorrectionsRequest(_message.Message):
    __slots__ = ("parent", "after", "session")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    parent: str
    after: int
    session: str
    def __init__(self, parent: _Optional[str] = ..., after: _Optional[int] = ..., session: _Optional[str] = ...) -> None: ...

class WatchCorrectionsResponse(_message.Message):
    __slots__ = ("correction",)
    CORRECTION_FIELD_NUMBER: _ClassVar[int]
    correction: Correction
    def __init__(self, correction: _Optional[_Union[Correction, _Mapping]] = ...) -> None: ...

class MergeMapRequest(_message.Message):
    __slots__ = ("name", "source", "validate_only", "t_map_source", "radius_m")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    VALIDATE_ONLY_FIELD_NUMBER: _ClassVar[int]
    T_MAP_SOURCE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    name: str
    source: str
    validate_only: bool
    t_map_source: _geometry_pb2.Transform
    radius_m: float
    def __init__(self, name: _Optional[str] = ..., source: _Optional[str] = ..., validate_only: _Optional[bool] = ..., t_map_source: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., radius_m: _Optional[float] = ...) -> None: ...

class MergeMapResponse(_message.Message):
    __slots__ = ("operation", "replay")
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    operation: _operation_pb2.Operation
    replay: bool
    def __init__(self, operation: _Optional[_Union[_operation_pb2.Operation, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class MapMerge(_message.Message):
    __slots__ = ("name", "source", "version_before", "version", "sessions", "report", "changes", "created_at_ns", "reverted_at_ns")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    VERSION_BEFORE_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    REPORT_FIELD_NUMBER: _ClassVar[int]
    CHANGES_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    REVERTED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    name: str
    source: str
    version_before: int
    version: int
    sessions: _containers.RepeatedScalarFieldContainer[str]
    report: _struct_pb2.Struct
    changes: _containers.RepeatedCompositeFieldContainer[MapChange]
    created_at_ns: int
    reverted_at_ns: int
    def __init__(self, name: _Optional[str] = ..., source: _Optional[str] = ..., version_before: _Optional[int] = ..., version: _Optional[int] = ..., sessions: _Optional[_Iterable[str]] = ..., report: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., changes: _Optional[_Iterable[_Union[MapChange, _Mapping]]] = ..., created_at_ns: _Optional[int] = ..., reverted_at_ns: _Optional[int] = ...) -> None: ...

class MapChange(_message.Message):
    __slots__ = ("kind", "centre_m", "extent_m", "points", "moved_from_m", "frame", "session", "stamp_ns", "before_ns")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        KIND_UNSPECIFIED: _ClassVar[MapChange.Kind]
        VANISHED: _ClassVar[MapChange.Kind]
        APPEARED: _ClassVar[MapChange.Kind]
        MOVED: _ClassVar[MapChange.Kind]
        BACK: _ClassVar[MapChange.Kind]
    KIND_UNSPECIFIED: MapChange.Kind
    VANISHED: MapChange.Kind
    APPEARED: MapChange.Kind
    MOVED: MapChange.Kind
    BACK: MapChange.Kind
    KIND_FIELD_NUMBER: _ClassVar[int]
    CENTRE_M_FIELD_NUMBER: _ClassVar[int]
    EXTENT_M_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    MOVED_FROM_M_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    BEFORE_NS_FIELD_NUMBER: _ClassVar[int]
    kind: MapChange.Kind
    centre_m: _geometry_pb2.Vector3
    extent_m: _geometry_pb2.Vector3
    points: int
    moved_from_m: _geometry_pb2.Vector3
    frame: str
    session: str
    stamp_ns: int
    before_ns: int
    def __init__(self, kind: _Optional[_Union[MapChange.Kind, str]] = ..., centre_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., extent_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., points: _Optional[int] = ..., moved_from_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., frame: _Optional[str] = ..., session: _Optional[str] = ..., stamp_ns: _Optional[int] = ..., before_ns: _Optional[int] = ...) -> None: ...

class DriveChanges(_message.Message):
    __slots__ = ("session", "map_version", "appeared", "vanished", "moved", "back")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    APPEARED_FIELD_NUMBER: _ClassVar[int]
    VANISHED_FIELD_NUMBER: _ClassVar[int]
    MOVED_FIELD_NUMBER: _ClassVar[int]
    BACK_FIELD_NUMBER: _ClassVar[int]
    session: str
    map_version: str
    appeared: int
    vanished: int
    moved: int
    back: int
    def __init__(self, session: _Optional[str] = ..., map_version: _Optional[str] = ..., appeared: _Optional[int] = ..., vanished: _Optional[int] = ..., moved: _Optional[int] = ..., back: _Optional[int] = ...) -> None: ...

class ListMapChangesRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token", "after_ns", "until_ns")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    AFTER_NS_FIELD_NUMBER: _ClassVar[int]
    UNTIL_NS_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    after_ns: int
    until_ns: int
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., after_ns: _Optional[int] = ..., until_ns: _Optional[int] = ...) -> None: ...

class ListMapChangesResponse(_message.Message):
    __slots__ = ("map_changes", "next_page_token")
    MAP_CHANGES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    map_changes: _containers.RepeatedCompositeFieldContainer[MapChange]
    next_page_token: str
    def __init__(self, map_changes: _Optional[_Iterable[_Union[MapChange, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class ListMapMergesRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListMapMergesResponse(_message.Message):
    __slots__ = ("map_merges", "next_page_token")
    MAP_MERGES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    map_merges: _containers.RepeatedCompositeFieldContainer[MapMerge]
    next_page_token: str
    def __init__(self, map_merges: _Optional[_Iterable[_Union[MapMerge, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class GetMapMergeRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetMapMergeResponse(_message.Message):
    __slots__ = ("map_merge",)
    MAP_MERGE_FIELD_NUMBER: _ClassVar[int]
    map_merge: MapMerge
    def __init__(self, map_merge: _Optional[_Union[MapMerge, _Mapping]] = ...) -> None: ...

class RevertMapMergeRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class RevertMapMergeResponse(_message.Message):
    __slots__ = ("map_merge",)
    MAP_MERGE_FIELD_NUMBER: _ClassVar[int]
    map_merge: MapMerge
    def __init__(self, map_merge: _Optional[_Union[MapMerge, _Mapping]] = ...) -> None: ...
