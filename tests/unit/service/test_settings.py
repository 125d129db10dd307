"""Settings come from REVISIT_* and reach the parts that need them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from pydantic import ValidationError

from revisit.service.capacity.limits import CapacityLimits
from revisit.service.domain.identity import content_hash, validated_id
from revisit.service.domain.policy import Policy
from revisit.service.settings import GONE, GROUPS, Settings
from revisit.service.settings_loading import UnusableSettings, load_settings
from tests.support.records import a_map


@pytest.fixture(autouse=True)
def bare_environment(monkeypatch):
    import os

    for name in list(os.environ):
        if name.startswith("REVISIT_"):
            monkeypatch.delenv(name)


def test_the_defaults_listen_on_loopback_only():
    settings = Settings()
    assert (settings.host, settings.http_port, settings.grpc_port) == ("127.0.0.1", 8080, 8090)
    assert not settings.exposed and settings.workers >= 1


def test_every_setting_is_in_one_group_or_for_tests_and_none_of_them_is_gone():
    shown = [name for names in GROUPS.values() for name in names]
    assert sorted([*shown, "for_tests"]) == sorted(Settings.model_fields)
    assert len(GROUPS) == 4 and GONE.keys().isdisjoint(Settings.model_fields)


@pytest.mark.parametrize(
    ("host", "exposed"),
    [("127.0.0.1", False), ("127.9.9.9", False), ("::1", False), ("localhost", False)]
    + [("0.0.0.0", True), ("::", True), ("10.0.0.1", True), ("robots.example", True)],
)
def test_an_address_is_exposed_unless_it_is_surely_loopback(host, exposed):
    assert Settings(host=host).exposed is exposed


def test_the_environment_sets_the_window_and_the_queue(monkeypatch, tmp_path):
    monkeypatch.setenv("REVISIT_HOME", str(tmp_path))
    monkeypatch.setenv("REVISIT_TAU_M", "20")
    monkeypatch.setenv("REVISIT_STRIDE_M", "4")
    monkeypatch.setenv("REVISIT_FOR_TESTS", '{"lease_s": 2.5}')
    settings = Settings()
    pipeline = settings.policy.pipeline
    assert (pipeline.submap.tau, pipeline.submap.stride, pipeline.loop.leave_distance) == (20.0, 4.0, 10.0)
    assert (settings.policy.lease_ms, settings.database) == (2500, tmp_path / "revisit.db")


def test_a_map_has_its_own_rules_for_loop_closures():
    of_map = replace(a_map(), loop_candidates=3, min_score=0.9, min_overlap=0.0, max_seen_through=1.0)
    own = Settings().policy.for_map(of_map)
    assert (own.loop.candidates, own.verification.min_score) == (3, 0.9)
    assert (own.verification.min_overlap, own.verification.max_seen_through) == (0.0, 1.0)


@pytest.mark.parametrize("name", ["HTTP_PORT", "WORKERS", "TAU_M"])
def test_a_value_out_of_bounds_is_refused(monkeypatch, name):
    monkeypatch.setenv(f"REVISIT_{name}", "-1")
    with pytest.raises(ValidationError, match=name.lower()):
        Settings()


@pytest.mark.parametrize("value", ['{"lease_s": -1}', '{"max_attempts": 0}', '{"leases_s": 1}', "{", "1"])
def test_what_is_for_tests_alone_is_validated_too(monkeypatch, value):
    monkeypatch.setenv("REVISIT_FOR_TESTS", value)
    with pytest.raises(UnusableSettings, match="REVISIT_FOR_TESTS"):
        load_settings()


def test_a_tenant_has_twice_the_rate_of_its_clients(monkeypatch):
    monkeypatch.setenv("REVISIT_CLIENT_POINTS_PER_S", "3e6")
    capacity = Settings().capacity
    assert (capacity.client_points_per_s, capacity.tenant_points_per_s) == (3e6, 6e6)
    monkeypatch.delenv("REVISIT_CLIENT_POINTS_PER_S")
    assert Settings().capacity == CapacityLimits()


def test_a_map_overrides_only_what_it_names():
    policy = Policy()
    assert policy.for_map(a_map()).submap.stride == 5.0
    assert policy.for_map(a_map()).submap.tau == policy.pipeline.submap.tau
    assert policy.for_map(a_map()).loop == policy.pipeline.loop


def test_the_parameters_of_a_map_are_made_once_for_its_overrides():
    policy = Policy()
    assert policy.for_map(a_map()) is policy.for_map(a_map())
    assert policy.for_map(replace(a_map(), stride_m=2.5)).submap.stride == 2.5
    assert policy.for_map(replace(a_map(), min_score=0.7)).verification.min_score == 0.7


@pytest.mark.parametrize("value", ["a", "A9", "a.b_c-d", "x" * 64])
def test_good_ids_are_taken(value):
    assert validated_id(value, "map_id") == value


@pytest.mark.parametrize("value", ["", ".", "-a", "_a", "a/b", "a b", "x" * 65, "ä", "a\n", "a\x00", "١"])
def test_bad_ids_are_refused(value):
    with pytest.raises(Exception, match="map_id must match"):
        validated_id(value, "map_id")


def test_different_contents_have_different_hashes():
    contents = [["a", "b"], ["ab", ""], ["a", None, "b"], [b"a", "b"], ["1"], [1], [1.0], [None], [""], []]
    assert len({content_hash(parts) for parts in contents}) == len(contents)
