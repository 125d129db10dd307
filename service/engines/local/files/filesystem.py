"""The file system of a folder: locks and syncs cannot be trusted over a network."""

from __future__ import annotations

import os
import re
from pathlib import Path

REMOTE = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "ceph", "glusterfs", "lustre", "ncpfs", "coda"}
)
REMOTE_FUSE = ("fuse.sshfs", "fuse.glusterfs", "fuse.ceph", "fuse.s3fs", "fuse.rclone", "fuse.davfs")

MOUNTS = Path("/proc/self/mounts")


class RemoteFileSystem(RuntimeError):
    """The data folder is on another machine, where a commit may not be durable."""


def require_local(folder: Path) -> None:
    """Raises RemoteFileSystem where `folder`, which may not exist yet, is on a network file system."""
    kind = filesystem_type(folder.resolve(), MOUNTS.read_text() if MOUNTS.exists() else "")
    if kind in REMOTE or kind.startswith(REMOTE_FUSE):
        raise RemoteFileSystem(f"{folder} is on {kind}: the database needs a local disk (REVISIT_HOME names another)")


def filesystem_type(folder: Path, mounts: str) -> str:
    """The type of the file system that holds an absolute path, by the text of /proc/mounts; empty where unknown."""
    found, kind = "", ""
    for line in mounts.splitlines():
        fields = line.split(" ")
        point = re.sub(r"\\([0-7]{3})", lambda octal: chr(int(octal[1], 8)), fields[1])
        # The last mount on a path hides the earlier ones.
        if len(point) >= len(found) and os.path.commonpath([point, folder]) == point:
            found, kind = point, fields[2]
    return kind
