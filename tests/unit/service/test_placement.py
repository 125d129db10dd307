"""Maps fall to search processes evenly, few move when one comes or goes, and a busy one shares with the next."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from revisit.service.domain.placement import owners
from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.search.load import MapLoad

FOUR = [LivingProcess(f"search-{number}", ProcessRole.SEARCH, f"host-{number}:8090", ready=True) for number in range(4)]
MAPS = range(1, 2001)


def held(processes):
    return {number: owners(number, processes)[0].process_id for number in MAPS}


def test_each_of_four_processes_holds_about_a_quarter_of_the_maps():
    assert all(400 <= maps <= 600 for maps in Counter(held(FOUR).values()).values())


def test_only_the_maps_of_a_process_that_goes_move():
    before, after = held(FOUR), held(FOUR[:3])
    moved = {number for number in MAPS if before[number] != after[number]}
    assert moved == {number for number in MAPS if before[number] == "search-3"}
    assert len({after[number] for number in moved}) == 3


def test_the_next_of_the_ranking_holds_a_map_that_keeps_one_too_busy():
    (first,), ranking = owners(7, FOUR), []
    processes = FOUR
    for held_by in range(1, 5):
        ranking = [one.process_id for one in owners(7, processes)]
        assert len(ranking) == held_by
        processes = [replace(one, busy=frozenset({7})) if one.process_id == ranking[-1] else one for one in processes]
    assert ranking[0] == first.process_id
    assert owners(8, processes) == [owners(8, processes)[0]]


def test_nobody_holds_a_map_where_there_is_no_process():
    assert owners(7, []) == []


def test_a_map_is_busy_once_it_takes_most_of_a_core_for_some_time_and_no_more_when_it_is_asked_less():
    load = MapLoad()
    rounds = []
    for cpu_s in (0.9, 0.9, 0.9, 0.9, 0.0, 0.0):
        load.note(5, cpu_s)
        load.note(6, 0.1)
        rounds.append(load.busy(1.0))
    assert rounds == [frozenset(), frozenset(), frozenset(), frozenset({5}), frozenset(), frozenset()]
