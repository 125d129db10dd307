from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Robot(_message.Message):
    __slots__ = ("name", "display_name", "created_at_ns")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DISPLAY_NAME_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    name: str
    display_name: str
    created_at_ns: int
    def __init__(self, name: _Optional[str] = ..., display_name: _Optional[str] = ..., created_at_ns: _Optional[int] = ...) -> None: ...

class CreateRobotRequest(_message.Message):
    __slots__ = ("robot_id", "display_name")
    ROBOT_ID_FIELD_NUMBER: _ClassVar[int]
    DISPLAY_NAME_FIELD_NUMBER: _ClassVar[int]
    robot_id: str
    display_name: str
    def __init__(self, robot_id: _Optional[str] = ..., display_name: _Optional[str] = ...) -> None: ...

class CreateRobotResponse(_message.Message):
    __slots__ = ("robot", "replay")
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    robot: Robot
    replay: bool
    def __init__(self, robot: _Optional[_Union[Robot, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class GetRobotRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetRobotResponse(_message.Message):
    __slots__ = ("robot",)
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    robot: Robot
    def __init__(self, robot: _Optional[_Union[Robot, _Mapping]] = ...) -> None: ...

class ListRobotsRequest(_message.Message):
    __slots__ = ("page_size", "page_token")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListRobotsResponse(_message.Message):
    __slots__ = ("robots", "next_page_token")
    ROBOTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    robots: _containers.RepeatedCompositeFieldContainer[Robot]
    next_page_token: str
    def __init__(self, robots: _Optional[_Iterable[_Union[Robot, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...
