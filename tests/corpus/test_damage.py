"""Each file of the corpus, cut at 64 places and with 1,000 flipped bits: read or refused, in little memory and time."""

from __future__ import annotations

import collections
import itertools
import random
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from revisit.core.errors import DataLoss, ErrorCode, RevisitError
from revisit.service.status import STATUS
from tests.corpus.damage import Sound, cuts, flips, sound_files
from tests.corpus.rows import CloudToSend
from tests.corpus.sending import Answer, grpc_cloud, rest_cloud
from tests.support.campaigns import Campaign, sizes
from tests.support.patience import in_time

MIB = 2**20
SLACK_BYTES = 64 * MIB
SLOWEST_S = 2.0
"""Of one core; tracing memory makes the slowest of them, bombs, several times as slow as 0.02 s."""
REFUSALS = {
    ErrorCode.MALFORMED_BODY, ErrorCode.UNUSABLE_CLOUD, ErrorCode.BAD_FIELD, ErrorCode.UNSUPPORTED_ENCODING,
    ErrorCode.TOO_LARGE, ErrorCode.NOT_FOUND,
}  # fmt: skip
"""What damage to a cloud, a message around one or a JSON body may be refused with."""


def outcome(sound: Sound, data: bytes) -> str:
    """`OK`, or the reason of the refusal. Raises what no reader may raise."""
    try:
        sound.read(data)
    except RevisitError as error:
        if error.code not in REFUSALS:
            raise
        return error.code.value
    return "OK"


def damaged(sound: Sound, cut_count: int, flip_count: int) -> Iterator[bytes]:
    """All damage to one file; the same in every run."""
    return itertools.chain(cuts(sound.data, cut_count), flips(sound.data, flip_count, random.Random(sound.name)))


def in_turn(files: list[Sound], cut_count: int, flip_count: int) -> Iterator[tuple[Sound, bytes]]:
    """One damage to each file, then the next to each: a campaign that ends early has damaged all of them."""
    each = [zip(itertools.repeat(sound), damaged(sound, cut_count, flip_count)) for sound in files]
    return (damage for turn in itertools.zip_longest(*each) for damage in turn if damage is not None)


@pytest.fixture
def files():
    """All of them, read once, for the first read of a kind imports what it needs; from here on memory is traced."""
    sounds = sound_files()
    for sound in sounds:
        outcome(sound, sound.data)
    tracemalloc.start()
    yield sounds
    tracemalloc.stop()


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("reads", sizes("DAMAGED_READS", 8, 1064))
def test_a_damaged_file_is_read_or_refused_in_bounded_memory_and_time(files, reads):
    """`reads` of each file: half of them cut short, but no more than 64, the others with flipped bits."""
    cut_count = min(64, reads // 2)
    flip_count = reads - cut_count
    campaign = Campaign("P18", sum(cut_count + (flip_count if sound.data else 0) for sound in files))
    reasons: collections.Counter[str] = collections.Counter()
    most_bytes, slowest = 0, (0.0, "")
    for _, (sound, data) in zip(campaign, in_turn(files, cut_count, flip_count), strict=False):
        tracemalloc.reset_peak()
        held, _ = tracemalloc.get_traced_memory()
        began_s = time.thread_time()
        reasons[outcome(sound, data)] += 1
        slowest = max(slowest, (time.thread_time() - began_s, sound.name))
        taken = tracemalloc.get_traced_memory()[1] - held
        assert taken <= 3 * len(data) + SLACK_BYTES, (sound.name, len(data), taken)
        most_bytes = max(most_bytes, taken)
    assert in_time(slowest[0], SLOWEST_S), slowest
    assert len(files) >= 150
    assert reasons["MALFORMED_BODY"] > reasons.total() // 4 and reasons["OK"] > 0
    assert reasons.total() == campaign.done
    most = f"at most {most_bytes / MIB:.1f} MiB and {1000 * slowest[0]:.0f} ms of a core ({slowest[1]})"
    campaign.publish(f"damaged reads of {len(files)} files: 0 undocumented errors, {most}; {dict(reasons)}")


def refuse(data: bytes) -> None:
    raise DataLoss


def test_the_check_notices_an_undocumented_error():
    sound = Sound("careless", b"abc", lambda data: data[10])
    with pytest.raises(IndexError):
        outcome(sound, b"abc")
    lost = Sound("lost", b"abc", refuse)
    with pytest.raises(DataLoss):
        outcome(lost, b"abc")


@dataclass(frozen=True)
class Damaged(CloudToSend):
    """A cloud whose bytes are not those of its file."""

    data: bytes = b""


def sample(size: int) -> Iterator[CloudToSend]:
    """Of each cloud of at most 128 KiB, `size` cuts and `size` flips."""
    for sound in sound_files():
        if sound.cloud is not None and len(sound.data) <= 128 * 1024:
            yield from (Damaged(**vars(sound.cloud), data=data) for data in damaged(sound, size, size))


def judge(answer: Answer, stored: int | str, status_of) -> None:
    """Stored, or refused with the status that the error table gives to a reason that is allowed here."""
    if answer.status != stored:
        code = ErrorCode(answer.reason)
        assert code in REFUSALS and answer.status == status_of(STATUS[code]), answer


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("size", "every"), [pytest.param(1, 5), pytest.param(20, 1, marks=pytest.mark.slow)])
def test_a_damaged_cloud_is_stored_or_refused_by_a_running_service(corpus_service, size, every):
    session = corpus_service.new_session()
    for number, cloud in enumerate(itertools.islice(sample(size), 0, None, every)):
        over_rest = rest_cloud(corpus_service.http, f"/v1/{session}/submaps", cloud, submap_id=f"h{number}")
        judge(over_rest, 202, lambda status: status.http)
        if cloud.encoding is None:
            over_grpc = grpc_cloud(corpus_service.channel, session, cloud, f"g{number}")
            judge(over_grpc, "OK", lambda status: status.grpc)
    whole = CloudToSend.read("good.rvq")
    assert rest_cloud(corpus_service.http, f"/v1/{session}/submaps", whole, submap_id="whole").status == 202
