from revisit.v1 import cloud_pb2 as _cloud_pb2
from revisit.v1 import geometry_pb2 as _geometry_pb2
from revisit.v1 import operation_pb2 as _operation_pb2
from revisit.v1 import retention_pb2 as _retention_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Submap(_message.Message):
    __slots__ = ("name", "state", "ordinal", "t_odom_submap", "position_m", "stamp_ns", "first_seq", "last_seq", "scan_count", "point_count", "raw_bytes", "neural_map_bytes", "flags", "model_version", "failure", "operation", "created_at_ns", "place_descriptor", "seq", "t_map_submap", "frame", "map_version", "kept_scans")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATE_UNSPECIFIED: _ClassVar[Submap.State]
        QUEUED: _ClassVar[Submap.State]
        DESCRIBED: _ClassVar[Submap.State]
        FAILED: _ClassVar[Submap.State]
        RETIRED: _ClassVar[Submap.State]
    STATE_UNSPECIFIED: Submap.State
    QUEUED: Submap.State
    DESCRIBED: Submap.State
    FAILED: Submap.State
    RETIRED: Submap.State
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    ORDINAL_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_SUBMAP_FIELD_NUMBER: _ClassVar[int]
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    LAST_SEQ_FIELD_NUMBER: _ClassVar[int]
    SCAN_COUNT_FIELD_NUMBER: _ClassVar[int]
    POINT_COUNT_FIELD_NUMBER: _ClassVar[int]
    RAW_BYTES_FIELD_NUMBER: _ClassVar[int]
    NEURAL_MAP_BYTES_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    PLACE_DESCRIPTOR_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    T_MAP_SUBMAP_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    KEPT_SCANS_FIELD_NUMBER: _ClassVar[int]
    name: str
    state: Submap.State
    ordinal: int
    t_odom_submap: _geometry_pb2.Transform
    position_m: _geometry_pb2.Vector3
    stamp_ns: int
    first_seq: int
    last_seq: int
    scan_count: int
    point_count: int
    raw_bytes: int
    neural_map_bytes: int
    flags: _containers.RepeatedScalarFieldContainer[str]
    model_version: str
    failure: _operation_pb2.Failure
    operation: str
    created_at_ns: int
    place_descriptor: _containers.RepeatedScalarFieldContainer[float]
    seq: int
    t_map_submap: _geometry_pb2.Transform
    frame: str
    map_version: int
    kept_scans: _retention_pb2.RetentionPolicy.Scans
    def __init__(self, name: _Optional[str] = ..., state: _Optional[_Union[Submap.State, str]] = ..., ordinal: _Optional[int] = ..., t_odom_submap: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., position_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., stamp_ns: _Optional[int] = ..., first_seq: _Optional[int] = ..., last_seq: _Optional[int] = ..., scan_count: _Optional[int] = ..., point_count: _Optional[int] = ..., raw_bytes: _Optional[int] = ..., neural_map_bytes: _Optional[int] = ..., flags: _Optional[_Iterable[str]] = ..., model_version: _Optional[str] = ..., failure: _Optional[_Union[_operation_pb2.Failure, _Mapping]] = ..., operation: _Optional[str] = ..., created_at_ns: _Optional[int] = ..., place_descriptor: _Optional[_Iterable[float]] = ..., seq: _Optional[int] = ..., t_map_submap: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., frame: _Optional[str] = ..., map_version: _Optional[int] = ..., kept_scans: _Optional[_Union[_retention_pb2.RetentionPolicy.Scans, str]] = ...) -> None: ...

class PostSubmapRequest(_message.Message):
    __slots__ = ("parent", "submap_id", "t_odom_submap", "stamp_ns", "cloud")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_ID_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_SUBMAP_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    CLOUD_FIELD_NUMBER: _ClassVar[int]
    parent: str
    submap_id: str
    t_odom_submap: _geometry_pb2.Transform
    stamp_ns: int
    cloud: _cloud_pb2.Cloud
    def __init__(self, parent: _Optional[str] = ..., submap_id: _Optional[str] = ..., t_odom_submap: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., stamp_ns: _Optional[int] = ..., cloud: _Optional[_Union[_cloud_pb2.Cloud, _Mapping]] = ...) -> None: ...

class PostSubmapResponse(_message.Message):
    __slots__ = ("submap", "operation", "replay", "report")
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    REPORT_FIELD_NUMBER: _ClassVar[int]
    submap: Submap
    operation: _operation_pb2.Operation
    replay: bool
    report: _cloud_pb2.CloudReport
    def __init__(self, submap: _Optional[_Union[Submap, _Mapping]] = ..., operation: _Optional[_Union[_operation_pb2.Operation, _Mapping]] = ..., replay: _Optional[bool] = ..., report: _Optional[_Union[_cloud_pb2.CloudReport, _Mapping]] = ...) -> None: ...

class GetSubmapRequest(_message.Message):
    __slots__ = ("name", "view")
    class View(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        VIEW_UNSPECIFIED: _ClassVar[GetSubmapRequest.View]
        BASIC: _ClassVar[GetSubmapRequest.View]
        FULL: _ClassVar[GetSubmapRequest.View]
    VIEW_UNSPECIFIED: GetSubmapRequest.View
    BASIC: GetSubmapRequest.View
    FULL: GetSubmapRequest.View
    NAME_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    name: str
    view: GetSubmapRequest.View
    def __init__(self, name: _Optional[str] = ..., view: _Optional[_Union[GetSubmapRequest.View, str]] = ...) -> None: ...

class GetSubmapResponse(_message.Message):
    __slots__ = ("submap",)
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    submap: Submap
    def __init__(self, submap: _Optional[_Union[Submap, _Mapping]] = ...) -> None: ...

class ListSubmapsRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListSubmapsResponse(_message.Message):
    __slots__ = ("submaps", "next_page_token")
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    submaps: _containers.RepeatedCompositeFieldContainer[Submap]
    next_page_token: str
    def __init__(self, submaps: _Optional[_Iterable[_Union[Submap, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class DeleteSubmapRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DeleteSubmapResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class DownloadSubmapRequest(_message.Message):
    __slots__ = ("name", "format")
    class Format(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        FORMAT_UNSPECIFIED: _ClassVar[DownloadSubmapRequest.Format]
        PCD: _ClassVar[DownloadSubmapRequest.Format]
        PLY: _ClassVar[DownloadSubmapRequest.Format]
        NPY: _ClassVar[DownloadSubmapRequest.Format]
        MESH: _ClassVar[DownloadSubmapRequest.Format]
        NEURAL: _ClassVar[DownloadSubmapRequest.Format]
        DESCRIPTOR: _ClassVar[DownloadSubmapRequest.Format]
        GLB: _ClassVar[DownloadSubmapRequest.Format]
    FORMAT_UNSPECIFIED: DownloadSubmapRequest.Format
    PCD: DownloadSubmapRequest.Format
    PLY: DownloadSubmapRequest.Format
    NPY: DownloadSubmapRequest.Format
    MESH: DownloadSubmapRequest.Format
    NEURAL: DownloadSubmapRequest.Format
    DESCRIPTOR: DownloadSubmapRequest.Format
    GLB: DownloadSubmapRequest.Format
    NAME_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    name: str
    format: DownloadSubmapRequest.Format
    def __init__(self, name: _Optional[str] = ..., format: _Optional[_Union[DownloadSubmapRequest.Format, str]] = ...) -> None: ...

class DownloadSubmapResponse(_message.Message):
    __slots__ = ("media_type", "filename", "data")
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    FILENAME_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    media_type: str
    filename: str
    data: bytes
    def __init__(self, media_type: _Optional[str] = ..., filename: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...
