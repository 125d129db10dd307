"""A recogniser without a method, for tests of the service: a place looks like the cloud it was made of.

The descriptor is the histogram of the points' heights (clouds of the same seed match, others do not). Clouds of
special sizes misbehave: see the constants. REVISIT_FAKE_DELAY_S makes each description take that long,
REVISIT_FAKE_BUSY_S that much of a core; none ends before the file REVISIT_FAKE_GATE is there.
"""

from __future__ import annotations

import ctypes
import os
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from revisit.core.codec.mesh import Mesh
from revisit.core.config import PipelineConfig, Profile
from revisit.core.errors import DataLoss, DegenerateCloud
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.verification import Authority, InitialPose, PairVerdict
from revisit.service.ports.recogniser import SubmapDescription
from tests.support.verdicts import rejected, verified

KILLS_THE_WORKER = 666
RAISES = 667
CANNOT_BE_DESCRIBED = 668
HANGS = 669
HOLDS_EVERY_THREAD = 670
EATS_MEMORY = 671
SEGFAULTS = 672

BINS = 64
ACCEPTED_FROM = 0.98
JUMP_M = 15.0


def _wait_at(gate: str | None) -> None:
    while gate and not Path(gate).exists():
        time.sleep(0.01)


def _be_busy(cpu_s: float) -> None:
    end_s = time.thread_time() + cpu_s
    while time.thread_time() < end_s:
        pass


def _hang() -> None:
    threading.Event().wait()


def _hold_every_thread() -> None:
    # One call for an hour that does not give the interpreter's lock back, and asks nothing of the processor.
    ctypes.PyDLL(None).sleep(3600)


def _eat_memory() -> None:
    eaten = []
    while True:
        eaten.append(np.ones(2**27))


def _segfault() -> None:
    ctypes.string_at(0)


MISCHIEF = {HANGS: _hang, HOLDS_EVERY_THREAD: _hold_every_thread, EATS_MEMORY: _eat_memory, SEGFAULTS: _segfault}


class FakeRecogniser:
    """`PlaceRecogniser` by height histogram."""

    model_version = "fake-1"

    def model_of(self, profile: Profile) -> str:
        """Another one for each profile."""
        return self.model_version if profile is Profile.PRODUCT else f"{self.model_version}-{profile}"

    def inspect(self, scans: Sequence[Scan]) -> tuple[str, ...]:
        """Jumps of 15 m and more alone."""
        positions = [scan.T_odom_sensor[:3, 3] for scan in scans]
        steps = [float(np.linalg.norm(after - before)) for before, after in pairwise(positions)]
        return ("pose_jump",) if max(steps, default=0.0) >= JUMP_M else ()

    def describe(self, submap: Submap, config: PipelineConfig) -> SubmapDescription:
        """A description, or misbehaviour for clouds of the special sizes."""
        time.sleep(float(os.environ.get("REVISIT_FAKE_DELAY_S", "0")))
        _be_busy(float(os.environ.get("REVISIT_FAKE_BUSY_S", "0")))
        _wait_at(os.environ.get("REVISIT_FAKE_GATE"))
        if len(submap.points) == KILLS_THE_WORKER:
            os._exit(9)
        if len(submap.points) in MISCHIEF:
            MISCHIEF[len(submap.points)]()
        if len(submap.points) == RAISES:
            raise RuntimeError("the method has a fault")
        if len(submap.points) == CANNOT_BE_DESCRIBED:
            raise DegenerateCloud
        counts, _ = np.histogram(submap.levelled().points[:, 2], bins=BINS, range=(-8.0, 8.0))
        descriptor = (counts / np.linalg.norm(counts)).astype(np.float32)
        neural_map = b"neural " + descriptor.tobytes()
        return SubmapDescription(descriptor, descriptor.tobytes(), neural_map, (), {"all": 0.0})

    def release(self) -> None:
        """See `PlaceRecogniser`; it keeps nothing."""

    def describe_again(self, neural_map: bytes, place: bytes | None, config: PipelineConfig) -> SubmapDescription:
        """The same descriptor, reversed: that of another model."""
        if not neural_map.startswith(b"neural "):
            raise DataLoss("not a neural map")
        descriptor = np.frombuffer(neural_map.removeprefix(b"neural "), dtype=np.float32)[::-1].copy()
        return SubmapDescription(descriptor, descriptor.tobytes())

    def mesh(self, neural_map: bytes, config: PipelineConfig) -> Mesh:
        """One triangle."""
        if not neural_map.startswith(b"neural "):
            raise DataLoss("not a neural map")
        corners, up = np.eye(3, dtype=np.float32), np.tile(np.float32([0, 0, 1]), (3, 1))
        return Mesh(corners, up, np.array([[0, 1, 2]], dtype=np.int32))

    def verify(
        self, query: bytes, match: bytes, similarity: float, config: PipelineConfig, initial: InitialPose | None = None
    ) -> PairVerdict:
        """Accepted where the descriptors nearly agree; the transform is 1 m along x, or the initial pose."""
        if query.startswith(PLACED):
            return _verified_by_pose(query, match)
        agreement = float(np.frombuffer(query, dtype=np.float32) @ np.frombuffer(match, dtype=np.float32))
        T_match_query = np.eye(4)
        T_match_query[0, 3] = 1.0
        if initial is not None and initial.authority is not Authority.HINT:
            T_match_query = initial.T_match_query
        if agreement < ACCEPTED_FROM:
            return rejected()
        return verified(T_match_query, agreement, overlap=agreement)


PLACED = b"placed "
"""How the blob of a place begins that a made-up fleet has seen: its true pose follows, 16 float64."""

SEEN_FROM_M = 8.0


def placed(T_world_submap: np.ndarray) -> bytes:
    """The blob of a place at a pose of the world."""
    return PLACED + np.asarray(T_world_submap, dtype="<f8").tobytes()


def _verified_by_pose(query: bytes, match: bytes) -> PairVerdict:
    """Accepted where the two lie within 8 m, with the pose between them, 1 cm off; the same whichever is the query."""
    first, second = sorted((query, match))
    T_world_first, T_world_second = (np.frombuffer(one[len(PLACED) :], "<f8").reshape(4, 4) for one in (first, second))
    T = np.linalg.inv(T_world_first) @ T_world_second
    if np.linalg.norm(T[:3, 3]) > SEEN_FROM_M:
        return rejected()
    T[:2, 3] += 0.01
    covariance = np.diag([0.05**2] * 3 + [0.003**2] * 3)
    if match is not first:
        T = np.linalg.inv(T)
        covariance = se3.adjoint(T) @ covariance @ se3.adjoint(T).T
    return verified(T, covariance=covariance)


NOWHERE = np.full(BINS, 0.125, dtype=np.float32)
"""A unit vector that no place has."""


class MistakenRecogniser(FakeRecogniser):
    """What it describes is nowhere: whatever of it is stored can be told from what others found."""

    def describe(self, submap: Submap, config: PipelineConfig) -> SubmapDescription:
        """As the other does, with the descriptor of no place."""
        return replace(super().describe(submap, config), descriptor=NOWHERE)


def load_mistaken() -> MistakenRecogniser:
    """What `recogniser` of REVISIT_FOR_TESTS, tests.support.fake_recogniser:load_mistaken, loads."""
    return MistakenRecogniser()


def load() -> FakeRecogniser:
    """What `recogniser` of REVISIT_FOR_TESTS, tests.support.fake_recogniser:load, loads."""
    time.sleep(float(os.environ.get("REVISIT_FAKE_LOAD_S", "0")))
    return FakeRecogniser()
