from revisit.v1 import geometry_pb2 as _geometry_pb2
from revisit.v1 import operation_pb2 as _operation_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GeodeticPosition(_message.Message):
    __slots__ = ("latitude_deg", "longitude_deg", "altitude_m")
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    def __init__(self, latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., altitude_m: _Optional[float] = ...) -> None: ...

class Anchor(_message.Message):
    __slots__ = ("name", "kind", "stamp_ns", "geodetic", "local_m", "covariance_enu", "offset_m", "t_odom_sensor", "heading_rad", "heading_sigma_rad", "state", "reason", "residual_m", "created_at_ns", "tag")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        KIND_UNSPECIFIED: _ClassVar[Anchor.Kind]
        GNSS: _ClassVar[Anchor.Kind]
        CONTROL_POINT: _ClassVar[Anchor.Kind]
        KNOWN_POSE: _ClassVar[Anchor.Kind]
        FIDUCIAL: _ClassVar[Anchor.Kind]
    KIND_UNSPECIFIED: Anchor.Kind
    GNSS: Anchor.Kind
    CONTROL_POINT: Anchor.Kind
    KNOWN_POSE: Anchor.Kind
    FIDUCIAL: Anchor.Kind
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATE_UNSPECIFIED: _ClassVar[Anchor.State]
        IN_MAP: _ClassVar[Anchor.State]
        SET_ASIDE: _ClassVar[Anchor.State]
        NOT_ALIGNED: _ClassVar[Anchor.State]
    STATE_UNSPECIFIED: Anchor.State
    IN_MAP: Anchor.State
    SET_ASIDE: Anchor.State
    NOT_ALIGNED: Anchor.State
    NAME_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    GEODETIC_FIELD_NUMBER: _ClassVar[int]
    LOCAL_M_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_ENU_FIELD_NUMBER: _ClassVar[int]
    OFFSET_M_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_SENSOR_FIELD_NUMBER: _ClassVar[int]
    HEADING_RAD_FIELD_NUMBER: _ClassVar[int]
    HEADING_SIGMA_RAD_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_M_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    TAG_FIELD_NUMBER: _ClassVar[int]
    name: str
    kind: Anchor.Kind
    stamp_ns: int
    geodetic: GeodeticPosition
    local_m: _geometry_pb2.Vector3
    covariance_enu: _containers.RepeatedScalarFieldContainer[float]
    offset_m: _geometry_pb2.Vector3
    t_odom_sensor: _geometry_pb2.Transform
    heading_rad: float
    heading_sigma_rad: float
    state: Anchor.State
    reason: str
    residual_m: _geometry_pb2.Vector3
    created_at_ns: int
    tag: str
    def __init__(self, name: _Optional[str] = ..., kind: _Optional[_Union[Anchor.Kind, str]] = ..., stamp_ns: _Optional[int] = ..., geodetic: _Optional[_Union[GeodeticPosition, _Mapping]] = ..., local_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., covariance_enu: _Optional[_Iterable[float]] = ..., offset_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., t_odom_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., heading_rad: _Optional[float] = ..., heading_sigma_rad: _Optional[float] = ..., state: _Optional[_Union[Anchor.State, str]] = ..., reason: _Optional[str] = ..., residual_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., created_at_ns: _Optional[int] = ..., tag: _Optional[str] = ...) -> None: ...

class NewAnchor(_message.Message):
    __slots__ = ("anchor_id", "kind", "stamp_ns", "geodetic", "local_m", "covariance_enu", "offset_m", "t_odom_sensor", "heading_rad", "heading_sigma_rad", "tag")
    ANCHOR_ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    GEODETIC_FIELD_NUMBER: _ClassVar[int]
    LOCAL_M_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_ENU_FIELD_NUMBER: _ClassVar[int]
    OFFSET_M_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_SENSOR_FIELD_NUMBER: _ClassVar[int]
    HEADING_RAD_FIELD_NUMBER: _ClassVar[int]
    HEADING_SIGMA_RAD_FIELD_NUMBER: _ClassVar[int]
    TAG_FIELD_NUMBER: _ClassVar[int]
    anchor_id: str
    kind: Anchor.Kind
    stamp_ns: int
    geodetic: GeodeticPosition
    local_m: _geometry_pb2.Vector3
    covariance_enu: _containers.RepeatedScalarFieldContainer[float]
    offset_m: _geometry_pb2.Vector3
    t_odom_sensor: _geometry_pb2.Transform
    heading_rad: float
    heading_sigma_rad: float
    tag: str
    def __init__(self, anchor_id: _Optional[str] = ..., kind: _Optional[_Union[Anchor.Kind, str]] = ..., stamp_ns: _Optional[int] = ..., geodetic: _Optional[_Union[GeodeticPosition, _Mapping]] = ..., local_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., covariance_enu: _Optional[_Iterable[float]] = ..., offset_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., t_odom_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., heading_rad: _Optional[float] = ..., heading_sigma_rad: _Optional[float] = ..., tag: _Optional[str] = ...) -> None: ...

class Georeference(_message.Message):
    __slots__ = ("frame", "t_enu_map", "covariance", "anchors", "of_anchors", "residual_m", "sessions")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    T_ENU_MAP_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    OF_ANCHORS_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_M_FIELD_NUMBER: _ClassVar[int]
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    frame: str
    t_enu_map: _geometry_pb2.Transform
    covariance: _containers.RepeatedScalarFieldContainer[float]
    anchors: int
    of_anchors: int
    residual_m: float
    sessions: _containers.RepeatedCompositeFieldContainer[AnchoredSession]
    def __init__(self, frame: _Optional[str] = ..., t_enu_map: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., anchors: _Optional[int] = ..., of_anchors: _Optional[int] = ..., residual_m: _Optional[float] = ..., sessions: _Optional[_Iterable[_Union[AnchoredSession, _Mapping]]] = ...) -> None: ...

class AnchoredSession(_message.Message):
    __slots__ = ("session", "anchors", "of_anchors", "offset_m", "sigma_factor", "elsewhere")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    OF_ANCHORS_FIELD_NUMBER: _ClassVar[int]
    OFFSET_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_FACTOR_FIELD_NUMBER: _ClassVar[int]
    ELSEWHERE_FIELD_NUMBER: _ClassVar[int]
    session: str
    anchors: int
    of_anchors: int
    offset_m: _geometry_pb2.Vector3
    sigma_factor: float
    elsewhere: bool
    def __init__(self, session: _Optional[str] = ..., anchors: _Optional[int] = ..., of_anchors: _Optional[int] = ..., offset_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., sigma_factor: _Optional[float] = ..., elsewhere: _Optional[bool] = ...) -> None: ...

class PostAnchorsRequest(_message.Message):
    __slots__ = ("parent", "anchors")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    parent: str
    anchors: _containers.RepeatedCompositeFieldContainer[NewAnchor]
    def __init__(self, parent: _Optional[str] = ..., anchors: _Optional[_Iterable[_Union[NewAnchor, _Mapping]]] = ...) -> None: ...

class PostAnchorsResponse(_message.Message):
    __slots__ = ("anchors",)
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    anchors: _containers.RepeatedCompositeFieldContainer[Anchor]
    def __init__(self, anchors: _Optional[_Iterable[_Union[Anchor, _Mapping]]] = ...) -> None: ...

class PreviewAnchorsRequest(_message.Message):
    __slots__ = ("parent", "anchors")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    parent: str
    anchors: _containers.RepeatedCompositeFieldContainer[NewAnchor]
    def __init__(self, parent: _Optional[str] = ..., anchors: _Optional[_Iterable[_Union[NewAnchor, _Mapping]]] = ...) -> None: ...

class PreviewAnchorsResponse(_message.Message):
    __slots__ = ("operation", "replay")
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    operation: _operation_pb2.Operation
    replay: bool
    def __init__(self, operation: _Optional[_Union[_operation_pb2.Operation, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class ListAnchorsRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListAnchorsResponse(_message.Message):
    __slots__ = ("anchors", "next_page_token")
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    anchors: _containers.RepeatedCompositeFieldContainer[Anchor]
    next_page_token: str
    def __init__(self, anchors: _Optional[_Iterable[_Union[Anchor, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class DeleteAnchorRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DeleteAnchorResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
