"""A second machine made of namespaces: its own network behind a cable, name, boot id and wall clock. Needs root."""

from __future__ import annotations

import os
import shutil
import subprocess
import uuid
from pathlib import Path

from tests.faults.preloaded import COMPILER, SteppedWallClock, launcher

ENTER = 'hostname "$0"; mount --bind "$1" /proc/sys/kernel/random/boot_id; shift; exec "$@"'


def possible() -> bool:
    """Whether this machine lets us make another one."""
    if os.geteuid() != 0 or COMPILER is None or shutil.which("ip") is None:
        return False
    return subprocess.run(["unshare", "-n", "-m", "-u", "true"], capture_output=True).returncode == 0


class OtherHost:
    """A host on a bridge with this one, which has `here` there; programs start on it behind `launcher`."""

    def __init__(self, folder: Path) -> None:
        """Its files (clock, boot id) are in `folder`."""
        number = os.getpid() % 60_000
        self.name, self._bridge, self._cable = f"revisit-{number}", f"rvb{number}", f"rvc{number}"
        net = f"10.{83 + number // 256 % 100}.{number % 256}"
        self.network, self.here, self.address = f"{net}.0/24", f"{net}.1", f"{net}.2"
        self._clock, boot_id = SteppedWallClock(folder), folder / "boot_id"
        boot_id.write_text(f"{uuid.uuid4()}\n")
        self._connect()
        self.launcher = (
            *("ip", "netns", "exec", self.name, "unshare", "-m", "-u", "sh", "-c", ENTER, self.name, str(boot_id)),
            *launcher(self._clock),
        )

    def step(self, seconds: int) -> None:
        """Its wall clock is off by so much from now on."""
        self._clock.step(seconds)

    def cut(self) -> None:
        """Pull the cable: nothing passes and nobody is told."""
        _ip("link", "set", self._cable, "down")

    def plug(self) -> None:
        """Put the cable back."""
        _ip("link", "set", self._cable, "up")

    def close(self) -> None:
        """Remove its network. Programs on it are ended by whoever has started them."""
        for made in (("link", "del", self._cable), ("link", "del", self._bridge), ("netns", "del", self.name)):
            subprocess.run(["ip", *made], capture_output=True)

    def _connect(self) -> None:
        there = ("netns", "exec", self.name, "ip")
        _ip("netns", "add", self.name)
        _ip("link", "add", self._bridge, "type", "bridge")
        _ip("link", "add", self._cable, "type", "veth", "peer", "name", "eth0", "netns", self.name)
        _ip("link", "set", self._cable, "master", self._bridge)
        _ip("addr", "add", f"{self.here}/24", "dev", self._bridge)
        _ip(*there, "addr", "add", f"{self.address}/24", "dev", "eth0")
        for part in (self._bridge, self._cable):
            _ip("link", "set", part, "up")
        for part in ("lo", "eth0"):
            _ip(*there, "link", "set", part, "up")


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)
