"""Nearest descriptors under filters (paper III-E, Eq. 15): a plain reference, and the index of the service."""

from revisit.core.index.descriptors import RowDiffers, SharedRows
from revisit.core.index.entries import MAX_K, IndexEntry, Match, PlaceIndex, SearchFilter
from revisit.core.index.exact import ExactIndex
from revisit.core.index.faiss_index import FaissIndex, StoredIndex

__all__ = [
    "MAX_K",
    "ExactIndex",
    "FaissIndex",
    "IndexEntry",
    "Match",
    "PlaceIndex",
    "RowDiffers",
    "SearchFilter",
    "SharedRows",
    "StoredIndex",
]
