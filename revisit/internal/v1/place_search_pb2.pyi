from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class NearestRequest(_message.Message):
    __slots__ = ("tenant", "map_number", "vector", "k", "where", "before")
    TENANT_FIELD_NUMBER: _ClassVar[int]
    MAP_NUMBER_FIELD_NUMBER: _ClassVar[int]
    VECTOR_FIELD_NUMBER: _ClassVar[int]
    K_FIELD_NUMBER: _ClassVar[int]
    WHERE_FIELD_NUMBER: _ClassVar[int]
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    tenant: str
    map_number: int
    vector: bytes
    k: int
    where: Filter
    before: int
    def __init__(self, tenant: _Optional[str] = ..., map_number: _Optional[int] = ..., vector: _Optional[bytes] = ..., k: _Optional[int] = ..., where: _Optional[_Union[Filter, _Mapping]] = ..., before: _Optional[int] = ...) -> None: ...

class Filter(_message.Message):
    __slots__ = ("exclude_session", "only_session", "only_sessions", "of_session", "without", "position_m", "radius_m")
    EXCLUDE_SESSION_FIELD_NUMBER: _ClassVar[int]
    ONLY_SESSION_FIELD_NUMBER: _ClassVar[int]
    ONLY_SESSIONS_FIELD_NUMBER: _ClassVar[int]
    OF_SESSION_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_FIELD_NUMBER: _ClassVar[int]
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    exclude_session: int
    only_session: int
    only_sessions: Numbers
    of_session: int
    without: _containers.RepeatedScalarFieldContainer[int]
    position_m: _containers.RepeatedScalarFieldContainer[float]
    radius_m: float
    def __init__(self, exclude_session: _Optional[int] = ..., only_session: _Optional[int] = ..., only_sessions: _Optional[_Union[Numbers, _Mapping]] = ..., of_session: _Optional[int] = ..., without: _Optional[_Iterable[int]] = ..., position_m: _Optional[_Iterable[float]] = ..., radius_m: _Optional[float] = ...) -> None: ...

class Numbers(_message.Message):
    __slots__ = ("numbers",)
    NUMBERS_FIELD_NUMBER: _ClassVar[int]
    numbers: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, numbers: _Optional[_Iterable[int]] = ...) -> None: ...

class NearestResponse(_message.Message):
    __slots__ = ("submap_numbers", "similarities", "searched", "on_other_storeys")
    SUBMAP_NUMBERS_FIELD_NUMBER: _ClassVar[int]
    SIMILARITIES_FIELD_NUMBER: _ClassVar[int]
    SEARCHED_FIELD_NUMBER: _ClassVar[int]
    ON_OTHER_STOREYS_FIELD_NUMBER: _ClassVar[int]
    submap_numbers: _containers.RepeatedScalarFieldContainer[int]
    similarities: _containers.RepeatedScalarFieldContainer[float]
    searched: int
    on_other_storeys: int
    def __init__(self, submap_numbers: _Optional[_Iterable[int]] = ..., similarities: _Optional[_Iterable[float]] = ..., searched: _Optional[int] = ..., on_other_storeys: _Optional[int] = ...) -> None: ...
