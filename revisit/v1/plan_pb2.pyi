from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PlanPin(_message.Message):
    __slots__ = ("pixel_x", "pixel_y", "x_m", "y_m")
    PIXEL_X_FIELD_NUMBER: _ClassVar[int]
    PIXEL_Y_FIELD_NUMBER: _ClassVar[int]
    X_M_FIELD_NUMBER: _ClassVar[int]
    Y_M_FIELD_NUMBER: _ClassVar[int]
    pixel_x: float
    pixel_y: float
    x_m: float
    y_m: float
    def __init__(self, pixel_x: _Optional[float] = ..., pixel_y: _Optional[float] = ..., x_m: _Optional[float] = ..., y_m: _Optional[float] = ...) -> None: ...

class Plan(_message.Message):
    __slots__ = ("name", "display_name", "storey", "media_type", "width_px", "height_px", "size_bytes", "pins", "frame", "map_version", "metres_per_pixel", "turn_rad", "created_at_ns")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DISPLAY_NAME_FIELD_NUMBER: _ClassVar[int]
    STOREY_FIELD_NUMBER: _ClassVar[int]
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    PINS_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_PIXEL_FIELD_NUMBER: _ClassVar[int]
    TURN_RAD_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_NS_FIELD_NUMBER: _ClassVar[int]
    name: str
    display_name: str
    storey: str
    media_type: str
    width_px: int
    height_px: int
    size_bytes: int
    pins: _containers.RepeatedCompositeFieldContainer[PlanPin]
    frame: str
    map_version: int
    metres_per_pixel: float
    turn_rad: float
    created_at_ns: int
    def __init__(self, name: _Optional[str] = ..., display_name: _Optional[str] = ..., storey: _Optional[str] = ..., media_type: _Optional[str] = ..., width_px: _Optional[int] = ..., height_px: _Optional[int] = ..., size_bytes: _Optional[int] = ..., pins: _Optional[_Iterable[_Union[PlanPin, _Mapping]]] = ..., frame: _Optional[str] = ..., map_version: _Optional[int] = ..., metres_per_pixel: _Optional[float] = ..., turn_rad: _Optional[float] = ..., created_at_ns: _Optional[int] = ...) -> None: ...

class CreatePlanRequest(_message.Message):
    __slots__ = ("parent", "plan_id", "display_name", "storey", "pins", "image")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    DISPLAY_NAME_FIELD_NUMBER: _ClassVar[int]
    STOREY_FIELD_NUMBER: _ClassVar[int]
    PINS_FIELD_NUMBER: _ClassVar[int]
    IMAGE_FIELD_NUMBER: _ClassVar[int]
    parent: str
    plan_id: str
    display_name: str
    storey: str
    pins: _containers.RepeatedCompositeFieldContainer[PlanPin]
    image: bytes
    def __init__(self, parent: _Optional[str] = ..., plan_id: _Optional[str] = ..., display_name: _Optional[str] = ..., storey: _Optional[str] = ..., pins: _Optional[_Iterable[_Union[PlanPin, _Mapping]]] = ..., image: _Optional[bytes] = ...) -> None: ...

class CreatePlanResponse(_message.Message):
    __slots__ = ("plan", "replay")
    PLAN_FIELD_NUMBER: _ClassVar[int]
    REPLAY_FIELD_NUMBER: _ClassVar[int]
    plan: Plan
    replay: bool
    def __init__(self, plan: _Optional[_Union[Plan, _Mapping]] = ..., replay: _Optional[bool] = ...) -> None: ...

class GetPlanRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetPlanResponse(_message.Message):
    __slots__ = ("plan",)
    PLAN_FIELD_NUMBER: _ClassVar[int]
    plan: Plan
    def __init__(self, plan: _Optional[_Union[Plan, _Mapping]] = ...) -> None: ...

class ListPlansRequest(_message.Message):
    __slots__ = ("parent", "page_size", "page_token")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    parent: str
    page_size: int
    page_token: str
    def __init__(self, parent: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListPlansResponse(_message.Message):
    __slots__ = ("plans", "next_page_token")
    PLANS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    plans: _containers.RepeatedCompositeFieldContainer[Plan]
    next_page_token: str
    def __init__(self, plans: _Optional[_Iterable[_Union[Plan, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class PinPlanRequest(_message.Message):
    __slots__ = ("name", "pins")
    NAME_FIELD_NUMBER: _ClassVar[int]
    PINS_FIELD_NUMBER: _ClassVar[int]
    name: str
    pins: _containers.RepeatedCompositeFieldContainer[PlanPin]
    def __init__(self, name: _Optional[str] = ..., pins: _Optional[_Iterable[_Union[PlanPin, _Mapping]]] = ...) -> None: ...

class PinPlanResponse(_message.Message):
    __slots__ = ("plan",)
    PLAN_FIELD_NUMBER: _ClassVar[int]
    plan: Plan
    def __init__(self, plan: _Optional[_Union[Plan, _Mapping]] = ...) -> None: ...

class DeletePlanRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DeletePlanResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class DownloadPlanRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DownloadPlanResponse(_message.Message):
    __slots__ = ("media_type", "filename", "data")
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    FILENAME_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    media_type: str
    filename: str
    data: bytes
    def __init__(self, media_type: _Optional[str] = ..., filename: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...
