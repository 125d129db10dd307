"""Campaigns themselves: how long they are, when they stop, what they state."""

from __future__ import annotations

import json

import pytest

from tests.support.campaigns import Campaign, sizes


def test_a_campaign_does_as_many_rounds_as_it_is_asked_for(monkeypatch):
    monkeypatch.delenv("REVISIT_CAMPAIGN_MINUTES", raising=False)
    campaign = Campaign("P1", 3)
    assert list(campaign) == [1, 2, 3]
    assert campaign.done == 3 and campaign.over


def test_a_campaign_stops_when_its_time_is_up_and_says_how_many_it_did(monkeypatch, tmp_path):
    monkeypatch.setenv("REVISIT_CAMPAIGN_MINUTES", "0.5")
    monkeypatch.setenv("REVISIT_FIGURES", str(tmp_path / "figures.jsonl"))
    now_s = iter([100.0, 100.0, 120.0, 130.0, 131.25])
    campaign = Campaign("P1", 1_000, now_s=lambda: next(now_s))
    assert list(campaign) == [1, 2]
    campaign.publish("0 lost")
    (line,) = (json.loads(text) for text in (tmp_path / "figures.jsonl").read_text().splitlines())
    assert line.pop("date")
    assert line.pop("test").endswith("test_a_campaign_stops_when_its_time_is_up_and_says_how_many_it_did")
    assert line == {"promise": "P1", "figure": "0 lost", "size": 2, "asked": 1_000, "seconds": 31.2}


def test_a_round_that_fails_is_not_counted(monkeypatch):
    monkeypatch.delenv("REVISIT_CAMPAIGN_MINUTES", raising=False)
    campaign = Campaign("P1", 5)
    rounds = iter(campaign)
    assert [next(rounds), next(rounds), next(rounds)] == [1, 2, 3]
    with pytest.raises(ValueError, match="third"):
        rounds.throw(ValueError("third"))
    assert campaign.done == 2


def test_the_long_size_comes_from_the_environment_and_is_slow(monkeypatch):
    monkeypatch.delenv("REVISIT_TEST_KILLS", raising=False)
    quick, full = sizes("KILLS", 25, 1_000)
    assert (quick.values, quick.marks, full.values) == ((25,), (), (1_000,))
    assert [mark.name for mark in full.marks] == ["slow"]
    monkeypatch.setenv("REVISIT_TEST_KILLS", "50")
    assert sizes("KILLS", 25, 1_000)[1].values == (50,)
