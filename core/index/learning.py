"""Statistics that an index learns from its entries: which of them count, and when they are due."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SessionSums, SiteStatistics, by_session, learn_site, learned_from
from revisit.core.errors import DataLoss
from revisit.core.index.rows import Rows

Indices = NDArray[np.intp]

_NOTHING_HOLDS = -1
"""In place of a step: the map is learned anew."""

_SUMS_STORED_FROM = 32
"""Sums of fewer entries of a session are not stored: they take as much room as 4 descriptors, for few entries."""


class SiteLearner:
    """The statistics of the entries in `Rows`, learned anew at steps of growth (docs/decisions/0120).

    Of entries of a session that lie within one cell, the first counts. The map's statistics come from its first entries
    that count, as many as the last step asks for, and so does the mean of each session from the session's. What a
    session teaches is kept until one of its entries that count is removed (docs/decisions/0305).
    """

    def __init__(self, config: AdaptationConfig) -> None:
        self._config = config
        # A byte for each row that was seen, and machine numbers: a million rows take 9 MB, in lists 40.
        self._counts = bytearray()
        self._by_session: dict[int, array[int]] = {}  # rows that count
        self._cells: dict[int, set[tuple[int, ...]]] = {}  # by session, as far as it was asked for
        self._uncounted: set[int] = set()  # sessions whose rows are counted anew
        self._learned = 0
        self._stale: set[int] = set()
        self._in_map: dict[int, SessionSums] = {}  # of the entries that teach the map, also where they no longer do
        self._of_session: dict[int, SessionSums] = {}
        self._steps: dict[int, int] = {}  # from how many entries the mean of each session was learned
        self.site: SiteStatistics | None = None

    def forget(self, rows: Rows, gone: Indices) -> None:
        """The entries of the rows `gone` were removed: the statistics of their sessions are learned anew.

        One that did not count taught nothing. `rows` still know of which sessions they were.
        """
        seen = gone[gone < len(self._counts)]
        for session in set(rows.sessions[seen[self._flags()[seen]]].tolist()):
            self._flags()[self._by_session.pop(session)] = False
            self._cells.pop(session, None)
            self._in_map.pop(session, None)
            self._of_session.pop(session, None)
            self._steps.pop(session, None)
            self._uncounted.add(session)
            self._learned = _NOTHING_HOLDS

    def renumber(self, rows: Rows, kept: Indices) -> None:
        """The row that was `kept[i]` is row i of `rows` now; others are gone and were forgotten."""
        self._set_counts(rows, self._flags()[kept[kept < len(self._counts)]])

    def stored(self, live: Indices) -> dict[str, NDArray[np.generic]]:
        """Its statistics as arrays, for the `live` rows; all rows have been taken in."""
        steps = [] if self.site is None else [self._steps[session] for session in self.site.session_means]
        return {
            "counted": self._flags()[live],
            "learned": np.array([self._learned]),
            "session_steps": np.array(steps, dtype=np.int64),
            **site_as_arrays(self.site, "site_"),
            **_sums_as_arrays(self._in_map, "in_map_"),
            **_sums_as_arrays(self._of_session, "of_session_"),
        }

    def restore(self, rows: Rows, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go on, as a new learner, from a `stored` state. Raises DataLoss where it is of another form."""
        missing = sorted(_STORED - arrays.keys())
        if missing:
            raise DataLoss(f"the state of an index lacks {', '.join(missing)}: another version has written it")
        self.site = site_of_arrays(arrays, "site_")
        self._set_counts(rows, arrays["counted"])
        if self.site is not None:
            self._steps = dict(zip(self.site.session_means, arrays["session_steps"].tolist(), strict=True))
        self._learned = int(arrays["learned"][0])
        self._in_map, self._of_session = _sums_of_arrays(arrays, "in_map_"), _sums_of_arrays(arrays, "of_session_")

    def learn(self, rows: Rows) -> Indices:
        """Take in the entries that have come since the last time; the rows whose standardised form is another now."""
        self._count(rows)
        step = learned_from(int(np.count_nonzero(self._flags())), self._config)
        if step != self._learned:
            return self._learn_map(rows, step)
        changed = self._learn_sessions(rows)
        return np.flatnonzero(np.isin(rows.sessions[: rows.count], changed)) if changed else np.zeros(0, np.intp)

    def _flags(self) -> NDArray[np.bool_]:
        """Which of the rows that were seen count; written to in place. Not to be held while more are seen."""
        return np.frombuffer(self._counts, dtype=bool)

    def _set_counts(self, rows: Rows, flags: NDArray[np.bool_]) -> None:
        """The first rows count as `flags` (n,) say."""
        counted = np.flatnonzero(flags)
        self._counts = bytearray(flags.tobytes())
        self._by_session = {
            session: array("q", counted[own].tolist()) for session, own in by_session(rows.sessions[counted])
        }

    def _count(self, rows: Rows) -> None:
        new = np.concatenate([self._again(rows), np.arange(len(self._counts), rows.count)])
        new = new[rows.alive[new]]
        self._counts.extend(bytes(rows.count - len(self._counts)))
        for row, session, cell in zip(
            new.tolist(), rows.sessions[new].tolist(), self._cells_of(rows, new), strict=True
        ):
            counted = self._counted_cells(rows, session)
            if cell not in counted:
                counted.add(cell)
                self._counts[row] = True
                self._by_session.setdefault(session, array("q")).append(row)
                self._stale.add(session)
        self._uncounted.clear()

    def _again(self, rows: Rows) -> Indices:
        """The rows that were seen of sessions that are counted anew."""
        if not self._uncounted:
            return np.zeros(0, np.intp)
        return np.flatnonzero(np.isin(rows.sessions[: len(self._counts)], list(self._uncounted)))

    def _counted_cells(self, rows: Rows, session: int) -> set[tuple[int, ...]]:
        """The cells in which a place of the session counts."""
        if session not in self._cells:
            of_session = np.array(self._by_session.get(session, ()), dtype=np.intp)
            self._cells[session] = set(self._cells_of(rows, of_session))
        return self._cells[session]

    def _cells_of(self, rows: Rows, chosen: Indices) -> Iterator[tuple[int, ...]]:
        return map(tuple, np.floor(rows.positions[chosen] / self._config.cell).astype(np.int64).tolist())

    def _learn_map(self, rows: Rows, step: int) -> Indices:
        """Learn from the first `step` entries that count; the sessions follow."""
        end = int(np.flatnonzero(self._flags())[step - 1]) + 1 if step else 0
        counts = {session: bisect_left(own, end) for session, own in self._by_session.items()}
        in_map = {session: self._sums(rows, session, count, self._in_map) for session, count in counts.items() if count}
        self._in_map.update(in_map)
        self.site = learn_site(in_map, self._config) if step else None
        self._learned, self._stale = step, set(self._by_session)
        self._learn_sessions(rows)
        return np.arange(rows.count)

    def _learn_sessions(self, rows: Rows) -> list[int]:
        """Learn the means of the sessions that are stale and have entries enough; which they are."""
        if self.site is None:
            return []
        steps = {session: learned_from(len(self._by_session[session]), self._config) for session in self._stale}
        changed = {
            session: self._sums(rows, session, step, self._of_session)
            for session, step in steps.items()
            if step and (session not in self.site.session_means or step != self._steps[session])
        }
        self._of_session.update(changed)
        self._steps.update({session: steps[session] for session in changed})
        self.site = self.site.with_sessions(changed)
        self._stale.clear()
        return list(changed)

    def _sums(self, rows: Rows, session: int, count: int, known: Mapping[int, SessionSums]) -> SessionSums:
        """Of the first `count` entries of a session that count; what is `known` of as many is taken."""
        if session in known and known[session].count == count:
            return known[session]
        return SessionSums.of(rows.vectors[self._by_session[session][:count]])


_STORED = frozenset(
    {
        "counted", "learned", "session_steps",
        *(f"site_{name}" for name in ("mean", "spread", "sessions", "session_means")),
        *(f"in_map_{name}" for name in ("sessions", "counts", "totals", "squares")),
        *(f"of_session_{name}" for name in ("sessions", "counts", "totals", "squares")),
    }
)  # fmt: skip
"""The arrays that `SiteLearner.stored` gives."""


def site_as_arrays(site: SiteStatistics | None, prefix: str) -> dict[str, NDArray[np.generic]]:
    """Statistics as arrays whose names begin with `prefix`; empty ones for none."""
    if site is None:
        empty = np.zeros(0, dtype=np.float32)
        site = SiteStatistics(empty, empty)
    means = list(site.session_means.values())
    return {
        f"{prefix}mean": site.mean,
        f"{prefix}spread": site.spread,
        f"{prefix}sessions": np.array(list(site.session_means), dtype=np.int64),
        f"{prefix}session_means": np.stack(means) if means else np.zeros((0, len(site.mean)), dtype=np.float32),
    }


def site_of_arrays(arrays: Mapping[str, NDArray[Any]], prefix: str) -> SiteStatistics | None:
    """The inverse of `site_as_arrays`."""
    mean, spread = arrays[f"{prefix}mean"], arrays[f"{prefix}spread"]
    means = zip(arrays[f"{prefix}sessions"].tolist(), arrays[f"{prefix}session_means"], strict=True)
    return SiteStatistics(mean, spread, dict(means)) if len(mean) else None


def _sums_as_arrays(sums: Mapping[int, SessionSums], prefix: str) -> dict[str, NDArray[np.generic]]:
    """Sums by session, of entries enough, as arrays whose names begin with `prefix`: a row a session."""
    kept = {session: of for session, of in sums.items() if of.count >= _SUMS_STORED_FROM}
    return {
        f"{prefix}sessions": np.array(list(kept), dtype=np.int64),
        f"{prefix}counts": np.array([of.count for of in kept.values()], dtype=np.int64),
        f"{prefix}totals": np.array([of.total for of in kept.values()], dtype=np.float64),
        f"{prefix}squares": np.array([of.squares for of in kept.values()], dtype=np.float64),
    }


def _sums_of_arrays(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[int, SessionSums]:
    """The inverse of `_sums_as_arrays`."""
    sessions, counts = arrays[f"{prefix}sessions"].tolist(), arrays[f"{prefix}counts"].tolist()
    sums = map(SessionSums, counts, arrays[f"{prefix}totals"], arrays[f"{prefix}squares"])
    return dict(zip(sessions, sums, strict=True))


def learn_plainly(rows: Rows, config: AdaptationConfig) -> SiteStatistics | None:
    """The final statistics of `SiteLearner`, from all `rows` at once."""
    live = rows.live()
    cells = np.column_stack([rows.sessions[live], np.floor(rows.positions[live] / config.cell).astype(np.int64)])
    counted = live[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
    step = learned_from(len(counted), config)
    if not step:
        return None
    in_map = {
        session: SessionSums.of(rows.vectors[counted[own]])
        for session, own in by_session(rows.sessions[counted[:step]])
    }
    of_sessions = {
        session: SessionSums.of(rows.vectors[counted[own[: learned_from(len(own), config)]]])
        for session, own in by_session(rows.sessions[counted])
        if learned_from(len(own), config)
    }
    return learn_site(in_map, config).with_sessions(of_sessions)
