from revisit.v1 import geometry_pb2 as _geometry_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MapTile(_message.Message):
    __slots__ = ("name", "frame", "min_x_m", "min_y_m", "max_x_m", "max_y_m", "submaps", "made")
    NAME_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MIN_X_M_FIELD_NUMBER: _ClassVar[int]
    MIN_Y_M_FIELD_NUMBER: _ClassVar[int]
    MAX_X_M_FIELD_NUMBER: _ClassVar[int]
    MAX_Y_M_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    MADE_FIELD_NUMBER: _ClassVar[int]
    name: str
    frame: str
    min_x_m: float
    min_y_m: float
    max_x_m: float
    max_y_m: float
    submaps: int
    made: bool
    def __init__(self, name: _Optional[str] = ..., frame: _Optional[str] = ..., min_x_m: _Optional[float] = ..., min_y_m: _Optional[float] = ..., max_x_m: _Optional[float] = ..., max_y_m: _Optional[float] = ..., submaps: _Optional[int] = ..., made: _Optional[bool] = ...) -> None: ...

class ListMapTilesRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListMapTilesResponse(_message.Message):
    __slots__ = ("map_tiles", "next_page_token")
    MAP_TILES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    map_tiles: _containers.RepeatedCompositeFieldContainer[MapTile]
    next_page_token: str
    def __init__(self, map_tiles: _Optional[_Iterable[_Union[MapTile, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class DownloadMapTileRequest(_message.Message):
    __slots__ = ("name", "format", "as_of_ns", "ever")
    class Format(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        FORMAT_UNSPECIFIED: _ClassVar[DownloadMapTileRequest.Format]
        PCD: _ClassVar[DownloadMapTileRequest.Format]
        PLY: _ClassVar[DownloadMapTileRequest.Format]
        NPY: _ClassVar[DownloadMapTileRequest.Format]
        MESH: _ClassVar[DownloadMapTileRequest.Format]
        NEURAL: _ClassVar[DownloadMapTileRequest.Format]
        GLB: _ClassVar[DownloadMapTileRequest.Format]
    FORMAT_UNSPECIFIED: DownloadMapTileRequest.Format
    PCD: DownloadMapTileRequest.Format
    PLY: DownloadMapTileRequest.Format
    NPY: DownloadMapTileRequest.Format
    MESH: DownloadMapTileRequest.Format
    NEURAL: DownloadMapTileRequest.Format
    GLB: DownloadMapTileRequest.Format
    NAME_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    AS_OF_NS_FIELD_NUMBER: _ClassVar[int]
    EVER_FIELD_NUMBER: _ClassVar[int]
    name: str
    format: DownloadMapTileRequest.Format
    as_of_ns: int
    ever: bool
    def __init__(self, name: _Optional[str] = ..., format: _Optional[_Union[DownloadMapTileRequest.Format, str]] = ..., as_of_ns: _Optional[int] = ..., ever: _Optional[bool] = ...) -> None: ...

class DownloadMapTileResponse(_message.Message):
    __slots__ = ("media_type", "filename", "data")
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    FILENAME_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    media_type: str
    filename: str
    data: bytes
    def __init__(self, media_type: _Optional[str] = ..., filename: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...

class MeasureMapDistancesRequest(_message.Message):
    __slots__ = ("parent", "frame", "points_m", "as_of_ns", "ever")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    POINTS_M_FIELD_NUMBER: _ClassVar[int]
    AS_OF_NS_FIELD_NUMBER: _ClassVar[int]
    EVER_FIELD_NUMBER: _ClassVar[int]
    parent: str
    frame: str
    points_m: _containers.RepeatedCompositeFieldContainer[_geometry_pb2.Vector3]
    as_of_ns: int
    ever: bool
    def __init__(self, parent: _Optional[str] = ..., frame: _Optional[str] = ..., points_m: _Optional[_Iterable[_Union[_geometry_pb2.Vector3, _Mapping]]] = ..., as_of_ns: _Optional[int] = ..., ever: _Optional[bool] = ...) -> None: ...

class MapDistance(_message.Message):
    __slots__ = ("distance_m", "nearest_m")
    DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    NEAREST_M_FIELD_NUMBER: _ClassVar[int]
    distance_m: float
    nearest_m: float
    def __init__(self, distance_m: _Optional[float] = ..., nearest_m: _Optional[float] = ...) -> None: ...

class MeasureMapDistancesResponse(_message.Message):
    __slots__ = ("map_version", "frame", "distances")
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    DISTANCES_FIELD_NUMBER: _ClassVar[int]
    map_version: int
    frame: str
    distances: _containers.RepeatedCompositeFieldContainer[MapDistance]
    def __init__(self, map_version: _Optional[int] = ..., frame: _Optional[str] = ..., distances: _Optional[_Iterable[_Union[MapDistance, _Mapping]]] = ...) -> None: ...

class FindMapPointsRequest(_message.Message):
    __slots__ = ("parent", "frame", "centre_m", "within_m", "limit", "as_of_ns", "ever")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    CENTRE_M_FIELD_NUMBER: _ClassVar[int]
    WITHIN_M_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    AS_OF_NS_FIELD_NUMBER: _ClassVar[int]
    EVER_FIELD_NUMBER: _ClassVar[int]
    parent: str
    frame: str
    centre_m: _geometry_pb2.Vector3
    within_m: float
    limit: int
    as_of_ns: int
    ever: bool
    def __init__(self, parent: _Optional[str] = ..., frame: _Optional[str] = ..., centre_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., within_m: _Optional[float] = ..., limit: _Optional[int] = ..., as_of_ns: _Optional[int] = ..., ever: _Optional[bool] = ...) -> None: ...

class MapPoint(_message.Message):
    __slots__ = ("position_m", "normal")
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    position_m: _geometry_pb2.Vector3
    normal: _geometry_pb2.Vector3
    def __init__(self, position_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., normal: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ...) -> None: ...

class FindMapPointsResponse(_message.Message):
    __slots__ = ("map_version", "frame", "points", "total")
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    TOTAL_FIELD_NUMBER: _ClassVar[int]
    map_version: int
    frame: str
    points: _containers.RepeatedCompositeFieldContainer[MapPoint]
    total: int
    def __init__(self, map_version: _Optional[int] = ..., frame: _Optional[str] = ..., points: _Optional[_Iterable[_Union[MapPoint, _Mapping]]] = ..., total: _Optional[int] = ...) -> None: ...
