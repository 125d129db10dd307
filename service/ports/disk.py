"""Room on the disk."""

from __future__ import annotations

from typing import Protocol


class DiskSpace(Protocol):
    """Room on the disk for clients' data."""

    def full(self) -> bool:
        """Whether new data must be refused: the room left is for finishing and for deleting."""
        ...

    def exhausted(self) -> bool:
        """Whether not even that is left."""
        ...

    def free_bytes(self) -> int | None:
        """How much this user may still write; None where nobody knows."""
        ...

    def log_bytes(self) -> int:
        """Size of the log of commits that are not folded back into the database yet."""
        ...


class UnlimitedDisk:
    """`DiskSpace` without a watch: there is always room."""

    def full(self) -> bool:
        """See `DiskSpace`."""
        return False

    def exhausted(self) -> bool:
        """See `DiskSpace`."""
        return False

    def free_bytes(self) -> int | None:
        """See `DiskSpace`."""
        return None

    def log_bytes(self) -> int:
        """See `DiskSpace`."""
        return 0
