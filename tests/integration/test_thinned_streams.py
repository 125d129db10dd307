"""A robot that sends the described scans alone gives the same places as one that sends them all."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.scan_marks import ScanMarks
from revisit.formats import DecodedCloud
from revisit.sdk.messages import pose_json
from revisit.sdk.scan_choice import ScanChoice
from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.domain.identity import SessionKey
from revisit.service.features.ingest import rows
from revisit.service.features.ingest.calls import AppendScan
from tests.support.retained import policy_set, retained, stored_seqs
from tests.support.service_world import TENANT, memory_world, open_session, sqlite_world

FULL, THIN = SessionKey("town", "full"), SessionKey("town", "thin")
RETURNS = 21_000
"""As many as 16 beams have: a mark each 0.5 m."""


def hall() -> np.ndarray:
    """Floor, walls and pillars (n, 3) along x, metres."""
    rng = np.random.default_rng(4)
    floor = rng.uniform((-30, -20, -1.5), (60, 20, -1.5), (40_000, 3))
    walls = [rng.uniform((-30, y, -1.5), (60, y + 0.1, 4.0), (15_000, 3)) for y in (-14.0, 11.0)]
    pillars = [rng.uniform((x, y, -1.5), (x + 0.6, y + 0.6, 4.0), (800, 3)) for x, y in rng.uniform(-9, 50, (25, 2))]
    return np.vstack([floor, *walls, *pillars])


def drive(scans: int, step_m: float = 0.15, stands_at: int = 0, stands: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points and pose of the scans of 10 Hz at 1.5 m/s; the odometry trembles by 2 cm.

    Behind scan `stands_at` the robot stands for so many scans more.
    """
    world, rng, taken = hall(), np.random.default_rng(7), []
    rows = [*range(stands_at), *[stands_at] * stands, *range(stands_at, scans)]
    for row in rows:
        where = rng.uniform(-0.02, 0.02, 3) + (step_m * row, 0.3 * np.sin(0.02 * row), 0.0)
        pose = se3.from_yaw(0.05 * np.sin(0.05 * row), where)
        seen = se3.apply(se3.inverse(pose), world[rng.choice(len(world), RETURNS, replace=False)])
        taken.append((seen.astype(np.float32), pose))
    return taken


def command(session: SessionKey, seq: int, stamp: int, taken, travelled_m: float | None = None) -> AppendScan:
    points, pose = taken
    return AppendScan(session, seq, 100 * stamp, pose, DecodedCloud(points), travelled_m=travelled_m)


async def stream_both(world, scans) -> int:
    """Send a drive as a robot does that counts nothing, and as the SDK does; how many scans that has sent."""
    for key in (FULL, THIN):
        await open_session(world, key)
    choice, sent = ScanChoice("described", None), 0
    for row, taken in enumerate(scans):
        await world.use_cases.scans.append(TENANT, command(FULL, row + 1, row, taken))
        offered = choice.look(pose_json(taken[1]), taken[0], ScanMarks.of(SubmapConfig()))
        if offered.chosen is not None:
            sent += 1
            choice.sent(offered.chosen)
            await world.use_cases.scans.append(TENANT, command(THIN, sent, row, taken, offered.way.travelled_m))
    for key in (FULL, THIN):
        await world.use_cases.sessions.finish(TENANT, key)
    return sent


def sources(world, session: SessionKey):
    """Frame, position, clouds and times of the submaps of a session."""

    def read(uow):
        found = uow.submaps.find(TENANT, map_id=session.map_id, session_id=session.session_id)
        return [(one, rows.submap_source(uow, world.context.policy, one)) for one in found]

    return world.context.transactions.read(read).result()


async def test_descriptions_of_a_thinned_and_a_full_stream_are_equal_bit_for_bit():
    world, scans = memory_world(), drive(130)
    sent = await stream_both(world, scans)
    full, thin = sources(world, FULL), sources(world, THIN)
    assert 36 <= sent <= 45, "19.5 m and the trembling at marks half a metre apart"
    assert len(full) == len(thin) == 3
    for (one, its), (other, others) in zip(full, thin, strict=True):
        assert its == others
        assert (one.position_m, one.stamp_ns, one.scan_count) == (other.position_m, other.stamp_ns, other.scan_count)
    recogniser, config = load_recogniser(), world.context.policy.pipeline
    described = [
        recogniser.describe(rows.load_submap(world.context.blobs, record, source), config)
        for record, source in (full[1], thin[1])
    ]
    assert described[0].descriptor.tobytes() == described[1].descriptor.tobytes()
    assert described[0].place == described[1].place


@pytest.mark.parametrize("policy", ["scans=described", "scans=none"])
async def test_scans_that_no_description_is_made_of_are_acknowledged_and_not_kept(tmp_path, policy):
    world = sqlite_world(tmp_path)
    await open_session(world, FULL)
    await policy_set(world, policy)
    acks = []
    for row, taken in enumerate(drive(90)):
        acks.append(await world.use_cases.scans.append(TENANT, command(FULL, row + 1, row, taken)))
        assert acks[-1].committed_seq == row + 1
    kept = [ack.committed_seq for ack in acks if not ack.left_out]
    assert stored_seqs(world, FULL) == kept and len(kept) < 40
    blobs = list((tmp_path / "blobs").rglob("*.*")) + [
        path for path in (tmp_path / "blobs").rglob("*") if path.is_file()
    ]
    assert len({path.name for path in blobs}) == len(kept)
    again = await world.use_cases.scans.append(TENANT, command(FULL, 44, 43, drive(44)[43]))
    assert again.replay and again.committed_seq == 90
    for record, source in sources(world, FULL):
        assert record.scan_count == len(source.clouds)
        assert all(cloud.cloud_sha256 for cloud in source.clouds)
    world.context.transactions.close()


async def test_all_scans_are_kept_where_the_map_keeps_all_or_for_a_while(tmp_path):
    world = sqlite_world(tmp_path)
    await open_session(world, FULL)
    await policy_set(world, "scans=described:1h")
    for row, taken in enumerate(drive(20)):
        ack = await world.use_cases.scans.append(TENANT, command(FULL, row + 1, row, taken))
        assert not ack.left_out
    assert len(stored_seqs(world, FULL)) == 20
    assert await retained(world) is None
    world.context.transactions.close()


async def test_a_robot_that_stands_with_trembling_poses_makes_no_submap():
    """Fifty seconds: what trembled added up to 11 m."""
    world, scans = memory_world(), drive(80, stands_at=40, stands=500)
    sent = await stream_both(world, scans)
    full, thin = sources(world, FULL), sources(world, THIN)
    assert 20 <= sent <= 30
    assert len(full) == len(thin) == 2
    assert [its for _, its in full] == [its for _, its in thin]


@pytest.mark.parametrize("share", [0.0, 0.001, 0.8, 1.0, 2.0])
async def test_a_robot_that_counts_less_than_the_straight_way_is_not_believed(share):
    """It counts in kilometres, or by wheels that are too small: the straight way counts. More may be a winding one."""
    world, points = memory_world(), hall()[:RETURNS].astype(np.float32)
    await open_session(world, FULL)
    for row in range(80):
        taken = points, se3.from_yaw(0.0, (0.15 * row, 0.0, 0.0))
        await world.use_cases.scans.append(TENANT, command(FULL, row + 1, row, taken, share * 0.15 * row))
    session = world.context.transactions.read(lambda uow: uow.sessions.get(TENANT, "town", "full")).result()
    assert session.travelled_m == pytest.approx(max(share, 1.0) * 0.15 * 79, abs=0.25)


@pytest.mark.parametrize("step_m", [0.15, 0.06])
async def test_a_gateway_that_begins_anew_goes_on_choosing(tmp_path, step_m):
    world, scans = sqlite_world(tmp_path), drive(60, step_m)
    await open_session(world, FULL)
    await open_session(world, THIN)
    for row, taken in enumerate(scans):
        await world.use_cases.scans.append(TENANT, command(FULL, row + 1, row, taken))
        if row % 7 == 0:
            world = world.another_gateway()
        await world.use_cases.scans.append(TENANT, command(THIN, row + 1, row, taken))
    read = world.context.transactions.read
    chosen = [
        read(lambda uow, key=key: [one.seq for one in uow.scans.chosen_between("default", "town", key, 1, 60)]).result()
        for key in ("full", "thin")
    ]
    assert chosen[0] == chosen[1] and len(chosen[0]) > 100 * step_m
    world.context.transactions.close()
