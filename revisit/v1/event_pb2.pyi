from revisit.v1 import anchor_pb2 as _anchor_pb2
from revisit.v1 import loop_closure_pb2 as _loop_closure_pb2
from revisit.v1 import mapping_pb2 as _mapping_pb2
from revisit.v1 import operation_pb2 as _operation_pb2
from revisit.v1 import retention_pb2 as _retention_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Event(_message.Message):
    __slots__ = ("number", "kind", "map", "loop_closure", "operation", "map_version", "retention", "anchor", "drive_changes")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        KIND_UNSPECIFIED: _ClassVar[Event.Kind]
        LOOP_CLOSURE: _ClassVar[Event.Kind]
        OPERATION: _ClassVar[Event.Kind]
        OPENED: _ClassVar[Event.Kind]
        MAP_VERSION: _ClassVar[Event.Kind]
        RETENTION: _ClassVar[Event.Kind]
        ANCHOR: _ClassVar[Event.Kind]
        MAP_CHANGED: _ClassVar[Event.Kind]
        FORGOTTEN: _ClassVar[Event.Kind]
    KIND_UNSPECIFIED: Event.Kind
    LOOP_CLOSURE: Event.Kind
    OPERATION: Event.Kind
    OPENED: Event.Kind
    MAP_VERSION: Event.Kind
    RETENTION: Event.Kind
    ANCHOR: Event.Kind
    MAP_CHANGED: Event.Kind
    FORGOTTEN: Event.Kind
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    MAP_FIELD_NUMBER: _ClassVar[int]
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    RETENTION_FIELD_NUMBER: _ClassVar[int]
    ANCHOR_FIELD_NUMBER: _ClassVar[int]
    DRIVE_CHANGES_FIELD_NUMBER: _ClassVar[int]
    number: int
    kind: Event.Kind
    map: str
    loop_closure: _loop_closure_pb2.LoopClosure
    operation: _operation_pb2.Operation
    map_version: _mapping_pb2.MapVersion
    retention: _retention_pb2.RetentionReport
    anchor: _anchor_pb2.Anchor
    drive_changes: _mapping_pb2.DriveChanges
    def __init__(self, number: _Optional[int] = ..., kind: _Optional[_Union[Event.Kind, str]] = ..., map: _Optional[str] = ..., loop_closure: _Optional[_Union[_loop_closure_pb2.LoopClosure, _Mapping]] = ..., operation: _Optional[_Union[_operation_pb2.Operation, _Mapping]] = ..., map_version: _Optional[_Union[_mapping_pb2.MapVersion, _Mapping]] = ..., retention: _Optional[_Union[_retention_pb2.RetentionReport, _Mapping]] = ..., anchor: _Optional[_Union[_anchor_pb2.Anchor, _Mapping]] = ..., drive_changes: _Optional[_Union[_mapping_pb2.DriveChanges, _Mapping]] = ...) -> None: ...

class WatchEventsRequest(_message.Message):
    __slots__ = ("parent", "after", "kinds")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    KINDS_FIELD_NUMBER: _ClassVar[int]
    parent: str
    after: int
    kinds: _containers.RepeatedScalarFieldContainer[Event.Kind]
    def __init__(self, parent: _Optional[str] = ..., after: _Optional[int] = ..., kinds: _Optional[_Iterable[_Union[Event.Kind, str]]] = ...) -> None: ...

class WatchEventsResponse(_message.Message):
    __slots__ = ("event",)
    EVENT_FIELD_NUMBER: _ClassVar[int]
    event: Event
    def __init__(self, event: _Optional[_Union[Event, _Mapping]] = ...) -> None: ...
