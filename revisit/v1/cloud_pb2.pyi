from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Cloud(_message.Message):
    __slots__ = ("content_type", "data")
    CONTENT_TYPE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    content_type: str
    data: bytes
    def __init__(self, content_type: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...

class CloudReport(_message.Message):
    __slots__ = ("dropped_nonfinite", "degenerate_plane")
    DROPPED_NONFINITE_FIELD_NUMBER: _ClassVar[int]
    DEGENERATE_PLANE_FIELD_NUMBER: _ClassVar[int]
    dropped_nonfinite: int
    degenerate_plane: bool
    def __init__(self, dropped_nonfinite: _Optional[int] = ..., degenerate_plane: _Optional[bool] = ...) -> None: ...
