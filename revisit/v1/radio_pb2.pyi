from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RadioReading(_message.Message):
    __slots__ = ("stamp_ns", "access_points", "strengths_dbm")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    ACCESS_POINTS_FIELD_NUMBER: _ClassVar[int]
    STRENGTHS_DBM_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    access_points: _containers.RepeatedScalarFieldContainer[str]
    strengths_dbm: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, stamp_ns: _Optional[int] = ..., access_points: _Optional[_Iterable[str]] = ..., strengths_dbm: _Optional[_Iterable[int]] = ...) -> None: ...

class PostRadioRequest(_message.Message):
    __slots__ = ("parent", "readings")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    READINGS_FIELD_NUMBER: _ClassVar[int]
    parent: str
    readings: _containers.RepeatedCompositeFieldContainer[RadioReading]
    def __init__(self, parent: _Optional[str] = ..., readings: _Optional[_Iterable[_Union[RadioReading, _Mapping]]] = ...) -> None: ...

class PostRadioResponse(_message.Message):
    __slots__ = ("stored",)
    STORED_FIELD_NUMBER: _ClassVar[int]
    stored: int
    def __init__(self, stored: _Optional[int] = ...) -> None: ...
