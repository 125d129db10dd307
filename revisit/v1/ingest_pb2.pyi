from revisit.v1 import cloud_pb2 as _cloud_pb2
from revisit.v1 import geometry_pb2 as _geometry_pb2
from revisit.v1 import loop_closure_pb2 as _loop_closure_pb2
from revisit.v1 import submap_pb2 as _submap_pb2
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class StreamScansRequest(_message.Message):
    __slots__ = ("open", "scan", "pose")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    open: Open
    scan: Scan
    pose: Pose
    def __init__(self, open: _Optional[_Union[Open, _Mapping]] = ..., scan: _Optional[_Union[Scan, _Mapping]] = ..., pose: _Optional[_Union[Pose, _Mapping]] = ...) -> None: ...

class Open(_message.Message):
    __slots__ = ("session", "watch_loop_closures", "loop_closures_after", "resume_token", "acknowledged_seq")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    WATCH_LOOP_CLOSURES_FIELD_NUMBER: _ClassVar[int]
    LOOP_CLOSURES_AFTER_FIELD_NUMBER: _ClassVar[int]
    RESUME_TOKEN_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_SEQ_FIELD_NUMBER: _ClassVar[int]
    session: str
    watch_loop_closures: bool
    loop_closures_after: int
    resume_token: str
    acknowledged_seq: int
    def __init__(self, session: _Optional[str] = ..., watch_loop_closures: _Optional[bool] = ..., loop_closures_after: _Optional[int] = ..., resume_token: _Optional[str] = ..., acknowledged_seq: _Optional[int] = ...) -> None: ...

class Scan(_message.Message):
    __slots__ = ("seq", "stamp_ns", "t_odom_sensor", "cloud", "travelled_m")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_SENSOR_FIELD_NUMBER: _ClassVar[int]
    CLOUD_FIELD_NUMBER: _ClassVar[int]
    TRAVELLED_M_FIELD_NUMBER: _ClassVar[int]
    seq: int
    stamp_ns: int
    t_odom_sensor: _geometry_pb2.Transform
    cloud: _cloud_pb2.Cloud
    travelled_m: float
    def __init__(self, seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., t_odom_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., cloud: _Optional[_Union[_cloud_pb2.Cloud, _Mapping]] = ..., travelled_m: _Optional[float] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("stamp_ns", "t_odom_sensor")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_SENSOR_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    t_odom_sensor: _geometry_pb2.Transform
    def __init__(self, stamp_ns: _Optional[int] = ..., t_odom_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ...) -> None: ...

class ScanMarks(_message.Message):
    __slots__ = ("tau_m", "least_per_tau", "enough_returns", "turn_rad", "least_step_m")
    TAU_M_FIELD_NUMBER: _ClassVar[int]
    LEAST_PER_TAU_FIELD_NUMBER: _ClassVar[int]
    ENOUGH_RETURNS_FIELD_NUMBER: _ClassVar[int]
    TURN_RAD_FIELD_NUMBER: _ClassVar[int]
    LEAST_STEP_M_FIELD_NUMBER: _ClassVar[int]
    tau_m: float
    least_per_tau: int
    enough_returns: int
    turn_rad: float
    least_step_m: float
    def __init__(self, tau_m: _Optional[float] = ..., least_per_tau: _Optional[int] = ..., enough_returns: _Optional[int] = ..., turn_rad: _Optional[float] = ..., least_step_m: _Optional[float] = ...) -> None: ...

class StreamScansResponse(_message.Message):
    __slots__ = ("opened", "ack", "nack", "submap_finished", "loop_closed", "throttle", "drain")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    NACK_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_FINISHED_FIELD_NUMBER: _ClassVar[int]
    LOOP_CLOSED_FIELD_NUMBER: _ClassVar[int]
    THROTTLE_FIELD_NUMBER: _ClassVar[int]
    DRAIN_FIELD_NUMBER: _ClassVar[int]
    opened: Opened
    ack: Ack
    nack: Nack
    submap_finished: SubmapFinished
    loop_closed: LoopClosed
    throttle: Throttle
    drain: Drain
    def __init__(self, opened: _Optional[_Union[Opened, _Mapping]] = ..., ack: _Optional[_Union[Ack, _Mapping]] = ..., nack: _Optional[_Union[Nack, _Mapping]] = ..., submap_finished: _Optional[_Union[SubmapFinished, _Mapping]] = ..., loop_closed: _Optional[_Union[LoopClosed, _Mapping]] = ..., throttle: _Optional[_Union[Throttle, _Mapping]] = ..., drain: _Optional[_Union[Drain, _Mapping]] = ...) -> None: ...

class Opened(_message.Message):
    __slots__ = ("committed_seq", "credits", "window_bytes", "resume_token", "marks", "travelled_m", "t_odom_sensor")
    COMMITTED_SEQ_FIELD_NUMBER: _ClassVar[int]
    CREDITS_FIELD_NUMBER: _ClassVar[int]
    WINDOW_BYTES_FIELD_NUMBER: _ClassVar[int]
    RESUME_TOKEN_FIELD_NUMBER: _ClassVar[int]
    MARKS_FIELD_NUMBER: _ClassVar[int]
    TRAVELLED_M_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_SENSOR_FIELD_NUMBER: _ClassVar[int]
    committed_seq: int
    credits: int
    window_bytes: int
    resume_token: str
    marks: ScanMarks
    travelled_m: float
    t_odom_sensor: _geometry_pb2.Transform
    def __init__(self, committed_seq: _Optional[int] = ..., credits: _Optional[int] = ..., window_bytes: _Optional[int] = ..., resume_token: _Optional[str] = ..., marks: _Optional[_Union[ScanMarks, _Mapping]] = ..., travelled_m: _Optional[float] = ..., t_odom_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ...) -> None: ...

class Ack(_message.Message):
    __slots__ = ("committed_seq", "credits", "submap_seq", "left_out")
    COMMITTED_SEQ_FIELD_NUMBER: _ClassVar[int]
    CREDITS_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_SEQ_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    committed_seq: int
    credits: int
    submap_seq: int
    left_out: bool
    def __init__(self, committed_seq: _Optional[int] = ..., credits: _Optional[int] = ..., submap_seq: _Optional[int] = ..., left_out: _Optional[bool] = ...) -> None: ...

class Nack(_message.Message):
    __slots__ = ("seq", "reason", "retryable", "message", "expected_seq", "credits")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    RETRYABLE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_SEQ_FIELD_NUMBER: _ClassVar[int]
    CREDITS_FIELD_NUMBER: _ClassVar[int]
    seq: int
    reason: str
    retryable: bool
    message: str
    expected_seq: int
    credits: int
    def __init__(self, seq: _Optional[int] = ..., reason: _Optional[str] = ..., retryable: _Optional[bool] = ..., message: _Optional[str] = ..., expected_seq: _Optional[int] = ..., credits: _Optional[int] = ...) -> None: ...

class SubmapFinished(_message.Message):
    __slots__ = ("name", "operation")
    NAME_FIELD_NUMBER: _ClassVar[int]
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    name: str
    operation: str
    def __init__(self, name: _Optional[str] = ..., operation: _Optional[str] = ...) -> None: ...

class LoopClosed(_message.Message):
    __slots__ = ("loop_closure",)
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    loop_closure: _loop_closure_pb2.LoopClosure
    def __init__(self, loop_closure: _Optional[_Union[_loop_closure_pb2.LoopClosure, _Mapping]] = ...) -> None: ...

class AppendScanResponse(_message.Message):
    __slots__ = ("committed_seq", "replay", "report", "submap", "left_out")
    COMMITTED_SEQ_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    REPORT_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    committed_seq: int
    replay: bool
    report: _cloud_pb2.CloudReport
    submap: _submap_pb2.PostSubmapResponse
    left_out: bool
    def __init__(self, committed_seq: _Optional[int] = ..., replay: _Optional[bool] = ..., report: _Optional[_Union[_cloud_pb2.CloudReport, _Mapping]] = ..., submap: _Optional[_Union[_submap_pb2.PostSubmapResponse, _Mapping]] = ..., left_out: _Optional[bool] = ...) -> None: ...

class Throttle(_message.Message):
    __slots__ = ("retry_delay_s",)
    RETRY_DELAY_S_FIELD_NUMBER: _ClassVar[int]
    retry_delay_s: float
    def __init__(self, retry_delay_s: _Optional[float] = ...) -> None: ...

class Drain(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
