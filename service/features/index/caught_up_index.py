"""The index of this process: searched after it has caught up with the database."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from revisit.service.domain.identity import TenantId
from revisit.service.failpoints import failpoint
from revisit.service.ports.index import IndexChange, VectorFilter, VectorIndex, VectorMatch
from revisit.service.ports.place_search import PlaceAnswer, PlaceQuestion
from revisit.service.ports.transactions import Transactions, UnitOfWork

PORTION = 1024
"""Changes that are read at a time: a large map is loaded without holding all its descriptors twice, and 4 MB of them
lie in memory that the next portion uses again."""


@dataclass(frozen=True)
class _News:
    """The changes of a map's index that follow change `after`."""

    after: int
    changes: list[IndexChange]

    @property
    def seq(self) -> int:
        """The last of them."""
        return self.changes[-1].seq if self.changes else self.after


class CaughtUpIndex:
    """`PlaceSearch` in this process's own index, a cache of the database."""

    def __init__(self, transactions: Transactions, index: VectorIndex) -> None:
        """`index` holds nothing but what it is told here."""
        self._transactions = transactions
        self._index = index
        self._caught_up: dict[int, tuple[int, int]] = {}

    def nearest(self, question: PlaceQuestion) -> PlaceAnswer:
        """See `PlaceSearch`."""
        number = question.map_number
        while True:
            seq = self.catch_up(question.tenant, number, question.before)
            known = self._index.seq(number)
            matches = self._search(question, self._entered_in_time(question))
            now = self._index.seq(number)
            came_since = now != known and bool(self._too_late(question).intersection(_numbers(matches)))
            if now >= seq and not came_since:
                return self._answer(question, matches)
            # Meanwhile the map was forgotten, to be loaded again; or others caught up, and what they brought was found.

    def nearest_in(self, uow: UnitOfWork, question: PlaceQuestion, version: int | None) -> PlaceAnswer | None:
        """See `PlaceSearch`: where the index is then as of this snapshot, and no further.

        Nothing is read where it knew everything as of `version` and nothing was committed since; no answer of a map
        that is still to be loaded, or that lacks more than a portion.
        """
        news = self._news(uow, question, version)
        if news is None:
            return None
        number = question.map_number
        self._apply(number, news)
        matches = self._search(question, question.where)
        if version is not None:
            self._caught_up[number] = version, news.seq
        return self._answer(question, matches) if self._index.seq(number) == news.seq else None

    def catch_up(self, tenant: TenantId, number: int, to: int | None = None) -> int:
        """Apply the changes that the index lacks, up to change `to`, in portions; the last change that was read."""
        while True:
            before = self._index.seq(number) or self._loaded(tenant, number)
            if to is not None and before >= to:
                return before
            changes = self._transactions.read_here(partial(_changes, tenant=tenant, number=number, seq=before))
            if to is not None:
                changes = [change for change in changes if change.seq <= to]
            more = len(changes) > PORTION
            seq = self._apply(number, _News(before, changes[:PORTION]), more)
            if not more:
                return seq

    def _news(self, uow: UnitOfWork, question: PlaceQuestion, version: int | None) -> _News | None:
        """The changes that the index of the map lacks in this snapshot."""
        number = question.map_number
        before = self._index.seq(number)
        if not before:
            return None
        if version is not None and self._caught_up.get(number) == (version, before):
            return _News(before, [])
        changes = _changes(uow, question.tenant, number, before)
        return _News(before, changes) if len(changes) <= PORTION else None

    def _entered_in_time(self, question: PlaceQuestion) -> VectorFilter:
        """The filter, which leaves out what the index holds beyond change `before`."""
        later = self._too_late(question)
        return replace(question.where, without=question.where.without | later) if later else question.where

    def _too_late(self, question: PlaceQuestion) -> frozenset[int]:
        """The submaps that entered the index after change `before` of the question."""
        tenant, number, before = question.tenant, question.map_number, question.before
        if before is None or self._index.seq(number) <= before:
            return frozenset()
        later = self._transactions.read_here(lambda uow: uow.changes.since(tenant, number, before))
        return frozenset(change.submap_number for change in later)

    def _search(self, question: PlaceQuestion, where: VectorFilter) -> list[VectorMatch]:
        number = question.map_number
        return self._index.search(number, question.vector, question.k, where) if self._index.size(number) else []

    def _answer(self, question: PlaceQuestion, matches: list[VectorMatch]) -> PlaceAnswer:
        number, comparable = question.map_number, question.where.only_sessions
        searched = self._index.size(number)
        left_out = 0 if comparable is None else searched - self._index.size(number, comparable)
        return PlaceAnswer(tuple(matches), searched, left_out)

    def _apply(self, number: int, news: _News, more: bool = False) -> int:
        """Apply changes that were read, and `more` are to be; the last of them."""
        failpoint("index.before_apply")
        self._index.apply(number, news.changes, news.after, more=more)
        failpoint("index.after_apply")
        return news.seq

    def _loaded(self, tenant: TenantId, number: int) -> int:
        """Load the map from its file, if it has one; the last change that is in the index then."""
        record = self._transactions.read_here(lambda uow: uow.maps.numbered(tenant, [number])).get(number)
        if record is not None and record.index_file is not None:
            self._index.load(number, record.index_file)
        return self._index.seq(number)


def _numbers(matches: list[VectorMatch]) -> list[int]:
    return [match.submap_number for match in matches]


def _changes(uow: UnitOfWork, tenant: TenantId, number: int, seq: int) -> list[IndexChange]:
    """A portion of the changes after `seq`, and one more, if there is any."""
    return uow.changes.since(tenant, number, seq, PORTION + 1)
