from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Cloud(_message.Message):
    __slots__ = ("encoded", "packed")
    ENCODED_FIELD_NUMBER: _ClassVar[int]
    PACKED_FIELD_NUMBER: _ClassVar[int]
    encoded: EncodedCloud
    packed: PackedCloud
    def __init__(self, encoded: _Optional[_Union[EncodedCloud, _Mapping]] = ..., packed: _Optional[_Union[PackedCloud, _Mapping]] = ...) -> None: ...

class EncodedCloud(_message.Message):
    __slots__ = ("content_type", "data")
    CONTENT_TYPE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    content_type: str
    data: bytes
    def __init__(self, content_type: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...

class PackedCloud(_message.Message):
    __slots__ = ("fields", "point_stride", "width", "height", "big_endian", "encoding", "data")
    class Encoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        ENCODING_UNSPECIFIED: _ClassVar[PackedCloud.Encoding]
        RAW: _ClassVar[PackedCloud.Encoding]
        QUANTISED: _ClassVar[PackedCloud.Encoding]
    ENCODING_UNSPECIFIED: PackedCloud.Encoding
    RAW: PackedCloud.Encoding
    QUANTISED: PackedCloud.Encoding
    FIELDS_FIELD_NUMBER: _ClassVar[int]
    POINT_STRIDE_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    BIG_ENDIAN_FIELD_NUMBER: _ClassVar[int]
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    fields: _containers.RepeatedCompositeFieldContainer[PackedField]
    point_stride: int
    width: int
    height: int
    big_endian: bool
    encoding: PackedCloud.Encoding
    data: bytes
    def __init__(self, fields: _Optional[_Iterable[_Union[PackedField, _Mapping]]] = ..., point_stride: _Optional[int] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., big_endian: _Optional[bool] = ..., encoding: _Optional[_Union[PackedCloud.Encoding, str]] = ..., data: _Optional[bytes] = ...) -> None: ...

class PackedField(_message.Message):
    __slots__ = ("name", "offset", "datatype", "count")
    NAME_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    DATATYPE_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    name: str
    offset: int
    datatype: int
    count: int
    def __init__(self, name: _Optional[str] = ..., offset: _Optional[int] = ..., datatype: _Optional[int] = ..., count: _Optional[int] = ...) -> None: ...

class CloudReport(_message.Message):
    __slots__ = ("dropped_nonfinite", "degenerate_plane")
    DROPPED_NONFINITE_FIELD_NUMBER: _ClassVar[int]
    DEGENERATE_PLANE_FIELD_NUMBER: _ClassVar[int]
    dropped_nonfinite: int
    degenerate_plane: bool
    def __init__(self, dropped_nonfinite: _Optional[int] = ..., degenerate_plane: _Optional[bool] = ...) -> None: ...
