"""Of a window that is too long for one submap, only the scans that are used are read."""

from __future__ import annotations

from itertools import pairwise

from revisit.service.application.ingest.submap_source import MAX_SCANS, chosen_seqs


def test_all_scans_of_a_window_are_chosen_up_to_the_limit():
    assert chosen_seqs(7, 7) == [7]
    assert chosen_seqs(7, 6 + MAX_SCANS) == list(range(7, 7 + MAX_SCANS))


def test_of_an_hour_at_a_red_light_a_bounded_number_is_chosen_evenly_and_with_both_ends():
    chosen = chosen_seqs(101, 36_100)
    steps = {later - earlier for earlier, later in pairwise(chosen)}
    assert (len(chosen), chosen[0], chosen[-1]) == (MAX_SCANS, 101, 36_100)
    # 35,999 / 399 = 90.2 scans apart.
    assert steps == {90, 91}
