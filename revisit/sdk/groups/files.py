"""Maps as files."""

from __future__ import annotations

import builtins
from pathlib import Path

from revisit.sdk import names
from revisit.sdk.groups.group import Group
from revisit.sdk.groups.versions import Versions
from revisit.sdk.map_downloads import fetch_file
from revisit.sdk.names import name_of
from revisit.sdk.resources import Map, MapFile, MapVersion, Operation
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.transport import Transport


class Files(Group):
    """`client.files`."""

    def __init__(self, transport: Transport, retry: RetryPolicy) -> None:
        super().__init__(transport)
        self._retry = retry

    def publish(self, version: str | Map | MapVersion, description: str = "") -> Operation:
        """Make a file of a version: the operation; its result names `map_file` and `map_hash`."""
        parent = Versions(self._transport).name(version)
        return Operation.of(self._ask("PublishMapFile", parent=parent, map_descriptor=description))

    def list(self, map_: str | Map) -> builtins.list[MapFile]:
        """The files of a map, oldest first."""
        return self._list(MapFile, "ListMapFiles", parent=name_of(map_, names.MAP))

    def get(self, name: str) -> MapFile:
        """Get `maps/{map}/files/{version}`."""
        return MapFile.of(self._ask("GetMapFile", name=name_of(name, names.MAP_FILE)))

    def enable(self, file: str | MapFile) -> MapFile:
        """Say that robots are to use this file, and no other of its map."""
        return MapFile.of(self._ask("EnableMapFile", name=name_of(file, names.MAP_FILE)))

    def delete(self, file: str | MapFile) -> None:
        """Delete a file; the version stays."""
        self._ask("DeleteMapFile", name=name_of(file, names.MAP_FILE))

    def download(self, file: str | MapFile, out: Path | str) -> MapFile:
        """Download a file; bytes of an earlier download in OUT.part are not sent again.

        Raises DataLoss where the bytes do not have the hash that the service names: then OUT.part is deleted.
        """
        found = self.get(name_of(file, names.MAP_FILE))
        fetch_file(found, Path(out), self._transport.map_file_bytes, self._retry)
        return found
