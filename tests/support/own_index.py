"""Searches in an index that a test holds."""

from __future__ import annotations

from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.features.index.place_memory import PlaceMemory
from revisit.service.ports.index import VectorIndex
from revisit.service.ports.transactions import Transactions


def memory_over(transactions: Transactions, index: VectorIndex) -> PlaceMemory:
    """The places of the store behind `transactions`, recalled by `index`."""
    return PlaceMemory(transactions, CaughtUpIndex(transactions, index))
