from revisit.v1 import anchor_pb2 as _anchor_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Map(_message.Message):
    __slots__ = ("name", "display_name", "tau_m", "stride_m", "session_count", "submap_count", "created_at_ns", "scene_scale", "loop_policy", "map_version", "leave_distance_m", "profile", "origin")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DISPLAY_NAME_FIELD_NUMBER: _ClassVar[int]
    TAU_M_FIELD_NUMBER: _ClassVar[int]
    STRIDE_M_FIELD_NUMBER: _ClassVar[int]
    SESSION_COUNT_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_COUNT_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    SCENE_SCALE_FIELD_NUMBER: _ClassVar[int]
    LOOP_POLICY_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    LEAVE_DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    PROFILE_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    name: str
    display_name: str
    tau_m: float
    stride_m: float
    session_count: int
    submap_count: int
    created_at_ns: int
    scene_scale: float
    loop_policy: LoopPolicy
    map_version: int
    leave_distance_m: float
    profile: str
    origin: _anchor_pb2.GeodeticPosition
    def __init__(self, name: _Optional[str] = ..., display_name: _Optional[str] = ..., tau_m: _Optional[float] = ..., stride_m: _Optional[float] = ..., session_count: _Optional[int] = ..., submap_count: _Optional[int] = ..., created_at_ns: _Optional[int] = ..., scene_scale: _Optional[float] = ..., loop_policy: _Optional[_Union[LoopPolicy, _Mapping]] = ..., map_version: _Optional[int] = ..., leave_distance_m: _Optional[float] = ..., profile: _Optional[str] = ..., origin: _Optional[_Union[_anchor_pb2.GeodeticPosition, _Mapping]] = ...) -> None: ...

class LoopPolicy(_message.Message):
    __slots__ = ("candidates", "min_score", "min_overlap", "max_seen_through")
    CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    MIN_SCORE_FIELD_NUMBER: _ClassVar[int]
    MIN_OVERLAP_FIELD_NUMBER: _ClassVar[int]
    MAX_SEEN_THROUGH_FIELD_NUMBER: _ClassVar[int]
    candidates: int
    min_score: float
    min_overlap: float
    max_seen_through: float
    def __init__(self, candidates: _Optional[int] = ..., min_score: _Optional[float] = ..., min_overlap: _Optional[float] = ..., max_seen_through: _Optional[float] = ...) -> None: ...

class CreateMapRequest(_message.Message):
    __slots__ = ("map_id", "display_name", "tau_m", "stride_m", "scene_scale", "loop_policy", "leave_distance_m", "profile")
    MAP_ID_FIELD_NUMBER: _ClassVar[int]
    DISPLAY_NAME_FIELD_NUMBER: _ClassVar[int]
    TAU_M_FIELD_NUMBER: _ClassVar[int]
    STRIDE_M_FIELD_NUMBER: _ClassVar[int]
    SCENE_SCALE_FIELD_NUMBER: _ClassVar[int]
    LOOP_POLICY_FIELD_NUMBER: _ClassVar[int]
    LEAVE_DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    PROFILE_FIELD_NUMBER: _ClassVar[int]
    map_id: str
    display_name: str
    tau_m: float
    stride_m: float
    scene_scale: float
    loop_policy: LoopPolicy
    leave_distance_m: float
    profile: str
    def __init__(self, map_id: _Optional[str] = ..., display_name: _Optional[str] = ..., tau_m: _Optional[float] = ..., stride_m: _Optional[float] = ..., scene_scale: _Optional[float] = ..., loop_policy: _Optional[_Union[LoopPolicy, _Mapping]] = ..., leave_distance_m: _Optional[float] = ..., profile: _Optional[str] = ...) -> None: ...

class CreateMapResponse(_message.Message):
    __slots__ = ("map", "replay")
    MAP_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    map: Map
    replay: bool
    def __init__(self, map: _Optional[_Union[Map, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class GetMapRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetMapResponse(_message.Message):
    __slots__ = ("map",)
    MAP_FIELD_NUMBER: _ClassVar[int]
    map: Map
    def __init__(self, map: _Optional[_Union[Map, _Mapping]] = ...) -> None: ...

class ListMapsRequest(_message.Message):
    __slots__ = ("page_size", "page_token")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListMapsResponse(_message.Message):
    __slots__ = ("maps", "next_page_token")
    MAPS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    maps: _containers.RepeatedCompositeFieldContainer[Map]
    next_page_token: str
    def __init__(self, maps: _Optional[_Iterable[_Union[Map, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class DeleteMapRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DeleteMapResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
