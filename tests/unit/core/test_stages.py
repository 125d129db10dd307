"""Stage times are measured for a caller that asks for them."""

from __future__ import annotations

import pytest

from revisit.core.config import PipelineConfig
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.stages import stage, stage_times


@stage("first")
def first(number: int) -> int:
    return number + 1


@stage("second")
def failing() -> None:
    raise ValueError


def test_a_stage_is_timed_only_inside_the_block_that_asks():
    assert first(1) == 2
    with stage_times() as times:
        assert first(first(1)) == 3
        with pytest.raises(ValueError):
            failing()
    assert list(times) == ["first"] and times["first"] > 0
    first(1)
    assert list(times) == ["first"]


def test_blocks_inside_one_another_do_not_mix():
    with stage_times() as outer:
        with stage_times() as inner:
            first(1)
        assert (list(inner), list(outer)) == (["first"], [])
        first(1)
    assert list(outer) == ["first"]


def test_describing_a_place_names_every_stage_of_the_method(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))], scans=2)
    with stage_times() as times:
        describe(submap, load_packaged_models(), PipelineConfig())
    names = ["implicit_map", "surface", "clusters", "bev", "micro", "spectra", "fusion", "place"]
    assert list(times) == names
