"""Every parameter of the node, once: name, default, unit, meaning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing import Self

from revisit.core.point_columns import COLUMNS, INTENSITY

LONGEST_STOREY = 64
CLOUD_TYPES = ("sensor_msgs/PointCloud2", "livox_ros_driver2/CustomMsg", "livox_interfaces/CustomMsg")


def _parameter(default: Any, meaning: str) -> Any:
    return field(default=default, metadata={"meaning": meaning})


@dataclass(frozen=True)
class Parameters:
    """What can be set; the ROS parameters have the same names."""

    service: str = _parameter("127.0.0.1:8090", "gRPC address of the service; `grpcs://host:port` for TLS")
    map_id: str = _parameter("default", "map that the sessions belong to; created where there is none")
    robot_id: str = _parameter("robot", "robot that the sessions belong to; created where there is none")
    storey: str = _parameter(
        "", "storey of a building that the robot is on, as B2; empty: not known. May be set anew in a lift"
    )
    drift: str = _parameter(
        "", "drift of the odometry: WHEEL, VISUAL, LIDAR_INERTIAL, or as `0.03 m/m 0.1 deg/m`; empty: not known"
    )
    spool_dir: str = _parameter("", "folder for scans that wait for the service; empty: ~/.revisit/spool")
    spool_max_mb: int = _parameter(4096, "MB that the clouds of one session may take on this disk")
    cloud_topic: str = _parameter("points", "sensor_msgs/PointCloud2 in the frame of the sensor")
    cloud_type: str = _parameter(
        "sensor_msgs/PointCloud2",
        "or a package's message of Livox: livox_ros_driver2/CustomMsg, livox_interfaces/CustomMsg",
    )
    deskew: bool = _parameter(
        True, "move points that have times to the stamp of their cloud; false: it was done before"
    )
    odometry_topic: str = _parameter("", "nav_msgs/Odometry; empty: poses are taken from TF")
    fix_topic: str = _parameter(
        "", "sensor_msgs/NavSatFix; the mounting of its frame is taken from TF. Empty: no fixes of satellites"
    )
    odom_frame: str = _parameter("odom", "frame that moves smoothly, z up; with `odometry_topic` its header says it")
    map_frame: str = _parameter("map", "parent of the published transform")
    pose_wait_s: float = _parameter(2.0, "seconds that a cloud waits for its pose, then it is left out")
    max_waiting_clouds: int = _parameter(30, "clouds that wait for a pose at most")
    send: str = _parameter(
        "described", "scans that are sent: `described`, one each one or two metres, or `all`, standing still, too"
    )
    columns: str = _parameter(
        "", "columns of the points that are sent, too, with commas: intensity, ring, time, rgb; each costs bytes"
    )
    intensity: bool = _parameter(False, "as `columns: intensity`")
    max_jump_m: float = _parameter(5.0, "metres that the odometry may jump at any speed; beyond, a new session begins")
    max_speed_m_s: float = _parameter(40.0, "fastest speed of the robot; what is faster is a jump")
    max_gap_s: float = _parameter(10.0, "seconds without scans after which a new session begins")
    poll_s: float = _parameter(5.0, "seconds between two questions for loops and corrections")
    grid_m: float = _parameter(
        0.0, "metres of a cell of the map that is published; 0: none is made. Each submap is downloaded once for it"
    )
    grid_every_s: float = _parameter(10.0, "seconds between two looks for a new version of the map, with `grid_m`")
    grid_ever: bool = _parameter(
        False,
        "keep in the published map what a later drive looked through; else workers make the tiles of each version of a "
        "map of several sessions twice, and each robot downloads both",
    )
    map_folder: str = _parameter("", "folder that `save_map` writes to; empty: ~/.revisit/maps")
    publish_tf: bool = _parameter(True, "publish `map_frame` -> `odom_frame` once the service has placed the session")
    tf_tolerance_s: float = _parameter(0.5, "seconds that the published transform is dated ahead")

    def __post_init__(self) -> None:
        for name in ("spool_max_mb", "pose_wait_s", "max_waiting_clouds", "max_jump_m", "max_speed_m_s", "max_gap_s",
                     "poll_s", "grid_every_s"):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not 0.0 <= self.grid_m <= 10.0:
            raise ValueError(f"grid_m must be 0 to 10 metres, got {self.grid_m}")
        for name in ("cloud_topic", "map_id", "robot_id", "odom_frame", "map_frame"):
            if not getattr(self, name):
                raise ValueError(f"{name} must not be empty")
        if self.cloud_type not in CLOUD_TYPES:
            raise ValueError(f"cloud_type must be one of {', '.join(CLOUD_TYPES)}, got {self.cloud_type!r}")
        if self.send not in ("described", "all"):
            raise ValueError(f"send must be described or all, got {self.send!r}")
        if self.map_frame == self.odom_frame:
            raise ValueError(f"map_frame and odom_frame are both {self.map_frame}")
        require_storey(self.storey)
        if unknown := set(self.sent_columns) - COLUMNS.keys():
            raise ValueError(f"columns are of {', '.join(COLUMNS)}, got {', '.join(sorted(unknown))}")

    @property
    def sent_columns(self) -> tuple[str, ...]:
        """The columns of the points that are sent."""
        named = [name.strip() for name in self.columns.split(",") if name.strip()]
        return tuple(dict.fromkeys([INTENSITY.name, *named] if self.intensity else named))

    @classmethod
    def declared(cls) -> tuple[Field[Any], ...]:
        """The parameters with default (`default`) and meaning (`metadata["meaning"]`)."""
        return fields(cls)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """From values by name; what is missing is as declared. Raises ValueError."""
        return cls(**values)


def require_storey(storey: str) -> None:
    """Raise ValueError where `storey` is no name of a storey, as the service takes them, nor empty."""
    if len(storey) > LONGEST_STOREY or not storey.isprintable() or storey != storey.strip():
        raise ValueError(
            f"storey must have at most {LONGEST_STOREY} printable characters, no blank before or behind, got {storey!r}"
        )


def as_table() -> str:
    """The parameters as the table of the README."""
    rows = [f"| `{item.name}` | `{_shown(item.default)}` | {item.metadata['meaning']} |" for item in fields(Parameters)]
    return "\n".join(["| parameter | default | meaning |", "|---|---|---|", *rows]) + "\n"


def _shown(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else '""' if value == "" else str(value)
