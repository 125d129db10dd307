"""Answers of the service as frozen dataclasses. Generated from proto/revisit/v1 by `make proto`; do not edit.

Optional fields are None where the service says nothing, also those that are empty or 0 in the interface.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from revisit.sdk.own_resources import KeypointPlan as KeypointPlan
from revisit.sdk.own_resources import LoopKeypoints as LoopKeypoints
from revisit.sdk.own_resources import MapDistances as MapDistances
from revisit.sdk.own_resources import MapPoints as MapPoints
from revisit.sdk.own_resources import MapPose as MapPose
from revisit.sdk.own_resources import MapTile as MapTile
from revisit.sdk.own_resources import Operation as Operation
from revisit.sdk.own_resources import OperationProgress as OperationProgress
from revisit.sdk.own_resources import Status as Status
from revisit.sdk.own_resources import Webhook as Webhook
from revisit.sdk.own_resources import in_map
from revisit.sdk.reading import Json, Matrix4, Resource, covariance_of, read_by


@dataclass(frozen=True, kw_only=True)
class GeodeticPosition(Resource):
    """A place on earth, WGS 84."""

    latitude_deg: float = 0.0
    """North of the equator, degrees: -90 to 90."""
    longitude_deg: float = 0.0
    """East of Greenwich, degrees: -180 to 180."""
    altitude_m: float = 0.0
    """Above the ellipsoid, metres: -10000 to 100000."""


@dataclass(frozen=True, kw_only=True)
class Anchor(Resource):
    """The measured place of a point of the robot at one time, in the world: x east, y north, z up from the map's
    origin.
    """

    name: str = ""
    """maps/{map}/sessions/{session}/anchors/{anchor}"""
    kind: str = ""
    """GNSS, CONTROL_POINT, KNOWN_POSE or FIDUCIAL."""
    stamp_ns: int = 0
    """When the robot was there: 0 to 9223372036854775807."""
    geodetic: GeodeticPosition | None = None
    """The place on earth, or"""
    local_m: tuple[float, float, float] | None = None
    """in metres east, north and above the origin of the map. A FIDUCIAL has neither."""
    covariance_enu: tuple[float, ...] = ()
    """3 x 3, row by row, of east, north and up, m^2; of a FIDUCIAL, of offset_m along the axes of the sensor."""
    offset_m: tuple[float, float, float]
    """The point in the frame of the sensor, metres."""
    T_odom_sensor: Matrix4 = field(compare=False)
    """The sensor in the odometry frame of the session at that time."""
    heading_rad: float | None = None
    """The heading of the sensor's x axis, counter-clockwise from east, radians: -10 to 10. KNOWN_POSE needs it."""
    heading_sigma_rad: float | None = None
    """Its standard deviation: 0.0001 to 1."""
    state: str | None = None
    """IN_MAP, SET_ASIDE or NOT_ALIGNED."""
    reason: str | None = None
    """DISAGREES; or why nothing is aligned: TOO_FEW, NOT_SPREAD, MOSTLY_DISAGREE. Of a FIDUCIAL: MISREAD, MOVED,
    TWO_PLACES, SEEN_ONCE, NOT_JOINED. Empty where it holds the map.
    """
    residual_m: tuple[float, float, float] | None = None
    """The place less where the map has the point; absent where nothing is aligned. Of a FIDUCIAL: where other passes
    have the tag, less where this one has it, along the axes of the frame of the map.
    """
    created_at_ns: int = 0
    tag: str | None = None
    """The family and the id of the tag of a FIDUCIAL, as tag36h11:17."""


@dataclass(frozen=True, kw_only=True)
class AnchoredSession(Resource):
    """The anchors of a session that are less sure than they state, or lie beside the map as a whole by more than one of
    them is sure.
    """

    session: str = ""
    """maps/{map}/sessions/{session}"""
    anchors: int = 0
    """Its anchors that hold the frame,"""
    of_anchors: int = 0
    """of so many."""
    offset_m: tuple[float, float, float]
    """The median of their places less where the map has them: east, north and up, metres."""
    sigma_factor: float = 0.0
    """Their standard deviations were taken as so many times the stated ones; 1 as they are."""
    elsewhere: bool = False
    """They contradict the map as a whole: a wrong base station, heights above the sea instead of the ellipsoid, or
    loops of the session with a place that only looks the same.
    """


@dataclass(frozen=True, kw_only=True)
class Georeference(Resource):
    """Where a frame of a map lies on earth, by the anchors that hold it."""

    frame: str = ""
    """The frame of the map."""
    T_enu_map: Matrix4 = field(compare=False)
    """From the frame to metres east, north and above the origin of the map."""
    covariance: Matrix4 = field(compare=False, metadata=read_by(covariance_of))
    """(6, 6) of (x, y, z, rx, ry, rz), metres and radians; NaN where the graph does not tell it."""
    anchors: int = 0
    """Anchors that hold the frame,"""
    of_anchors: int = 0
    """of so many."""
    residual_m: float = 0.0
    """Root mean square of their residuals across the ground, metres."""
    sessions: tuple[AnchoredSession, ...] = ()
    """The sessions whose anchors are not as they state, the furthest off first, 50 at most."""


@dataclass(frozen=True, kw_only=True)
class LoopPolicy(Resource):
    """Which loop closures are accepted. In a request, absent fields are as the service is configured."""

    candidates: int | None = None
    """Submaps that are verified for each new one: 1 to 100."""
    min_score: float | None = None
    """The least score: 0 to 1."""
    min_overlap: float | None = None
    """The least overlap of the two surfaces: 0 to 1."""
    max_seen_through: float | None = None
    """The largest part of one place that the other has looked through: 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class Map(Resource):
    """A map. `tau_m`, `stride_m` and `leave_distance_m` are the values in force."""

    name: str = ""
    """maps/{map}"""
    display_name: str = ""
    tau_m: float = 0.0
    """Travelled distance covered by one submap, metres."""
    stride_m: float = 0.0
    """Travelled distance between the starts of two submaps, metres."""
    session_count: int = 0
    submap_count: int = 0
    created_at_ns: int = 0
    scene_scale: float = 0.0
    """Size of its scene compared with a street."""
    loop_policy: LoopPolicy
    """Which loop closures of this map are accepted: the values in force."""
    map_version: int = 0
    """The version of its poses that answers rest on (maps/{map}/versions/{version}), 0 before the first."""
    leave_distance_m: float = 0.0
    """So far a drive must have been from a place, before it comes back, for a loop within the drive, metres."""
    profile: str = ""
    """The form of the method that describes its submaps: product, or paper."""
    origin: GeodeticPosition | None = None
    """Where its anchors measure from; absent before the first geodetic one."""


@dataclass(frozen=True, kw_only=True)
class RetentionPolicy(Resource):
    """What a map keeps. An absent number removes nothing."""

    keep_scans: str = ""
    """ALL, DESCRIBED or NONE."""
    scans_after_hours: float = 0.0
    """So many hours after the description of their submap the other scans go: 0 to 876000; 0 is at once."""
    best_submaps: int | None = None
    """So many submaps of a place, the best, stay in the index: 1 to 100. The others are retired."""
    session_days: float | None = None
    """Sessions that ended so many days ago go: 1/24 to 36500. Where the map rests on one, its submaps are retired."""
    dropped_session_days: float | None = None
    """Sessions that ended so many days ago and that the map does not rest on go: 1/24 to 36500."""
    rejected_days: float | None = None
    """So many days the evidence of rejected pairs stays: 1/24 to 36500."""
    retired_days: float | None = None
    """So many days after the end of its session a retired submap keeps its neural map, where a later drive shows its
    place: 1/24 to 36500.
    """


@dataclass(frozen=True, kw_only=True)
class RetentionOutcome(Resource):
    """How much one rule has removed, or would."""

    rule: str = ""
    """SESSIONS, BEST_SUBMAPS, SCANS, REJECTED_LOOPS or RETIRED_MAPS."""
    sessions: int = 0
    submaps: int = 0
    """Submaps that are deleted or retired; of the rule SCANS such that keep fewer scans, of RETIRED_MAPS such that lose
    their neural map.
    """
    scans: int = 0
    loop_closures: int = 0
    bytes: int = 0
    """Bytes on the disk: of blobs as weighed, of rows about."""


@dataclass(frozen=True, kw_only=True)
class RetentionReport(Resource):
    """What a run has removed, or would."""

    at_ns: int = 0
    rules: tuple[RetentionOutcome, ...] = ()
    """One for each rule that had anything to do."""
    submaps_held: int = 0
    """Submaps that stay because a loop closure of theirs waits for a decision."""
    sessions_held: int = 0
    """Sessions that stay because the map rests on them; their submaps are retired."""
    bytes_estimated: bool = False
    """Not each blob was weighed."""


@dataclass(frozen=True, kw_only=True)
class MapRetention(Resource):
    """The policy of a map in force."""

    map: str = ""
    """maps/{map}"""
    policy: RetentionPolicy
    own: bool = False
    """The policy is the map's own, not that of the service."""
    redescription: str = ""
    """FROM_SCANS or FROM_NEURAL_MAPS."""
    last_run: RetentionReport | None = None
    """Absent before anything was removed."""


@dataclass(frozen=True, kw_only=True)
class Robot(Resource):
    """A robot."""

    name: str = ""
    """robots/{robot}"""
    display_name: str = ""
    created_at_ns: int = 0


@dataclass(frozen=True, kw_only=True)
class OdometryFault(Resource):
    """A fault of a session's odometry that loops show. The version of the map has it mended, unless it is undecided."""

    session: str = ""
    """maps/{map}/sessions/{session}"""
    kind: str = ""
    """At once: SLIP (way lost or made up), JUMP (a jump aside), TURN (a wrong turn), TILT. Throughout: SCALE (lengths),
    SLOPE (climb), HEADING (a steady turn).
    """
    first_submap: str = ""
    """maps/{map}/sessions/{session}/submaps/{submap}: the fault lies between this submap and the last one. Those of the
    whole session for a fault throughout; empty where the submap was deleted.
    """
    last_submap: str = ""
    amount: float = 0.0
    """SLIP, JUMP: metres. TURN, TILT: radians. SCALE: share of each length that is missing. SLOPE: metres a metre.
    HEADING: radians a metre.
    """
    sigma: float = 0.0
    """Standard deviation of the amount."""
    loops: int = 0
    """Loops that speak for it."""
    submaps: int = 0
    """Submaps from the first to the last one, both included."""
    message: str = ""
    """The same in words, with the most likely cause."""
    undecided: bool = False
    """Whether these loops may as well take a place for another one that looks alike: they show the fault at one place
    alone, before or behind it, and surfaces do not decide. Then the map does not have it mended, and the covariances of
    its poses allow for it.
    """


@dataclass(frozen=True, kw_only=True)
class Finding(Resource):
    """Something about scans that is unlikely to be meant."""

    code: str = ""
    """As scene_too_large, ground_tilted, pose_jump, time_unit."""
    submaps: int = 0
    """How many submaps of the session have it."""
    cause: str = ""
    """What most likely causes it."""
    advice: str = ""
    """What to do."""
    odometry_fault: OdometryFault | None = None
    """Of a fault of odometry, code odometry_...: its place and size."""


@dataclass(frozen=True, kw_only=True)
class NoLoops(Resource):
    """Why a session has no accepted loop."""

    code: str = ""
    """NO_SUBMAP, NOT_DESCRIBED, NOTHING_TO_COMPARE (it came back to no place that it had left, and no other session may
    be compared) or NONE_ACCEPTED.
    """
    message: str = ""
    """The same in words, with figures."""


@dataclass(frozen=True, kw_only=True)
class Session(Resource):
    """A session."""

    name: str = ""
    """maps/{map}/sessions/{session}"""
    robot: str | None = None
    """robots/{robot}, or empty."""
    state: str = ""
    """ACTIVE or FINISHED."""
    committed_seq: int = 0
    """The last scan stored durably, 0 for none."""
    travelled_m: float = 0.0
    submap_count: int = 0
    created_at_ns: int = 0
    finished_at_ns: int | None = None
    committed_stamp_ns: int | None = None
    """When the last stored scan was taken; absent before the first."""
    findings: tuple[Finding, ...] = ()
    """What is unlikely to be meant about its scans (units, frames, times), by how many of its submaps have it, the most
    frequent first. Not in lists of sessions.
    """
    storey: str | None = None
    """The storey of a building that the session was driven on, as B2; empty where nobody said it."""
    no_loops: NoLoops | None = None
    """Why a finished session has no accepted loop; absent where it has one, or where submaps wait to be described. Not
    in lists of sessions.
    """
    drift: str | None = None
    """How far its odometry drifts, as CreateSessionRequest said it; empty where nobody did."""


@dataclass(frozen=True, kw_only=True)
class Failure(Resource):
    """Why work failed: a reason of the error table and a sentence."""

    reason: str = ""
    message: str = ""


@dataclass(frozen=True, kw_only=True)
class Submap(Resource):
    """A submap."""

    name: str = ""
    """maps/{map}/sessions/{session}/submaps/{submap}"""
    state: str = ""
    """QUEUED, DESCRIBED, FAILED or RETIRED."""
    ordinal: int = 0
    """Counts the submaps of its session from 0."""
    T_odom_submap: Matrix4 = field(compare=False)
    """The submap's frame (sensor frame of its middle scan) in the session's odometry frame."""
    position_m: tuple[float, float, float]
    """Where it was taken, in the session's odometry frame."""
    stamp_ns: int = 0
    first_seq: int | None = None
    """The scans it was cut from, absent for a posted cloud."""
    last_seq: int | None = None
    scan_count: int = 0
    point_count: int = 0
    raw_bytes: int = 0
    """Size of the cloud as float32 xyz."""
    neural_map_bytes: int | None = None
    """Size of its neural map, once described."""
    flags: tuple[str, ...] = ()
    model_version: str | None = None
    failure: Failure | None = None
    operation: str = ""
    """operations/{operation}"""
    created_at_ns: int = 0
    descriptor: tuple[float, ...] = field(default=(), metadata=read_by(lambda message: tuple(message.place_descriptor)))
    """The place descriptor, a unit vector of model_version; only where the view FULL was asked for, once described."""
    seq: int = 0
    """Grows with every submap of the map, in the order in which they were stored: what min_seq of a query takes."""
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(in_map("t_map_submap")))
    """The pose in a frame of the map; None while no version of the map has the session."""
    kept_scans: str = ""
    """Which of its scans, or whether its posted cloud, is still kept. ALL, DESCRIBED or NONE."""


@dataclass(frozen=True, kw_only=True)
class SearchHit(Resource):
    """A submap and its cosine similarity to the query."""

    submap: str = ""
    similarity: float = 0.0
    position_m: tuple[float, float, float]
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(in_map("t_map_submap")))
    """The pose in a frame of the map; None while no version of the map has the session."""


@dataclass(frozen=True, kw_only=True)
class Candidate(Resource):
    """One submap that was compared with the cloud."""

    submap: str = ""
    accepted: bool = False
    reason: str | None = None
    similarity: float = 0.0
    score: float = 0.0
    T_match_query: Matrix4 | None = field(default=None, compare=False)
    evidence: Json


@dataclass(frozen=True, kw_only=True)
class Localization(Resource):
    """The best verified candidate, and all that were compared with the cloud."""

    best: Candidate | None = None
    """The best verified candidate, absent where the place is unknown."""
    candidates: tuple[Candidate, ...] = ()
    T_odom_query: Matrix4 | None = field(default=None, compare=False)
    """The cloud's pose in the odometry frame of `session`; absent where the place is unknown."""
    session: str | None = None
    """The session of the best candidate, maps/{map}/sessions/{session}; empty where the place is unknown."""
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(in_map("t_map_query")))
    """The pose in a frame of the map; None while no version of the map has the session."""
    on_other_storeys: int = 0
    """How many submaps of the map's index could not be compared, as their sessions are on another storey."""


@dataclass(frozen=True, kw_only=True)
class RelocalisedPose(Resource):
    """A pose of the newest scan that may be true."""

    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(in_map("t_map_sensor")))
    """The pose in a frame of the map; None while no version of the map has the session."""
    T_session_sensor: Matrix4 | None = field(default=None, compare=False)
    """Then the pose in the odometry frame of that session, maps/{map}/sessions/{session}; else absent and empty."""
    session: str | None = None
    covariance: Matrix4 = field(compare=False, metadata=read_by(covariance_of))
    """(6, 6) of (x, y, z, rx, ry, rz), metres and radians; NaN where the graph does not tell it."""
    probability: float = 0.0
    views: int = 0
    """Scans that agree with the pose and see anything new, and those of them with an accepted pair."""
    accepted: int = 0
    along_m: float = 0.0
    """The way along which they lie, metres."""


@dataclass(frozen=True, kw_only=True)
class TellingDrive(Resource):
    """A drive after which the map expects the most unlike views of the possible poses."""

    direction_rad: float = 0.0
    """In the frame of the newest scan: 0 ahead, to the left positive, radians."""
    distance_m: float = 0.0
    difference: float = 0.0
    """How unlike the views are, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class Relocalisation(Resource):
    """What the scans so far tell."""

    state: str = ""
    """PLACED, SEVERAL or UNKNOWN."""
    reason: str | None = None
    """TOO_FEW_RETURNS, MAP_IS_EMPTY, NOT_YET, PLACES_REPEAT or NOT_IN_MAP; empty but where the state is UNKNOWN."""
    poses: tuple[RelocalisedPose, ...] = ()
    """Most probable first; one where PLACED, none where UNKNOWN."""
    none_of_them: float = 0.0
    """The probability that none of the poses is true. Together with theirs at most 1."""
    travelled_m: float = 0.0
    """The way of the conversation so far, metres."""
    tells_apart: TellingDrive | None = None
    """A drive that would tell the poses apart; absent where there is one pose or none, or no drive would."""
    on_other_storeys: int = 0
    """How many submaps of the map's index could not be compared, as their sessions are on another storey."""


@dataclass(frozen=True, kw_only=True)
class LoopClosure(Resource):
    """A pair of submaps that look alike, with the verdict."""

    name: str = ""
    """maps/{map}/loopClosures/{loop_closure}"""
    number: int = 0
    """The number of the map's event that accepted it last; 0 where it never was accepted. Resumes a watch."""
    query: str = ""
    """The submap that asked."""
    match: str = ""
    """The submap that was found."""
    state: str = ""
    """ACCEPTED, REJECTED or PROPOSED."""
    reason: str | None = None
    """Which gate rejected it, or AWAITS_CHAIN; empty where accepted."""
    similarity: float = 0.0
    score: float = 0.0
    T_match_query: Matrix4 | None = field(default=None, compare=False)
    """Maps points of the query submap's frame into the match submap's frame; absent where no alignment existed."""
    evidence: Json
    """Similarity, inliers, overlap, residual, covariance, thresholds and model versions."""
    created_at_ns: int = 0
    graph_state: str | None = None
    """The verdict of the pose graph, as of map_version; unspecified where no version of the map knows the loop. IN_MAP,
    SET_ASIDE or UNCONNECTED.
    """
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(in_map("t_map_query")))
    """The pose in a frame of the map; None while no version of the map has the session."""
    T_map_match: Matrix4 | None = field(default=None, compare=False)
    manual: bool = False
    """Whether a person made it, and not the service."""


@dataclass(frozen=True, kw_only=True)
class LoopClosureEvent(Resource):
    """A change of a loop closure. The last event has its present state."""

    number: int = 0
    """Grows with every event of the service."""
    kind: str = ""
    """VERIFIED, PROPOSED, ACCEPTED, REJECTED, REVERTED or JUDGED."""
    state: str = ""
    """The state from then on, and in the next three fields. ACCEPTED, REJECTED or PROPOSED."""
    reason: str | None = None
    graph_state: str | None = None
    """IN_MAP, SET_ASIDE or UNCONNECTED."""
    T_match_query: Matrix4 | None = field(default=None, compare=False)
    actor: str = ""
    """Who: the caller, or "service"."""
    note: str = ""
    """Why, in the words of the caller."""
    map_version: int | None = None
    """The version of the map that gave the verdict of the pose graph; 0 for others."""
    details: Json
    """Thresholds and model version of a verdict; the squared distance from the poses of a version."""
    at_ns: int = 0


@dataclass(frozen=True, kw_only=True)
class MapChange(Resource):
    """Something that one day has and the other has not: a box along the axes of the map's frame around its points."""

    kind: str = ""
    """VANISHED, APPEARED, MOVED or BACK."""
    centre_m: tuple[float, float, float]
    """Metres."""
    extent_m: tuple[float, float, float]
    points: int = 0
    """Neural points in it."""
    moved_from_m: tuple[float, float, float] | None = None
    """The middle of where a thing that MOVED stood before, metres."""
    frame: str = ""
    """The frame of the map that it lies in. This and what follows is of changes between the drives of a map."""
    session: str = ""
    """maps/{map}/sessions/{session}: the drive that found it."""
    stamp_ns: int | None = None
    """When that drive had passed, nanoseconds since 1970."""
    before_ns: int | None = None
    """When the place was last seen as it was before: the change happened in between."""


@dataclass(frozen=True, kw_only=True)
class MapMerge(Resource):
    """A merge into a map."""

    name: str = ""
    """maps/{map}/merges/{merge}"""
    source: str = ""
    """What was copied, by resource name; it may have been deleted since."""
    version_before: int = 0
    """The version in force before, 0 for none. It is kept while the merge is."""
    version: int = 0
    """The version that the merge made."""
    sessions: tuple[str, ...] = ()
    """The copies, maps/{map}/sessions/{session}."""
    report: Json = field(compare=False)
    """Alignment, evidence and limits, as the operation told them."""
    changes: tuple[MapChange, ...] = ()
    """What vanished since the map was made, and what appeared."""
    created_at_ns: int = 0
    reverted_at_ns: int | None = None
    """When it was taken back."""


@dataclass(frozen=True, kw_only=True)
class RefusedJoin(Resource):
    """Sessions that loops would join, kept apart because their surfaces contradict it. The loops between them are set
    aside.
    """

    sessions: tuple[str, ...] = ()
    """maps/{map}/sessions/{session}, of one side."""
    other_sessions: tuple[str, ...] = ()
    """Of the other side."""
    reason: str = ""
    """OVERLAP_TOO_SMALL, SURFACES_DISAGREE or FREE_SPACE_VIOLATED, as of a merge."""
    loops: int = 0
    """Accepted loops between the two sides."""
    common_points: int = 0
    """Points of either side near points of the other."""
    residual_m: float | None = None
    """Median distance of these points from the other surface, metres; absent without any."""
    seen_through_share: float = 0.0
    """Share of the points, 0 to 1, that stand where the other side looked through."""
    worst_stretch_share: float = 0.0
    """The largest such share of a stretch of 25 m."""


@dataclass(frozen=True, kw_only=True)
class MapVersionSummary(Resource):
    """What a version of a map rests on."""

    sessions: int = 0
    submaps: int = 0
    frames: int = 0
    """Groups of sessions that loops join; each has a frame of its own."""
    loops_in_map: int = 0
    loops_set_aside: int = 0
    loops_unconnected: int = 0
    """Loops between sessions that share no frame."""
    chi2: float = 0.0
    """Squared errors of all steps of odometry and of the loops in the map, each by its covariance."""
    degrees_of_freedom: int = 0
    """What chi2 is to be compared with."""
    mean_change_m: float | None = None
    """How far submaps lie from where the version before had them, metres; absent where no submap can be compared."""
    max_change_m: float | None = None
    refused_joins: tuple[RefusedJoin, ...] = ()
    odometry_faults: tuple[OdometryFault, ...] = ()
    """Faults of odometry that loops show; the poses of this version have them mended, but for undecided ones."""
    georeferences: tuple[Georeference, ...] = ()
    """The frames that anchors hold on earth."""


@dataclass(frozen=True, kw_only=True)
class MapVersion(Resource):
    """A version of a map: the poses of its submaps at one time. It never changes."""

    name: str = ""
    """maps/{map}/versions/{version}"""
    version: int = 0
    """Grows with every version of the map, from 1."""
    in_force: bool = False
    """The version that answers rest on: the newest one."""
    restored_from: int | None = None
    """The version whose poses were brought back, 0 where they were optimised."""
    content_hash: str = ""
    """SHA-256 (hex) of the poses and verdicts: the same poses have the same hash."""
    operation: str | None = None
    """The operation that made it, operations/{operation}; empty where an earlier version was brought back."""
    created_at_ns: int = 0
    summary: MapVersionSummary


@dataclass(frozen=True, kw_only=True)
class SubmapPose(Resource):
    """Where a submap lies in the map."""

    submap: str = ""
    """maps/{map}/sessions/{session}/submaps/{submap}"""
    T_map_submap: Matrix4 = field(compare=False)
    frame: str = ""
    """The frame that the pose is in: poses of different frames have nothing to do with each other."""
    covariance: Matrix4 = field(compare=False, metadata=read_by(covariance_of))
    """(6, 6) of (x, y, z, rx, ry, rz), metres and radians; NaN where the graph does not tell it."""


@dataclass(frozen=True, kw_only=True)
class Correction(Resource):
    """Where the odometry frame of a session lies in the map: T_map_odom * T_odom_sensor is the pose of a sensor in the
    map.
    """

    session: str = ""
    """maps/{map}/sessions/{session}"""
    T_map_odom: Matrix4 = field(compare=False)
    """As of the last submap of the session that the version has."""
    frame: str = ""
    """The frame of the map that the correction leads to. Sessions with the same frame are in one map."""
    map_version: int = 0
    covariance: Matrix4 = field(compare=False, metadata=read_by(covariance_of))
    """(6, 6) of (x, y, z, rx, ry, rz), metres and radians; NaN where the graph does not tell it."""
    created_at_ns: int = 0
    """When the version was made, or the correction ahead of the next one."""
    early_loops: int = 0
    """Not 0 where loops that came after the version have moved the session already: how many of the map were asked one
    by one. The correction is then provisional, and as of the last submap of all; the next version replaces it.
    """
    odometry_faults: tuple[OdometryFault, ...] = ()
    """Faults of the session's odometry by the version. The session drives on: T_map_odom is right behind the last
    mended one.
    """


@dataclass(frozen=True, kw_only=True)
class DriveChanges(Resource):
    """How many things a drive found changed since earlier drives."""

    session: str = ""
    """maps/{map}/sessions/{session}: the drive that found them."""
    map_version: str = ""
    """maps/{map}/versions/{version}, whose changes list them."""
    appeared: int = 0
    vanished: int = 0
    moved: int = 0
    back: int = 0


@dataclass(frozen=True, kw_only=True)
class MapFile(Resource):
    """A version of a map as one file."""

    name: str = ""
    """maps/{map}/files/{version}"""
    map_id: str = ""
    """The id of the map."""
    map_version: str = ""
    """The number of the version, as text."""
    map_status: str = ""
    """ENABLED or DISABLED."""
    map_descriptor: str = ""
    """What the map is, in an operator's words."""
    map_download_link: str = ""
    """Where it can be downloaded with HTTP, in ranges, too: a path of the REST API of this service."""
    map_hash: str = ""
    """SHA-256 (hex) of the file."""
    size_bytes: int = 0
    submaps: int = 0
    created_at_ns: int = 0


@dataclass(frozen=True, kw_only=True)
class PlanPin(Resource):
    """A point of a picture, and its place in the map."""

    pixel_x: float = 0.0
    """From the left edge of the picture as its bytes have it (a turn that EXIF asks for is not made): 0 to 30000."""
    pixel_y: float = 0.0
    """From its upper edge: 0 to 30000."""
    x_m: float = 0.0
    """In the frame of the plan, metres: -1000000 to 1000000."""
    y_m: float = 0.0
    """-1000000 to 1000000."""


@dataclass(frozen=True, kw_only=True)
class Plan(Resource):
    """A picture underneath a map: scaled, turned and moved so that its two pins lie where they belong."""

    name: str = ""
    """maps/{map}/plans/{plan}"""
    display_name: str = ""
    storey: str | None = None
    """The storey of a building that it shows; empty for none."""
    media_type: str = ""
    """image/png or image/jpeg"""
    width_px: int = 0
    height_px: int = 0
    size_bytes: int = 0
    pins: tuple[PlanPin, ...] = ()
    """Two. Each goes with the submap that was nearest to it when it was set, as versions of the map move that."""
    frame: str = ""
    """The frame of the map that the pins are in; empty while the map has no version: then it is the odometry of the
    oldest session.
    """
    map_version: int = 0
    """The version of the map by which they are where they are, 0 for none."""
    metres_per_pixel: float = 0.0
    turn_rad: float = 0.0
    """How far the picture is turned counter-clockwise, radians."""
    created_at_ns: int = 0


@dataclass(frozen=True, kw_only=True)
class Event(Resource):
    """Something that became true in a map. It holds its resource as that stands when the event is told."""

    number: int = 0
    """Grows with every event of the map; a watch after it goes on behind it. Events of two maps may have the same
    number.
    """
    kind: str = ""
    """LOOP_CLOSURE, OPERATION, OPENED, MAP_VERSION, RETENTION, ANCHOR, MAP_CHANGED or FORGOTTEN."""
    map: str = ""
    """maps/{map}"""
    loop_closure: LoopClosure | None = None
    operation: Operation | None = None
    map_version: MapVersion | None = None
    retention: RetentionReport | None = None
    anchor: Anchor | None = None
    drive_changes: DriveChanges | None = None


@dataclass(frozen=True, kw_only=True)
class WebhookDelivery(Resource):
    """One attempt to deliver."""

    first_event: int = 0
    """The numbers of the first and the last event of the request, each within its map, and how many it held."""
    last_event: int = 0
    events: int = 0
    attempt: int = 0
    """1 for the first attempt."""
    status: int | None = None
    """The HTTP status that the receiver answered with; 0 where there was no answer."""
    error: str | None = None
    """Why there was no answer."""
    took_ms: int = 0
    at_ns: int = 0
