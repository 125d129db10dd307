from google.protobuf import struct_pb2 as _struct_pb2
from revisit.v1 import cloud_pb2 as _cloud_pb2
from revisit.v1 import geometry_pb2 as _geometry_pb2
from revisit.v1 import operation_pb2 as _operation_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class LoopClosure(_message.Message):
    __slots__ = ("name", "number", "query", "match", "state", "reason", "similarity", "score", "t_match_query", "evidence", "created_at_ns", "graph_state", "t_map_query", "t_map_match", "frame", "map_version", "manual")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATE_UNSPECIFIED: _ClassVar[LoopClosure.State]
        ACCEPTED: _ClassVar[LoopClosure.State]
        REJECTED: _ClassVar[LoopClosure.State]
        PROPOSED: _ClassVar[LoopClosure.State]
    STATE_UNSPECIFIED: LoopClosure.State
    ACCEPTED: LoopClosure.State
    REJECTED: LoopClosure.State
    PROPOSED: LoopClosure.State
    class GraphState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        GRAPH_STATE_UNSPECIFIED: _ClassVar[LoopClosure.GraphState]
        IN_MAP: _ClassVar[LoopClosure.GraphState]
        SET_ASIDE: _ClassVar[LoopClosure.GraphState]
        UNCONNECTED: _ClassVar[LoopClosure.GraphState]
    GRAPH_STATE_UNSPECIFIED: LoopClosure.GraphState
    IN_MAP: LoopClosure.GraphState
    SET_ASIDE: LoopClosure.GraphState
    UNCONNECTED: LoopClosure.GraphState
    NAME_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    QUERY_FIELD_NUMBER: _ClassVar[int]
    MATCH_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    SIMILARITY_FIELD_NUMBER: _ClassVar[int]
    SCORE_FIELD_NUMBER: _ClassVar[int]
    T_MATCH_QUERY_FIELD_NUMBER: _ClassVar[int]
    EVIDENCE_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    GRAPH_STATE_FIELD_NUMBER: _ClassVar[int]
    T_MAP_QUERY_FIELD_NUMBER: _ClassVar[int]
    T_MAP_MATCH_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    MANUAL_FIELD_NUMBER: _ClassVar[int]
    name: str
    number: int
    query: str
    match: str
    state: LoopClosure.State
    reason: str
    similarity: float
    score: float
    t_match_query: _geometry_pb2.Transform
    evidence: _struct_pb2.Struct
    created_at_ns: int
    graph_state: LoopClosure.GraphState
    t_map_query: _geometry_pb2.Transform
    t_map_match: _geometry_pb2.Transform
    frame: str
    map_version: int
    manual: bool
    def __init__(self, name: _Optional[str] = ..., number: _Optional[int] = ..., query: _Optional[str] = ..., match: _Optional[str] = ..., state: _Optional[_Union[LoopClosure.State, str]] = ..., reason: _Optional[str] = ..., similarity: _Optional[float] = ..., score: _Optional[float] = ..., t_match_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., evidence: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., created_at_ns: _Optional[int] = ..., graph_state: _Optional[_Union[LoopClosure.GraphState, str]] = ..., t_map_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., t_map_match: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., frame: _Optional[str] = ..., map_version: _Optional[int] = ..., manual: _Optional[bool] = ...) -> None: ...

class Descriptor(_message.Message):
    __slots__ = ("vector", "model_version")
    VECTOR_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    vector: _containers.RepeatedScalarFieldContainer[float]
    model_version: str
    def __init__(self, vector: _Optional[_Iterable[float]] = ..., model_version: _Optional[str] = ...) -> None: ...

class SearchSubmapsRequest(_message.Message):
    __slots__ = ("parent", "submap", "place_descriptor", "cloud", "k", "min_similarity", "exclude_session", "only_session", "prior_position_m", "radius_m", "min_seq", "min_seq_timeout_s", "t_level_query", "storey", "leave_distance_m")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    PLACE_DESCRIPTOR_FIELD_NUMBER: _ClassVar[int]
    CLOUD_FIELD_NUMBER: _ClassVar[int]
    K_FIELD_NUMBER: _ClassVar[int]
    MIN_SIMILARITY_FIELD_NUMBER: _ClassVar[int]
    EXCLUDE_SESSION_FIELD_NUMBER: _ClassVar[int]
    ONLY_SESSION_FIELD_NUMBER: _ClassVar[int]
    PRIOR_POSITION_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    MIN_SEQ_FIELD_NUMBER: _ClassVar[int]
    MIN_SEQ_TIMEOUT_S_FIELD_NUMBER: _ClassVar[int]
    T_LEVEL_QUERY_FIELD_NUMBER: _ClassVar[int]
    STOREY_FIELD_NUMBER: _ClassVar[int]
    LEAVE_DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    parent: str
    submap: str
    place_descriptor: Descriptor
    cloud: _cloud_pb2.Cloud
    k: int
    min_similarity: float
    exclude_session: str
    only_session: str
    prior_position_m: _geometry_pb2.Vector3
    radius_m: float
    min_seq: int
    min_seq_timeout_s: float
    t_level_query: _geometry_pb2.Transform
    storey: str
    leave_distance_m: float
    def __init__(self, parent: _Optional[str] = ..., submap: _Optional[str] = ..., place_descriptor: _Optional[_Union[Descriptor, _Mapping]] = ..., cloud: _Optional[_Union[_cloud_pb2.Cloud, _Mapping]] = ..., k: _Optional[int] = ..., min_similarity: _Optional[float] = ..., exclude_session: _Optional[str] = ..., only_session: _Optional[str] = ..., prior_position_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., radius_m: _Optional[float] = ..., min_seq: _Optional[int] = ..., min_seq_timeout_s: _Optional[float] = ..., t_level_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., storey: _Optional[str] = ..., leave_distance_m: _Optional[float] = ...) -> None: ...

class SearchHit(_message.Message):
    __slots__ = ("submap", "similarity", "position_m", "t_map_submap", "frame", "map_version")
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    SIMILARITY_FIELD_NUMBER: _ClassVar[int]
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    T_MAP_SUBMAP_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    submap: str
    similarity: float
    position_m: _geometry_pb2.Vector3
    t_map_submap: _geometry_pb2.Transform
    frame: str
    map_version: int
    def __init__(self, submap: _Optional[str] = ..., similarity: _Optional[float] = ..., position_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., t_map_submap: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., frame: _Optional[str] = ..., map_version: _Optional[int] = ...) -> None: ...

class SearchSubmapsResponse(_message.Message):
    __slots__ = ("hits", "searched", "on_other_storeys")
    HITS_FIELD_NUMBER: _ClassVar[int]
    SEARCHED_FIELD_NUMBER: _ClassVar[int]
    ON_OTHER_STOREYS_FIELD_NUMBER: _ClassVar[int]
    hits: _containers.RepeatedCompositeFieldContainer[SearchHit]
    searched: int
    on_other_storeys: int
    def __init__(self, hits: _Optional[_Iterable[_Union[SearchHit, _Mapping]]] = ..., searched: _Optional[int] = ..., on_other_storeys: _Optional[int] = ...) -> None: ...

class LocalizeRequest(_message.Message):
    __slots__ = ("parent", "cloud", "prior_position_m", "radius_m", "candidates", "min_seq", "min_seq_timeout_s", "exclude_session", "t_level_query", "only_session", "storey")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    CLOUD_FIELD_NUMBER: _ClassVar[int]
    PRIOR_POSITION_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    MIN_SEQ_FIELD_NUMBER: _ClassVar[int]
    MIN_SEQ_TIMEOUT_S_FIELD_NUMBER: _ClassVar[int]
    EXCLUDE_SESSION_FIELD_NUMBER: _ClassVar[int]
    T_LEVEL_QUERY_FIELD_NUMBER: _ClassVar[int]
    ONLY_SESSION_FIELD_NUMBER: _ClassVar[int]
    STOREY_FIELD_NUMBER: _ClassVar[int]
    parent: str
    cloud: _cloud_pb2.Cloud
    prior_position_m: _geometry_pb2.Vector3
    radius_m: float
    candidates: int
    min_seq: int
    min_seq_timeout_s: float
    exclude_session: str
    t_level_query: _geometry_pb2.Transform
    only_session: str
    storey: str
    def __init__(self, parent: _Optional[str] = ..., cloud: _Optional[_Union[_cloud_pb2.Cloud, _Mapping]] = ..., prior_position_m: _Optional[_Union[_geometry_pb2.Vector3, _Mapping]] = ..., radius_m: _Optional[float] = ..., candidates: _Optional[int] = ..., min_seq: _Optional[int] = ..., min_seq_timeout_s: _Optional[float] = ..., exclude_session: _Optional[str] = ..., t_level_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., only_session: _Optional[str] = ..., storey: _Optional[str] = ...) -> None: ...

class LocalizedCandidate(_message.Message):
    __slots__ = ("submap", "accepted", "reason", "similarity", "score", "t_match_query", "evidence")
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    SIMILARITY_FIELD_NUMBER: _ClassVar[int]
    SCORE_FIELD_NUMBER: _ClassVar[int]
    T_MATCH_QUERY_FIELD_NUMBER: _ClassVar[int]
    EVIDENCE_FIELD_NUMBER: _ClassVar[int]
    submap: str
    accepted: bool
    reason: str
    similarity: float
    score: float
    t_match_query: _geometry_pb2.Transform
    evidence: _struct_pb2.Struct
    def __init__(self, submap: _Optional[str] = ..., accepted: _Optional[bool] = ..., reason: _Optional[str] = ..., similarity: _Optional[float] = ..., score: _Optional[float] = ..., t_match_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., evidence: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ...) -> None: ...

class LocalizeResponse(_message.Message):
    __slots__ = ("best", "candidates", "t_odom_query", "session", "t_map_query", "frame", "map_version", "on_other_storeys")
    BEST_FIELD_NUMBER: _ClassVar[int]
    CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    T_ODOM_QUERY_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    T_MAP_QUERY_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    ON_OTHER_STOREYS_FIELD_NUMBER: _ClassVar[int]
    best: LocalizedCandidate
    candidates: _containers.RepeatedCompositeFieldContainer[LocalizedCandidate]
    t_odom_query: _geometry_pb2.Transform
    session: str
    t_map_query: _geometry_pb2.Transform
    frame: str
    map_version: int
    on_other_storeys: int
    def __init__(self, best: _Optional[_Union[LocalizedCandidate, _Mapping]] = ..., candidates: _Optional[_Iterable[_Union[LocalizedCandidate, _Mapping]]] = ..., t_odom_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., session: _Optional[str] = ..., t_map_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., frame: _Optional[str] = ..., map_version: _Optional[int] = ..., on_other_storeys: _Optional[int] = ...) -> None: ...

class RelocaliseRequest(_message.Message):
    __slots__ = ("open", "scan")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    open: RelocaliseOpen
    scan: RelocaliseScan
    def __init__(self, open: _Optional[_Union[RelocaliseOpen, _Mapping]] = ..., scan: _Optional[_Union[RelocaliseScan, _Mapping]] = ...) -> None: ...

class RelocaliseOpen(_message.Message):
    __slots__ = ("parent", "storey", "only_session", "exclude_session")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    STOREY_FIELD_NUMBER: _ClassVar[int]
    ONLY_SESSION_FIELD_NUMBER: _ClassVar[int]
    EXCLUDE_SESSION_FIELD_NUMBER: _ClassVar[int]
    parent: str
    storey: str
    only_session: str
    exclude_session: str
    def __init__(self, parent: _Optional[str] = ..., storey: _Optional[str] = ..., only_session: _Optional[str] = ..., exclude_session: _Optional[str] = ...) -> None: ...

class RelocaliseScan(_message.Message):
    __slots__ = ("t_odom_sensor", "cloud")
    T_ODOM_SENSOR_FIELD_NUMBER: _ClassVar[int]
    CLOUD_FIELD_NUMBER: _ClassVar[int]
    t_odom_sensor: _geometry_pb2.Transform
    cloud: _cloud_pb2.Cloud
    def __init__(self, t_odom_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., cloud: _Optional[_Union[_cloud_pb2.Cloud, _Mapping]] = ...) -> None: ...

class RelocaliseResponse(_message.Message):
    __slots__ = ("answer", "refusal")
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    answer: RelocaliseAnswer
    refusal: RelocaliseRefusal
    def __init__(self, answer: _Optional[_Union[RelocaliseAnswer, _Mapping]] = ..., refusal: _Optional[_Union[RelocaliseRefusal, _Mapping]] = ...) -> None: ...

class RelocaliseAnswer(_message.Message):
    __slots__ = ("state", "reason", "poses", "none_of_them", "travelled_m", "tells_apart", "on_other_storeys")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATE_UNSPECIFIED: _ClassVar[RelocaliseAnswer.State]
        PLACED: _ClassVar[RelocaliseAnswer.State]
        SEVERAL: _ClassVar[RelocaliseAnswer.State]
        UNKNOWN: _ClassVar[RelocaliseAnswer.State]
    STATE_UNSPECIFIED: RelocaliseAnswer.State
    PLACED: RelocaliseAnswer.State
    SEVERAL: RelocaliseAnswer.State
    UNKNOWN: RelocaliseAnswer.State
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    NONE_OF_THEM_FIELD_NUMBER: _ClassVar[int]
    TRAVELLED_M_FIELD_NUMBER: _ClassVar[int]
    TELLS_APART_FIELD_NUMBER: _ClassVar[int]
    ON_OTHER_STOREYS_FIELD_NUMBER: _ClassVar[int]
    state: RelocaliseAnswer.State
    reason: str
    poses: _containers.RepeatedCompositeFieldContainer[RelocalisedPose]
    none_of_them: float
    travelled_m: float
    tells_apart: RelocaliseDrive
    on_other_storeys: int
    def __init__(self, state: _Optional[_Union[RelocaliseAnswer.State, str]] = ..., reason: _Optional[str] = ..., poses: _Optional[_Iterable[_Union[RelocalisedPose, _Mapping]]] = ..., none_of_them: _Optional[float] = ..., travelled_m: _Optional[float] = ..., tells_apart: _Optional[_Union[RelocaliseDrive, _Mapping]] = ..., on_other_storeys: _Optional[int] = ...) -> None: ...

class RelocalisedPose(_message.Message):
    __slots__ = ("t_map_sensor", "frame", "map_version", "t_session_sensor", "session", "covariance", "probability", "views", "accepted", "along_m")
    T_MAP_SENSOR_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    T_SESSION_SENSOR_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    ALONG_M_FIELD_NUMBER: _ClassVar[int]
    t_map_sensor: _geometry_pb2.Transform
    frame: str
    map_version: int
    t_session_sensor: _geometry_pb2.Transform
    session: str
    covariance: _containers.RepeatedScalarFieldContainer[float]
    probability: float
    views: int
    accepted: int
    along_m: float
    def __init__(self, t_map_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., frame: _Optional[str] = ..., map_version: _Optional[int] = ..., t_session_sensor: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., session: _Optional[str] = ..., covariance: _Optional[_Iterable[float]] = ..., probability: _Optional[float] = ..., views: _Optional[int] = ..., accepted: _Optional[int] = ..., along_m: _Optional[float] = ...) -> None: ...

class RelocaliseDrive(_message.Message):
    __slots__ = ("direction_rad", "distance_m", "difference")
    DIRECTION_RAD_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    DIFFERENCE_FIELD_NUMBER: _ClassVar[int]
    direction_rad: float
    distance_m: float
    difference: float
    def __init__(self, direction_rad: _Optional[float] = ..., distance_m: _Optional[float] = ..., difference: _Optional[float] = ...) -> None: ...

class RelocaliseRefusal(_message.Message):
    __slots__ = ("code", "reason", "retryable", "message", "retry_delay_s")
    CODE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    RETRYABLE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    RETRY_DELAY_S_FIELD_NUMBER: _ClassVar[int]
    code: str
    reason: str
    retryable: bool
    message: str
    retry_delay_s: float
    def __init__(self, code: _Optional[str] = ..., reason: _Optional[str] = ..., retryable: _Optional[bool] = ..., message: _Optional[str] = ..., retry_delay_s: _Optional[float] = ...) -> None: ...

class GetLoopClosureRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetLoopClosureResponse(_message.Message):
    __slots__ = ("loop_closure",)
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    loop_closure: LoopClosure
    def __init__(self, loop_closure: _Optional[_Union[LoopClosure, _Mapping]] = ...) -> None: ...

class ListLoopClosuresRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token", "state", "session", "min_seq", "min_seq_timeout_s", "graph_state", "reason")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    MIN_SEQ_FIELD_NUMBER: _ClassVar[int]
    MIN_SEQ_TIMEOUT_S_FIELD_NUMBER: _ClassVar[int]
    GRAPH_STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    state: LoopClosure.State
    session: str
    min_seq: int
    min_seq_timeout_s: float
    graph_state: LoopClosure.GraphState
    reason: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., state: _Optional[_Union[LoopClosure.State, str]] = ..., session: _Optional[str] = ..., min_seq: _Optional[int] = ..., min_seq_timeout_s: _Optional[float] = ..., graph_state: _Optional[_Union[LoopClosure.GraphState, str]] = ..., reason: _Optional[str] = ...) -> None: ...

class ListLoopClosuresResponse(_message.Message):
    __slots__ = ("loop_closures", "next_page_token")
    LOOP_CLOSURES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    loop_closures: _containers.RepeatedCompositeFieldContainer[LoopClosure]
    next_page_token: str
    def __init__(self, loop_closures: _Optional[_Iterable[_Union[LoopClosure, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class WatchLoopClosuresRequest(_message.Message):
    __slots__ = ("parent", "after", "session")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    parent: str
    after: int
    session: str
    def __init__(self, parent: _Optional[str] = ..., after: _Optional[int] = ..., session: _Optional[str] = ...) -> None: ...

class WatchLoopClosuresResponse(_message.Message):
    __slots__ = ("loop_closure",)
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    loop_closure: LoopClosure
    def __init__(self, loop_closure: _Optional[_Union[LoopClosure, _Mapping]] = ...) -> None: ...

class LoopClosureEvent(_message.Message):
    __slots__ = ("number", "kind", "state", "reason", "graph_state", "t_match_query", "actor", "note", "map_version", "details", "at_ns")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        KIND_UNSPECIFIED: _ClassVar[LoopClosureEvent.Kind]
        VERIFIED: _ClassVar[LoopClosureEvent.Kind]
        PROPOSED: _ClassVar[LoopClosureEvent.Kind]
        ACCEPTED: _ClassVar[LoopClosureEvent.Kind]
        REJECTED: _ClassVar[LoopClosureEvent.Kind]
        REVERTED: _ClassVar[LoopClosureEvent.Kind]
        JUDGED: _ClassVar[LoopClosureEvent.Kind]
    KIND_UNSPECIFIED: LoopClosureEvent.Kind
    VERIFIED: LoopClosureEvent.Kind
    PROPOSED: LoopClosureEvent.Kind
    ACCEPTED: LoopClosureEvent.Kind
    REJECTED: LoopClosureEvent.Kind
    REVERTED: LoopClosureEvent.Kind
    JUDGED: LoopClosureEvent.Kind
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    GRAPH_STATE_FIELD_NUMBER: _ClassVar[int]
    T_MATCH_QUERY_FIELD_NUMBER: _ClassVar[int]
    ACTOR_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    DETAILS_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    number: int
    kind: LoopClosureEvent.Kind
    state: LoopClosure.State
    reason: str
    graph_state: LoopClosure.GraphState
    t_match_query: _geometry_pb2.Transform
    actor: str
    note: str
    map_version: int
    details: _struct_pb2.Struct
    at_ns: int
    def __init__(self, number: _Optional[int] = ..., kind: _Optional[_Union[LoopClosureEvent.Kind, str]] = ..., state: _Optional[_Union[LoopClosure.State, str]] = ..., reason: _Optional[str] = ..., graph_state: _Optional[_Union[LoopClosure.GraphState, str]] = ..., t_match_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., actor: _Optional[str] = ..., note: _Optional[str] = ..., map_version: _Optional[int] = ..., details: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., at_ns: _Optional[int] = ...) -> None: ...

class CreateLoopClosureRequest(_message.Message):
    __slots__ = ("parent", "query", "match", "t_match_query", "note")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    QUERY_FIELD_NUMBER: _ClassVar[int]
    MATCH_FIELD_NUMBER: _ClassVar[int]
    T_MATCH_QUERY_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    parent: str
    query: str
    match: str
    t_match_query: _geometry_pb2.Transform
    note: str
    def __init__(self, parent: _Optional[str] = ..., query: _Optional[str] = ..., match: _Optional[str] = ..., t_match_query: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., note: _Optional[str] = ...) -> None: ...

class CreateLoopClosureResponse(_message.Message):
    __slots__ = ("loop_closure", "operation", "replay")
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    OPERATION_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    loop_closure: LoopClosure
    operation: _operation_pb2.Operation
    replay: bool
    def __init__(self, loop_closure: _Optional[_Union[LoopClosure, _Mapping]] = ..., operation: _Optional[_Union[_operation_pb2.Operation, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class AcceptLoopClosureRequest(_message.Message):
    __slots__ = ("name", "note")
    NAME_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    name: str
    note: str
    def __init__(self, name: _Optional[str] = ..., note: _Optional[str] = ...) -> None: ...

class AcceptLoopClosureResponse(_message.Message):
    __slots__ = ("loop_closure",)
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    loop_closure: LoopClosure
    def __init__(self, loop_closure: _Optional[_Union[LoopClosure, _Mapping]] = ...) -> None: ...

class RejectLoopClosureRequest(_message.Message):
    __slots__ = ("name", "note")
    NAME_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    name: str
    note: str
    def __init__(self, name: _Optional[str] = ..., note: _Optional[str] = ...) -> None: ...

class RejectLoopClosureResponse(_message.Message):
    __slots__ = ("loop_closure",)
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    loop_closure: LoopClosure
    def __init__(self, loop_closure: _Optional[_Union[LoopClosure, _Mapping]] = ...) -> None: ...

class RevertLoopClosureRequest(_message.Message):
    __slots__ = ("name", "note")
    NAME_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    name: str
    note: str
    def __init__(self, name: _Optional[str] = ..., note: _Optional[str] = ...) -> None: ...

class RevertLoopClosureResponse(_message.Message):
    __slots__ = ("loop_closure",)
    LOOP_CLOSURE_FIELD_NUMBER: _ClassVar[int]
    loop_closure: LoopClosure
    def __init__(self, loop_closure: _Optional[_Union[LoopClosure, _Mapping]] = ...) -> None: ...

class ListLoopClosureEventsRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListLoopClosureEventsResponse(_message.Message):
    __slots__ = ("loop_closure_events", "next_page_token")
    LOOP_CLOSURE_EVENTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    loop_closure_events: _containers.RepeatedCompositeFieldContainer[LoopClosureEvent]
    next_page_token: str
    def __init__(self, loop_closure_events: _Optional[_Iterable[_Union[LoopClosureEvent, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class GetLoopClosureKeypointsRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class KeypointPlan(_message.Message):
    __slots__ = ("submap", "t_submap_level", "x", "y")
    SUBMAP_FIELD_NUMBER: _ClassVar[int]
    T_SUBMAP_LEVEL_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    submap: str
    t_submap_level: _geometry_pb2.Transform
    x: _containers.RepeatedScalarFieldContainer[float]
    y: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, submap: _Optional[str] = ..., t_submap_level: _Optional[_Union[_geometry_pb2.Transform, _Mapping]] = ..., x: _Optional[_Iterable[float]] = ..., y: _Optional[_Iterable[float]] = ...) -> None: ...

class KeypointPair(_message.Message):
    __slots__ = ("query", "match", "agrees")
    QUERY_FIELD_NUMBER: _ClassVar[int]
    MATCH_FIELD_NUMBER: _ClassVar[int]
    AGREES_FIELD_NUMBER: _ClassVar[int]
    query: int
    match: int
    agrees: bool
    def __init__(self, query: _Optional[int] = ..., match: _Optional[int] = ..., agrees: _Optional[bool] = ...) -> None: ...

class GetLoopClosureKeypointsResponse(_message.Message):
    __slots__ = ("query", "match", "pairs")
    QUERY_FIELD_NUMBER: _ClassVar[int]
    MATCH_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    query: KeypointPlan
    match: KeypointPlan
    pairs: _containers.RepeatedCompositeFieldContainer[KeypointPair]
    def __init__(self, query: _Optional[_Union[KeypointPlan, _Mapping]] = ..., match: _Optional[_Union[KeypointPlan, _Mapping]] = ..., pairs: _Optional[_Iterable[_Union[KeypointPair, _Mapping]]] = ...) -> None: ...
