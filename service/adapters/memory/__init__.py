"""The stores in memory: the same contracts without a disk, for tests and for reading what a contract means."""

from revisit.service.adapters.memory.blobs import MemoryBlobStore
from revisit.service.adapters.memory.transactions import MemoryTransactions
from revisit.service.adapters.memory.vector_index import MemoryVectorIndex

__all__ = ["MemoryBlobStore", "MemoryTransactions", "MemoryVectorIndex"]
