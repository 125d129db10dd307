"""Room on the disk."""

from __future__ import annotations

from typing import Protocol


class DiskSpace(Protocol):
    """Whether there is room for what clients send."""

    def full(self) -> bool:
        """Whether new data must be refused: what room is left is for finishing and for deleting."""
        ...

    def exhausted(self) -> bool:
        """Whether not even that is left."""
        ...

    def wal_bytes(self) -> int:
        """Size of what is committed and not folded back into the database yet."""
        ...


class UnlimitedDisk:
    """`DiskSpace` of a service whose disk nobody watches."""

    def full(self) -> bool:
        """See `DiskSpace`."""
        return False

    def exhausted(self) -> bool:
        """See `DiskSpace`."""
        return False

    def wal_bytes(self) -> int:
        """See `DiskSpace`."""
        return 0
