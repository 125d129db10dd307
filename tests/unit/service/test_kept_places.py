"""A worker unpacks a place once: candidates come again with a robot's next submap."""

from __future__ import annotations

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.place import Place
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.verification import RejectedLoop
from revisit.core.verification.verdict import RejectionReason
from revisit.service.adapters import core_recogniser
from revisit.service.adapters.core_recogniser import PLACES_PREPARED, PLACES_READ, CoreRecogniser
from tests.support.block_worlds import along, seen, yard
from tests.support.places import a_place

REJECTED = RejectedLoop(RejectionReason.DEGENERATE_PLACE)


def test_a_place_that_is_compared_again_is_not_unpacked_again(monkeypatch) -> None:
    unpacked: list[bytes] = []
    read = Place.from_blob
    monkeypatch.setattr(Place, "from_blob", lambda blob: (unpacked.append(blob), read(blob))[1])
    recogniser, config = CoreRecogniser(), PipelineConfig()
    blobs = [a_place(np.full((2, 2), float(n))).to_blob() for n in range(3)]
    for match in (blobs[1], blobs[2], blobs[1]):
        assert recogniser.verify(blobs[0], match, 0.5, config).reason == "DEGENERATE_PLACE"
    assert unpacked == blobs


def test_a_place_that_was_just_described_is_not_unpacked_to_be_compared(monkeypatch) -> None:
    recogniser, config = CoreRecogniser(), PipelineConfig()
    drive = seen(yard(1, False), along((-20, 0), (-10, 0)), 1)
    scans = [Scan.validated(points, T_world_sensor, n * 10**9) for n, (points, T_world_sensor) in enumerate(drive)]
    place = recogniser.describe(Submap.from_scans(scans, config.submap), config).place
    monkeypatch.setattr(Place, "from_blob", lambda _: None)
    assert recogniser.verify(place, place, 1.0, config).measurement is not None


def test_a_query_fits_with_all_its_candidates_and_as_read_with_twice_those_of_today() -> None:
    candidates = PipelineConfig().loop.candidates
    assert candidates + 1 <= PLACES_PREPARED
    assert 2 * candidates + 1 <= PLACES_READ


def test_a_place_that_was_prepared_long_ago_is_prepared_anew_from_what_was_read(monkeypatch) -> None:
    prepared: list[Place] = []
    monkeypatch.setattr(core_recogniser, "PLACES_PREPARED", 2)
    monkeypatch.setattr(core_recogniser, "verify", lambda query, match, *_, **__: prepared.append(match) or REJECTED)
    recogniser, config = CoreRecogniser(), PipelineConfig()
    blobs = [a_place(np.full((2, 2), float(n))).to_blob() for n in range(3)]
    for match in (1, 2, 1):
        recogniser.verify(blobs[0], blobs[match], 0.5, config)
    assert prepared[0] is not prepared[2]
    assert prepared[0].points is prepared[2].points
