"""Generated and damaged bytes for every reader of foreign bytes: an answer or a documented refusal, nothing else."""

from __future__ import annotations

import gzip
import os
import struct

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from revisit.core.codec import neural_map as codec
from revisit.core.codec import place as place_form
from revisit.core.codec.mesh import Mesh, pack_mesh
from revisit.core.errors import DataLoss
from revisit.formats import MEDIA_TYPES, PCD, PLY, QUANTISED, encode_pcd, encode_ply, encode_quantised
from revisit.service.features.ingest.clouds import StoredCloud, pack_cloud
from tests.fuzz.targets import DIGEST_BYTES, FILES, TARGETS, refusing
from tests.support.campaigns import Campaign
from tests.support.cloud_files import records, valid_files
from tests.support.places import a_place

EXAMPLES = int(os.environ.get("REVISIT_FUZZ_EXAMPLES", "40"))


def seeds() -> dict[str, list[bytes]]:
    """Good bytes for each target."""
    values = records(120)
    by_type = {media_type: [] for media_type in MEDIA_TYPES}
    for media_type, data in valid_files(values).values():
        by_type[media_type].append(data)
    number = np.arange(120)
    colours = np.column_stack([number, number, number]).astype(np.uint8)
    columns = {"ring": number, "time": number * 10**6, "rgb": colours}
    for media_type, encode in ((PCD, encode_pcd), (PLY, encode_ply), (QUANTISED, encode_quantised)):
        by_type[media_type].append(encode(values[:, :3], columns))
    triangle = Mesh(values[:3, :3], np.tile(np.float32([0, 0, 1]), (3, 1)), np.array([[0, 1, 2]], dtype=np.int32))
    stored = a_place(values[:8, :2]).to_blob()
    neural_map = codec.pack({"count": 0}, [b"abc", b""])
    return {
        **by_type,
        "gzip": [gzip.compress(values.tobytes(), mtime=0)],
        "zstd": [zstandard.compress(values.tobytes())],
        "packed cloud header": by_type["application/vnd.revisit.pointcloud2"],
        "json map": [b'{"map_id": "town", "display_name": "Town", "tau_m": 10.5, "leave_distance_m": 3}'],
        "json search": [b'{"descriptor": [1.0, 2e3], "model_version": "m", "k": 3, "prior_position_m": [0, 1, 2]}'],
        "page token": [b"YWZ0ZXI6MTI="],
        "neural map": [neural_map],
        "neural map behind its checksum": [neural_map[len(codec.CONTAINER.magic) : -DIGEST_BYTES]],
        "place": [stored],
        "place behind its checksum": [stored[len(place_form.MAGIC) : -DIGEST_BYTES]],
        "stored cloud": [pack_cloud(StoredCloud(values[:, :3], {"intensity": values[:, 3]})), *by_type[QUANTISED]],
        "stored mesh": [pack_mesh(triangle)],
    }


SEEDS = seeds()
LIMITS = settings(max_examples=EXAMPLES, deadline=None, database=None, suppress_health_check=list(HealthCheck))


@st.composite
def damaged(draw, good: list[bytes]) -> bytes:
    """Good bytes in which some are changed, left out, doubled or joined with those of another file."""
    data = bytearray(draw(st.sampled_from(good)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, min(len(data) - 1, 400))))
        match draw(st.integers(0, 4)):
            case 0:
                data[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
            case 1:
                del data[at : at + draw(st.integers(1, 40))]
            case 2:
                data[at:at] = data[at : at + draw(st.integers(1, 40))]
            case 3:
                data[at : at + 4] = struct.pack("<I", draw(st.integers(0, 2**32 - 1)))
            case 4:
                number = draw(st.sampled_from([b"-1", b"0", b"99999999999999999999", b"nan", b"1e309", b"\x00", b"\n"]))
                data[at : at + 1] = number
    return bytes(data)


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_and_random_bytes_are_read_or_refused(name):
    @LIMITS
    @given(damaged(SEEDS[name]) | st.binary(max_size=300))
    def check(data):
        if not campaign.over:
            TARGETS[name](data)
            campaign.done += 1

    campaign = Campaign("P18", EXAMPLES)
    check()
    campaign.publish(f"{name}: 0 undocumented errors")


@pytest.mark.parametrize("name", TARGETS)
def test_every_file_of_the_corpus_is_read_or_refused_by_every_reader(name):
    for file in FILES.iterdir():
        TARGETS[name](file.read_bytes())


def test_every_target_starts_from_good_bytes():
    assert SEEDS.keys() == TARGETS.keys()
    assert all(SEEDS.values())


def test_a_target_lets_an_undocumented_error_through():
    def careless(data):
        return data[10]

    with pytest.raises(IndexError):
        refusing(careless, DataLoss)(b"short")
