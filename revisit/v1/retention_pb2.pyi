from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RetentionPolicy(_message.Message):
    __slots__ = ("keep_scans", "scans_after_hours", "best_submaps", "session_days", "dropped_session_days", "rejected_days", "retired_days")
    class Scans(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        SCANS_UNSPECIFIED: _ClassVar[RetentionPolicy.Scans]
        ALL: _ClassVar[RetentionPolicy.Scans]
        DESCRIBED: _ClassVar[RetentionPolicy.Scans]
        NONE: _ClassVar[RetentionPolicy.Scans]
    SCANS_UNSPECIFIED: RetentionPolicy.Scans
    ALL: RetentionPolicy.Scans
    DESCRIBED: RetentionPolicy.Scans
    NONE: RetentionPolicy.Scans
    KEEP_SCANS_FIELD_NUMBER: _ClassVar[int]
    SCANS_AFTER_HOURS_FIELD_NUMBER: _ClassVar[int]
    BEST_SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    SESSION_DAYS_FIELD_NUMBER: _ClassVar[int]
    DROPPED_SESSION_DAYS_FIELD_NUMBER: _ClassVar[int]
    REJECTED_DAYS_FIELD_NUMBER: _ClassVar[int]
    RETIRED_DAYS_FIELD_NUMBER: _ClassVar[int]
    keep_scans: RetentionPolicy.Scans
    scans_after_hours: float
    best_submaps: int
    session_days: float
    dropped_session_days: float
    rejected_days: float
    retired_days: float
    def __init__(self, keep_scans: _Optional[_Union[RetentionPolicy.Scans, str]] = ..., scans_after_hours: _Optional[float] = ..., best_submaps: _Optional[int] = ..., session_days: _Optional[float] = ..., dropped_session_days: _Optional[float] = ..., rejected_days: _Optional[float] = ..., retired_days: _Optional[float] = ...) -> None: ...

class RetentionOutcome(_message.Message):
    __slots__ = ("rule", "sessions", "submaps", "scans", "loop_closures", "bytes")
    class Rule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        RULE_UNSPECIFIED: _ClassVar[RetentionOutcome.Rule]
        SESSIONS: _ClassVar[RetentionOutcome.Rule]
        BEST_SUBMAPS: _ClassVar[RetentionOutcome.Rule]
        SCANS: _ClassVar[RetentionOutcome.Rule]
        REJECTED_LOOPS: _ClassVar[RetentionOutcome.Rule]
        RETIRED_MAPS: _ClassVar[RetentionOutcome.Rule]
    RULE_UNSPECIFIED: RetentionOutcome.Rule
    SESSIONS: RetentionOutcome.Rule
    BEST_SUBMAPS: RetentionOutcome.Rule
    SCANS: RetentionOutcome.Rule
    REJECTED_LOOPS: RetentionOutcome.Rule
    RETIRED_MAPS: RetentionOutcome.Rule
    RULE_FIELD_NUMBER: _ClassVar[int]
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_FIELD_NUMBER: _ClassVar[int]
    SCANS_FIELD_NUMBER: _ClassVar[int]
    LOOP_CLOSURES_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    rule: RetentionOutcome.Rule
    sessions: int
    submaps: int
    scans: int
    loop_closures: int
    bytes: int
    def __init__(self, rule: _Optional[_Union[RetentionOutcome.Rule, str]] = ..., sessions: _Optional[int] = ..., submaps: _Optional[int] = ..., scans: _Optional[int] = ..., loop_closures: _Optional[int] = ..., bytes: _Optional[int] = ...) -> None: ...

class RetentionReport(_message.Message):
    __slots__ = ("at_ns", "rules", "submaps_held", "sessions_held", "bytes_estimated")
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    RULES_FIELD_NUMBER: _ClassVar[int]
    SUBMAPS_HELD_FIELD_NUMBER: _ClassVar[int]
    SESSIONS_HELD_FIELD_NUMBER: _ClassVar[int]
    BYTES_ESTIMATED_FIELD_NUMBER: _ClassVar[int]
    at_ns: int
    rules: _containers.RepeatedCompositeFieldContainer[RetentionOutcome]
    submaps_held: int
    sessions_held: int
    bytes_estimated: bool
    def __init__(self, at_ns: _Optional[int] = ..., rules: _Optional[_Iterable[_Union[RetentionOutcome, _Mapping]]] = ..., submaps_held: _Optional[int] = ..., sessions_held: _Optional[int] = ..., bytes_estimated: _Optional[bool] = ...) -> None: ...

class MapRetention(_message.Message):
    __slots__ = ("map", "policy", "own", "redescription", "last_run")
    class Redescription(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        REDESCRIPTION_UNSPECIFIED: _ClassVar[MapRetention.Redescription]
        FROM_SCANS: _ClassVar[MapRetention.Redescription]
        FROM_NEURAL_MAPS: _ClassVar[MapRetention.Redescription]
    REDESCRIPTION_UNSPECIFIED: MapRetention.Redescription
    FROM_SCANS: MapRetention.Redescription
    FROM_NEURAL_MAPS: MapRetention.Redescription
    MAP_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    OWN_FIELD_NUMBER: _ClassVar[int]
    REDESCRIPTION_FIELD_NUMBER: _ClassVar[int]
    LAST_RUN_FIELD_NUMBER: _ClassVar[int]
    map: str
    policy: RetentionPolicy
    own: bool
    redescription: MapRetention.Redescription
    last_run: RetentionReport
    def __init__(self, map: _Optional[str] = ..., policy: _Optional[_Union[RetentionPolicy, _Mapping]] = ..., own: _Optional[bool] = ..., redescription: _Optional[_Union[MapRetention.Redescription, str]] = ..., last_run: _Optional[_Union[RetentionReport, _Mapping]] = ...) -> None: ...

class GetRetentionRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetRetentionResponse(_message.Message):
    __slots__ = ("retention",)
    RETENTION_FIELD_NUMBER: _ClassVar[int]
    retention: MapRetention
    def __init__(self, retention: _Optional[_Union[MapRetention, _Mapping]] = ...) -> None: ...

class SetRetentionRequest(_message.Message):
    __slots__ = ("name", "policy")
    NAME_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    name: str
    policy: RetentionPolicy
    def __init__(self, name: _Optional[str] = ..., policy: _Optional[_Union[RetentionPolicy, _Mapping]] = ...) -> None: ...

class SetRetentionResponse(_message.Message):
    __slots__ = ("retention",)
    RETENTION_FIELD_NUMBER: _ClassVar[int]
    retention: MapRetention
    def __init__(self, retention: _Optional[_Union[MapRetention, _Mapping]] = ...) -> None: ...

class PreviewRetentionRequest(_message.Message):
    __slots__ = ("name", "policy")
    NAME_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    name: str
    policy: RetentionPolicy
    def __init__(self, name: _Optional[str] = ..., policy: _Optional[_Union[RetentionPolicy, _Mapping]] = ...) -> None: ...

class PreviewRetentionResponse(_message.Message):
    __slots__ = ("report",)
    REPORT_FIELD_NUMBER: _ClassVar[int]
    report: RetentionReport
    def __init__(self, report: _Optional[_Union[RetentionReport, _Mapping]] = ...) -> None: ...
