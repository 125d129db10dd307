from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Session(_message.Message):
    __slots__ = ("name", "robot", "state", "committed_seq", "travelled_m", "submap_count", "created_at_ns", "finished_at_ns", "committed_stamp_ns", "findings", "storey", "no_loops", "drift")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATE_UNSPECIFIED: _ClassVar[Session.State]
        ACTIVE: _ClassVar[Session.State]
        FINISHED: _ClassVar[Session.State]
    STATE_UNSPECIFIED: Session.State
    ACTIVE: Session.State
    FINISHED: Session.State
    NAME_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_SEQ_FIELD_NUMBER: _ClassVar[int]
    TRAVELLED_M_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_COUNT_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    FINISHED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    FINDINGS_FIELD_NUMBER: _ClassVar[int]
    STOREY_FIELD_NUMBER: _ClassVar[int]
    NO_LOOPS_FIELD_NUMBER: _ClassVar[int]
    DRIFT_FIELD_NUMBER: _ClassVar[int]
    name: str
    robot: str
    state: Session.State
    committed_seq: int
    travelled_m: float
    submap_count: int
    created_at_ns: int
    finished_at_ns: int
    committed_stamp_ns: int
    findings: _containers.RepeatedCompositeFieldContainer[Finding]
    storey: str
    no_loops: NoLoops
    drift: str
    def __init__(self, name: _Optional[str] = ..., robot: _Optional[str] = ..., state: _Optional[_Union[Session.State, str]] = ..., committed_seq: _Optional[int] = ..., travelled_m: _Optional[float] = ..., submap_count: _Optional[int] = ..., created_at_ns: _Optional[int] = ..., finished_at_ns: _Optional[int] = ..., committed_stamp_ns: _Optional[int] = ..., findings: _Optional[_Iterable[_Union[Finding, _Mapping]]] = ..., storey: _Optional[str] = ..., no_loops: _Optional[_Union[NoLoops, _Mapping]] = ..., drift: _Optional[str] = ...) -> None: ...

class NoLoops(_message.Message):
    __slots__ = ("code", "message")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    code: str
    message: str
    def __init__(self, code: _Optional[str] = ..., message: _Optional[str] = ...) -> None: ...

class Finding(_message.Message):
    __slots__ = ("code", "submaps", "cause", "advice", "odometry_fault")
    CODE_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    ADVICE_FIELD_NUMBER: _ClassVar[int]
    ODOMETRY_FAULT_FIELD_NUMBER: _ClassVar[int]
    code: str
    submaps: int
    cause: str
    advice: str
    odometry_fault: OdometryFault
    def __init__(self, code: _Optional[str] = ..., submaps: _Optional[int] = ..., cause: _Optional[str] = ..., advice: _Optional[str] = ..., odometry_fault: _Optional[_Union[OdometryFault, _Mapping]] = ...) -> None: ...

class OdometryFault(_message.Message):
    __slots__ = ("session", "kind", "first_submap", "last_submap", "amount", "sigma", "loops", "submaps", "message", "undecided")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    FIRST_SUBMAP_FIELD_NUMBER: _ClassVar[int]
    LAST_SUBMAP_FIELD_NUMBER: _ClassVar[int]
    AMOUNT_FIELD_NUMBER: _ClassVar[int]
    SIGMA_FIELD_NUMBER: _ClassVar[int]
    LOOPS_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    UNDECIDED_FIELD_NUMBER: _ClassVar[int]
    session: str
    kind: str
    first_submap: str
    last_submap: str
    amount: float
    sigma: float
    loops: int
    submaps: int
    message: str
    undecided: bool
    def __init__(self, session: _Optional[str] = ..., kind: _Optional[str] = ..., first_submap: _Optional[str] = ..., last_submap: _Optional[str] = ..., amount: _Optional[float] = ..., sigma: _Optional[float] = ..., loops: _Optional[int] = ..., submaps: _Optional[int] = ..., message: _Optional[str] = ..., undecided: _Optional[bool] = ...) -> None: ...

class CreateSessionRequest(_message.Message):
    __slots__ = ("parent", "session_id", "robot", "storey", "drift")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    STOREY_FIELD_NUMBER: _ClassVar[int]
    DRIFT_FIELD_NUMBER: _ClassVar[int]
    parent: str
    session_id: str
    robot: str
    storey: str
    drift: str
    def __init__(self, parent: _Optional[str] = ..., session_id: _Optional[str] = ..., robot: _Optional[str] = ..., storey: _Optional[str] = ..., drift: _Optional[str] = ...) -> None: ...

class CreateSessionResponse(_message.Message):
    __slots__ = ("session", "replay")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    session: Session
    replay: bool
    def __init__(self, session: _Optional[_Union[Session, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class GetSessionRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetSessionResponse(_message.Message):
    __slots__ = ("session",)
    SESSION_FIELD_NUMBER: _ClassVar[int]
    session: Session
    def __init__(self, session: _Optional[_Union[Session, _Mapping]] = ...) -> None: ...

class ListSessionsRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListSessionsResponse(_message.Message):
    __slots__ = ("sessions", "next_page_token")
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    sessions: _containers.RepeatedCompositeFieldContainer[Session]
    next_page_token: str
    def __init__(self, sessions: _Optional[_Iterable[_Union[Session, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class FinishSessionRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class FinishSessionResponse(_message.Message):
    __slots__ = ("session",)
    SESSION_FIELD_NUMBER: _ClassVar[int]
    session: Session
    def __init__(self, session: _Optional[_Union[Session, _Mapping]] = ...) -> None: ...

class DeleteSessionRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DeleteSessionResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
