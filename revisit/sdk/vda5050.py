"""A map file in the words of VDA 5050 (3.0): instant actions of fleet control, and the entry in the state of a robot.

A robot that has downloaded a map has it DISABLED. `enableMap` makes it ENABLED, and other versions of the same `mapId`
DISABLED: orders may use it. Enabled is not active: a robot drives on the map that its position names, the `mapId` of
`mobileRobotPosition`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import urljoin

from revisit.sdk.addresses import http_address
from revisit.sdk.resources import MapFile

if TYPE_CHECKING:
    from typing import Self


@dataclass(frozen=True)
class RobotMap:
    """A version of a map as robots and fleet control name it: `link` is its address, `map_hash` its SHA-256."""

    map_id: str
    map_version: str
    map_hash: str = ""
    link: str = ""
    descriptor: str = ""

    @classmethod
    def of(cls, file: MapFile, http: str) -> Self:
        """That of a file of the service at the address `http`, as robots reach it."""
        link = urljoin(http_address(http), file.map_download_link)
        return cls(file.map_id, file.map_version, file.map_hash, link, file.map_descriptor)

    def state(self, *, enabled: bool = False) -> dict[str, Any]:
        """The entry in `maps` of the robot's state: after the download, or after `enableMap`."""
        told = {**self._named(), "mapStatus": "ENABLED" if enabled else "DISABLED"}
        return told | ({"mapDescriptor": self.descriptor} if self.descriptor else {})

    def parameters(self) -> dict[str, str]:
        """Those of `downloadMap`."""
        more = {"mapDownloadLink": self.link, "mapHash": self.map_hash}
        return self._named() | {name: value for name, value in more.items() if value}

    def download(self, action_id: str) -> dict[str, Any]:
        """The instant action `downloadMap`."""
        return _action("downloadMap", action_id, self.parameters())

    def enable(self, action_id: str) -> dict[str, Any]:
        """The instant action `enableMap`."""
        return _action("enableMap", action_id, self._named())

    def delete(self, action_id: str) -> dict[str, Any]:
        """The instant action `deleteMap`; a robot refuses it for the map that it drives on."""
        return _action("deleteMap", action_id, self._named())

    def _named(self) -> dict[str, str]:
        return {"mapId": self.map_id, "mapVersion": self.map_version}


def _action(kind: str, action_id: str, parameters: dict[str, str]) -> dict[str, Any]:
    """An action that neither stops the robot nor keeps others from running."""
    listed = [{"key": name, "value": value} for name, value in parameters.items()]
    return {"actionType": kind, "actionId": action_id, "blockingType": "NONE", "actionParameters": listed}
