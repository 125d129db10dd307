"""The data belongs on a local disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from revisit.service.engines.local.files import filesystem
from revisit.service.engines.local.files.filesystem import RemoteFileSystem, filesystem_type, require_local
from revisit.service.engines.local.sqlite.migration import migrate

MOUNTS = """\
/dev/vda / ext4 rw 0 0
server:/export /srv/robots nfs4 rw 0 0
tmpfs /srv/robots/fast tmpfs rw 0 0
//host/share /mnt/my\\040share cifs rw 0 0
host /shared 9p rw 0 0
me@host: /home/me/far fuse.sshfs rw 0 0
"""


@pytest.mark.parametrize(
    ("folder", "kind"),
    [
        ("/var/lib/revisit", "ext4"),
        ("/srv/robots/data", "nfs4"),
        ("/srv/robots", "nfs4"),
        ("/srv/robotsandmore", "ext4"),
        ("/srv/robots/fast/data", "tmpfs"),
        ("/mnt/my share/data", "cifs"),
    ],
)
def test_the_innermost_mount_tells_the_type(folder, kind):
    assert filesystem_type(Path(folder), MOUNTS) == kind


@pytest.mark.parametrize("folder", ["/srv/robots/data", "/mnt/my share", "/shared/data", "/home/me/far/data"])
def test_a_folder_on_another_machine_is_refused_and_nothing_is_made(folder, tmp_path, monkeypatch):
    (tmp_path / "mounts").write_text(MOUNTS)
    monkeypatch.setattr(filesystem, "MOUNTS", tmp_path / "mounts")
    with pytest.raises(RemoteFileSystem, match="local disk"):
        migrate(Path(folder) / "revisit.db")
    require_local(Path("/var/lib/revisit"))
