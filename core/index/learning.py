"""What an index learns from its places: which of them count, and when the statistics are due."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from typing import Any

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
        # Rows as machine numbers: a million of them take 8 MB, in a list 40.
        self._counted = array("q")
        self._by_session: dict[int, array[int]] = {}
        self._cells: dict[int, set[tuple[int, ...]]] = {}  # by session, as far as it was asked for
        self._seen = 0
        self._learned = 0
        self._stale: set[int] = set()
        self._in_map: dict[int, SessionSums] = {}
        self._of_session: dict[int, SessionSums] = {}
        self._steps: dict[int, int] = {}  # from how many places the mean of each session was learned
        self.site: SiteStatistics | None = None

    def forget(self) -> None:
        """Begin anew: places were removed, or have other rows."""
        self._counted = array("q")
        self._by_session.clear()
        self._cells.clear()
        self._stale.clear()
        self._in_map.clear()
        self._of_session.clear()
        self._steps.clear()
        self._seen = self._learned = 0
        self.site = None

    def stored(self, live: Indices, count: int) -> dict[str, NDArray[np.generic]]:
        """What it has learned of `count` rows as arrays, for the `live` ones; all of them have been taken in."""
        counted = np.zeros(count, dtype=bool)
        counted[self._counted] = True
        steps = [] if self.site is None else [self._steps[session] for session in self.site.session_means]
        return {
            "counted": counted[live],
            "learned": np.array([self._learned]),
            "session_steps": np.array(steps, dtype=np.int64),
            **site_as_arrays(self.site, "site_"),
        }

    def restore(self, rows: Rows, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what was `stored`. Sums are made of the `rows` again when they are next needed."""
        self.forget()
        self.site = site_of_arrays(arrays, "site_")
        counted = np.flatnonzero(arrays["counted"])
        self._counted = array("q", counted.tolist())
        for session, own in by_session(rows.sessions[counted]):
            self._by_session[session] = array("q", counted[own].tolist())
        if self.site is not None:
            self._steps = dict(zip(self.site.session_means, arrays["session_steps"].tolist(), strict=True))
        self._seen, self._learned = len(arrays["counted"]), int(arrays["learned"][0])

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
        for row, session, cell in zip(
            new.tolist(), rows.sessions[new].tolist(), self._cells_of(rows, new), strict=True
        ):
            counted = self._counted_cells(rows, session)
            if cell not in counted:
                counted.add(cell)
                self._counted.append(row)
                self._by_session.setdefault(session, array("q")).append(row)
                self._stale.add(session)
        self._seen = rows.count

    def _counted_cells(self, rows: Rows, session: int) -> set[tuple[int, ...]]:
        """The cells in which a place of the session counts."""
        if session not in self._cells:
            of_session = np.array(self._by_session.get(session, ()), dtype=np.intp)
            self._cells[session] = set(self._cells_of(rows, of_session))
        return self._cells[session]

    def _cells_of(self, rows: Rows, chosen: Indices) -> Iterator[tuple[int, ...]]:
        return map(tuple, np.floor(rows.positions[chosen] / self._config.cell).astype(np.int64).tolist())

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
            if step and (session not in self.site.session_means or step != self._steps[session])
        }
        self._of_session.update(changed)
        self._steps.update({session: steps[session] for session in changed})
        self.site = self.site.with_sessions(changed)
        self._stale.clear()
        return list(changed)

    def _sums(self, rows: Rows, session: int, count: int, known: Mapping[int, SessionSums]) -> SessionSums:
        """Of the first `count` places of a session that count; what is `known` of as many is taken."""
        if session in known and known[session].count == count:
            return known[session]
        return SessionSums.of(rows.vectors[self._by_session[session][:count]])


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
