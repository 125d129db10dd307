"""Conversations held in the settings, and what came of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lab.relocalisation.recordings import SeenView, Setting
from revisit.core.acceptance import StationInMap
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.index import FaissIndex, IndexEntry, SearchFilter
from revisit.core.pair_verdict import InitialPose, PairVerdict
from revisit.core.pipeline import verify
from revisit.core.relocalisation.answer import RelocalisationAnswer, RelocalisationState
from revisit.core.relocalisation.conversation import Relocalisation
from revisit.core.relocalisation.looking import StoredPlace, answered

RIGHT_M, RIGHT_DEG = 1.0, 5.0
WITHIN_M = 30.0
COVERED_M = 4.0
"""A view is in the map where a submap was taken so near: submaps lie up to 5.5 m apart, in small scenes, too."""


@dataclass
class SettingPlaces:
    """The places of a setting, asked by one view after the other. Verdicts without an initial pose are kept."""

    setting: Setting
    verdicts: dict[tuple[int, int, int], PairVerdict] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = self.setting.known
        self.index = FaissIndex(len(known[0].vector))
        stations = [one.station for one in known]
        entries = [IndexEntry(row, 0, one.ordinal, one.T_odom_submap[:3, 3]) for row, one in enumerate(stations)]
        self.index.add(entries, np.stack([one.vector for one in known]))
        self.positions = np.array([one.station.T_odom_submap[:3, 3] for one in known])
        self.asked: tuple[int, int] = (0, 0)
        self.verifications = 0

    def ask(self, conversation: int, number: int) -> SeenView:
        """The view that is compared from now on."""
        self.asked = conversation, number
        self.view = self.setting.conversations[conversation][number]
        return self.view

    def alike(self, count: int) -> list[StoredPlace]:
        """See MapOfPlaces."""
        assert self.view.vector is not None
        matches = self.index.search(self.view.vector, count, SearchFilter())
        self.similarity = {match.id: match.similarity for match in matches}
        return [self._stored(match.id) for match in matches]

    def around(self, frame: str, position_m: NDArray[np.float64], within_m: float) -> list[StoredPlace]:
        """See MapOfPlaces."""
        apart_m = np.linalg.norm(self.positions - position_m, axis=1)
        return [self._stored(row) for row in np.flatnonzero(apart_m <= within_m).tolist()]

    def descriptor(self, place: StoredPlace) -> NDArray[np.float32]:
        """See MapOfPlaces."""
        return self.setting.known[place.key].vector

    def verify(self, place: StoredPlace, initial: InitialPose | None) -> PairVerdict:
        """See MapOfPlaces."""
        key = (*self.asked, place.key)
        if initial is None and key in self.verdicts:
            return self.verdicts[key]
        self.verifications += 1
        assert self.view.place is not None
        similarity = self.similarity.get(place.key, 0.0)
        rules = self.setting.config.verification
        found = verify(self.view.place, self.setting.known[place.key].place, similarity, rules, initial)
        if initial is None:
            self.verdicts[key] = found
        return found

    def _stored(self, row: int) -> StoredPlace:
        station = self.setting.known[row].station
        return StoredPlace(row, station, StationInMap("map", station.T_odom_submap))


def is_right(view: SeenView, T: Matrix4) -> bool:
    """Whether a pose is that of a view."""
    error = se3.inverse(view.T_map_view) @ T
    return bool(np.linalg.norm(error[:3, 3]) < RIGHT_M and se3.rotation_angle(error) < np.radians(RIGHT_DEG))


@dataclass(frozen=True)
class Held:
    """A conversation as it went: the answer to each view with the true pose, and CPU seconds of each."""

    answers: list[tuple[SeenView, RelocalisationAnswer]]
    in_map: bool
    in_map_all_along: bool
    seconds: list[float]
    beliefs: list[str]

    def right(self, view: SeenView, T: Matrix4) -> bool:
        """Whether a pose is that of the view."""
        return is_right(view, T)

    @property
    def placed(self) -> list[bool]:
        """Whether each single pose was right."""
        return [
            self.right(view, answer.poses[0].T_frame_view)
            for view, answer in self.answers
            if answer.state == RelocalisationState.PLACED
        ]

    @property
    def placed_at_m(self) -> float:
        """The way to the first right single pose."""
        for view, answer in self.answers:
            if answer.state == RelocalisationState.PLACED and self.right(view, answer.poses[0].T_frame_view):
                return answer.travelled_m
        return float("inf")


def hold(places: SettingPlaces, number: int) -> Held:
    """Hold one conversation to its end."""
    setting = places.setting
    conversation, answers, seconds, beliefs = Relocalisation(setting.config), [], [], list[str]()
    for row in range(len(setting.conversations[number])):
        view = places.ask(number, row)
        began = time.process_time()
        if view.place is None:
            answer = conversation.lost(view.travelled_m)
        else:
            answer = answered(conversation, view.T_odom_view, view.travelled_m, places, setting.config)
        seconds.append(time.process_time() - began + view.describe_s)
        answers.append((view, answer))
        beliefs.append(_belief(view, conversation))
    seen = setting.conversations[number]
    near = [
        float(np.linalg.norm(places.positions - view.T_map_view[:3, 3], axis=1).min()) <= COVERED_M
        for view in seen
        if view.travelled_m <= WITHIN_M
    ]
    return Held(answers, near[0], all(near), seconds, beliefs)


def _belief(view: SeenView, conversation: Relocalisation) -> str:
    """Where the true pose stands among the hypotheses: its place, weight and views, and the best other's."""
    found = conversation.state.hypotheses
    true = [row for row, one in enumerate(found) if is_right(view, one.carried(view.T_odom_view))]
    others = [one for row, one in enumerate(found) if row not in true]
    told = [f"#{row} {found[row].log_weight:.1f} v{found[row].views} a{found[row].accepted}" for row in true[:1]]
    told += [f"other {one.log_weight:.1f} v{one.views} a{one.accepted}" for one in others[:1]]
    return f"[{len(found)}: {', '.join(told)}; none {conversation.state.none:.1f}]"


def row_of(name: str, held: Sequence[Held]) -> str:
    """A line of the table."""
    inside = [one for one in held if one.in_map_all_along]
    outside = [one for one in held if not one.in_map]
    placed = [one for one in inside if one.placed_at_m <= WITHIN_M]
    wrong = sum(one.placed.count(False) for one in held)
    ways = sorted(one.placed_at_m for one in placed)
    unknown = [one for one in outside if all(answer.state != RelocalisationState.PLACED for _, answer in one.answers)]
    first, further = [one.seconds[0] for one in held], [s for one in held for s in one.seconds[1:]]
    answers = sum(len(one.answers) for one in held)
    return (
        f"| {name} | {len(placed)} of {len(inside)} | {ways[len(ways) // 2] if ways else float('nan'):.0f} | "
        f"{wrong} of {answers} | {len(unknown)} of {len(outside)} | {max(first):.2f} | "
        f"{np.mean(further):.2f} ({np.max(further):.2f}) |"
    )


HEAD = (
    "| setting | placed within 30 m | median m | false | never placed outside | first s | further s, mean (max) |\n"
    "|---|---|---|---|---|---|---|"
)


def story_of(number: int, held: Held) -> str:
    """A conversation in short: for each view its travel, and what was told; `+` a right pose, `!` a wrong one alone."""
    parts = []
    for (view, answer), belief in zip(held.answers, held.beliefs, strict=True):
        if answer.state == RelocalisationState.UNKNOWN:
            told = str(answer.reason)
        else:
            right = [held.right(view, pose.T_frame_view) for pose in answer.poses]
            wrong = "!" if answer.state == RelocalisationState.PLACED and not right[0] else ""
            first = answer.poses[0]
            told = f"{answer.state[:6]}{wrong} {len(right)}{'+' if any(right) else '-'} p{first.probability:.2f}"
            told += f" a{first.accepted} n{answer.none_of_them:.2f}"
        parts.append(f"{answer.travelled_m:.0f}m {told} {belief}")
    inside = "in" if held.in_map_all_along else "partly" if held.in_map else "out"
    return f"{number} ({inside}): " + "; ".join(parts)
