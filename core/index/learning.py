"""What an index learns from its places: which of them count, and when the statistics are due."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SessionSums, SiteStatistics, by_session, learn_site, learned_from
from revisit.core.index.rows import Rows

Indices = NDArray[np.intp]


class SiteLearner:
    """The statistics of the places in `Rows`, learned anew at steps of growth (docs/decisions/0120).

    Of places of a session that lie within one cell, the first counts. The map's statistics come from its first places
    that count, as many as the last step asks for, and so does the mean of each session from the session's.
    """

    def __init__(self, config: AdaptationConfig) -> None:
        self._config = config
        self._counted: list[int] = []  # rows
        self._by_session: dict[int, list[int]] = {}
        self._cells: set[tuple[int, ...]] = set()
        self._seen = 0
        self._learned = 0
        self._stale: set[int] = set()
        self._in_map: dict[int, SessionSums] = {}
        self._of_session: dict[int, SessionSums] = {}
        self.site: SiteStatistics | None = None

    def forget(self) -> None:
        """Begin anew: places were removed, or have other rows."""
        self._counted.clear()
        self._by_session.clear()
        self._cells.clear()
        self._stale.clear()
        self._in_map.clear()
        self._of_session.clear()
        self._seen = self._learned = 0
        self.site = None

    def learn(self, rows: Rows) -> Indices:
        """Take in the places that have come since the last time; the rows whose standardised form is another now."""
        self._count(rows)
        step = learned_from(len(self._counted), self._config)
        if step != self._learned:
            return self._learn_map(rows, step)
        changed = self._learn_sessions(rows)
        return np.flatnonzero(np.isin(rows.sessions[: rows.count], changed)) if changed else np.zeros(0, np.intp)

    def _count(self, rows: Rows) -> None:
        new = np.arange(self._seen, rows.count)[rows.alive[self._seen : rows.count]]
        cells = np.floor(rows.positions[new] / self._config.cell).astype(np.int64).tolist()
        for row, session, cell in zip(new.tolist(), rows.sessions[new].tolist(), cells, strict=True):
            if (session, *cell) not in self._cells:
                self._cells.add((session, *cell))
                self._counted.append(row)
                self._by_session.setdefault(session, []).append(row)
                self._stale.add(session)
        self._seen = rows.count

    def _learn_map(self, rows: Rows, step: int) -> Indices:
        """Learn from the first `step` places that count; the sessions follow."""
        names, counts = np.unique(rows.sessions[self._counted[:step]], return_counts=True)
        self._in_map = {
            session: self._sums(rows, session, count, self._in_map)
            for session, count in zip(names.tolist(), counts.tolist(), strict=True)
        }
        self.site = learn_site(self._in_map, self._config) if step else None
        self._learned, self._stale = step, set(self._by_session)
        self._learn_sessions(rows)
        return np.arange(rows.count)

    def _learn_sessions(self, rows: Rows) -> list[int]:
        """Learn the means of the sessions that are stale and have places enough; which they are."""
        if self.site is None:
            return []
        steps = {session: learned_from(len(self._by_session[session]), self._config) for session in self._stale}
        changed = {
            session: self._sums(rows, session, step, self._of_session)
            for session, step in steps.items()
            if step and (session not in self.site.session_means or step != self._of_session[session].count)
        }
        self._of_session.update(changed)
        self.site = self.site.with_sessions(changed)
        self._stale.clear()
        return list(changed)

    def _sums(self, rows: Rows, session: int, count: int, known: Mapping[int, SessionSums]) -> SessionSums:
        """Of the first `count` places of a session that count; what is `known` of as many is taken."""
        if session in known and known[session].count == count:
            return known[session]
        return SessionSums.of(rows.vectors[self._by_session[session][:count]])


def learn_plainly(rows: Rows, config: AdaptationConfig) -> SiteStatistics | None:
    """What `SiteLearner` has learned in the end, from all `rows` at once."""
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
