from revisit.v1 import operation_pb2 as _operation_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MapFile(_message.Message):
    __slots__ = ("name", "map_id", "map_version", "map_status", "map_descriptor", "map_download_link", "map_hash", "size_bytes", "submaps", "created_at_ns")
    class MapStatus(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        MAP_STATUS_UNSPECIFIED: _ClassVar[MapFile.MapStatus]
        ENABLED: _ClassVar[MapFile.MapStatus]
        DISABLED: _ClassVar[MapFile.MapStatus]
    MAP_STATUS_UNSPECIFIED: MapFile.MapStatus
    ENABLED: MapFile.MapStatus
    DISABLED: MapFile.MapStatus
    NAME_FIELD_NUMBER: _ClassVar[int]
    MAP_ID_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    MAP_STATUS_FIELD_NUMBER: _ClassVar[int]
    MAP_DESCRIPTOR_FIELD_NUMBER: _ClassVar[int]
    MAP_DOWNLOAD_LINK_FIELD_NUMBER: _ClassVar[int]
    MAP_HASH_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    name: str
    map_id: str
    map_version: str
    map_status: MapFile.MapStatus
    map_descriptor: str
    map_download_link: str
    map_hash: str
    size_bytes: int
    submaps: int
    created_at_ns: int
    def __init__(self, name: _Optional[str] = ..., map_id: _Optional[str] = ..., map_version: _Optional[str] = ..., map_status: _Optional[_Union[MapFile.MapStatus, str]] = ..., map_descriptor: _Optional[str] = ..., map_download_link: _Optional[str] = ..., map_hash: _Optional[str] = ..., size_bytes: _Optional[int] = ..., submaps: _Optional[int] = ..., created_at_ns: _Optional[int] = ...) -> None: ...

class PublishMapFileRequest(_message.Message):
    __slots__ = ("parent", "map_descriptor")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    MAP_DESCRIPTOR_FIELD_NUMBER: _ClassVar[int]
    parent: str
    map_descriptor: str
    def __init__(self, parent: _Optional[str] = ..., map_descriptor: _Optional[str] = ...) -> None: ...

class PublishMapFileResponse(_message.Message):
    __slots__ = ("operation", "replay")
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    operation: _operation_pb2.Operation
    replay: bool
    def __init__(self, operation: _Optional[_Union[_operation_pb2.Operation, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class GetMapFileRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetMapFileResponse(_message.Message):
    __slots__ = ("map_file",)
    MAP_FILE_FIELD_NUMBER: _ClassVar[int]
    map_file: MapFile
    def __init__(self, map_file: _Optional[_Union[MapFile, _Mapping]] = ...) -> None: ...

class ListMapFilesRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListMapFilesResponse(_message.Message):
    __slots__ = ("map_files", "next_page_token")
    MAP_FILES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    map_files: _containers.RepeatedCompositeFieldContainer[MapFile]
    next_page_token: str
    def __init__(self, map_files: _Optional[_Iterable[_Union[MapFile, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class EnableMapFileRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class EnableMapFileResponse(_message.Message):
    __slots__ = ("map_file",)
    MAP_FILE_FIELD_NUMBER: _ClassVar[int]
    map_file: MapFile
    def __init__(self, map_file: _Optional[_Union[MapFile, _Mapping]] = ...) -> None: ...

class DeleteMapFileRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DeleteMapFileResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class DownloadMapFileRequest(_message.Message):
    __slots__ = ("name", "offset", "length")
    NAME_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    name: str
    offset: int
    length: int
    def __init__(self, name: _Optional[str] = ..., offset: _Optional[int] = ..., length: _Optional[int] = ...) -> None: ...

class DownloadMapFileResponse(_message.Message):
    __slots__ = ("map_hash", "size_bytes", "data")
    MAP_HASH_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    map_hash: str
    size_bytes: int
    data: bytes
    def __init__(self, map_hash: _Optional[str] = ..., size_bytes: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...
