"""Map files in the words of VDA 5050: the actions of fleet control, and what the state of a robot says."""

from __future__ import annotations

import pytest

from revisit.cli.map_versions import vda5050
from revisit.sdk.resources import MapFile, MapVersion, MapVersionSummary
from revisit.sdk.vda5050 import RobotMap

FILE = MapFile(
    name="maps/town/files/7", map_id="town", map_version="7", map_hash="ab" * 32,
    map_download_link="/v1/maps/town/files/7:download", map_status="ENABLED", map_descriptor="the yard",
)  # fmt: skip
TOWN = RobotMap.of(FILE, "http://10.0.0.5:8080")
NAMED = [{"key": "mapId", "value": "town"}, {"key": "mapVersion", "value": "7"}]


def test_a_robot_is_told_where_to_download_a_map_and_by_which_hash_to_check_it():
    action = TOWN.download("a1")
    assert (action["actionType"], action["actionId"], action["blockingType"]) == ("downloadMap", "a1", "NONE")
    assert action["actionParameters"] == [
        *NAMED,
        {"key": "mapDownloadLink", "value": "http://10.0.0.5:8080/v1/maps/town/files/7:download"},
        {"key": "mapHash", "value": "ab" * 32},
    ]


@pytest.mark.parametrize("http", ["10.0.0.5", "10.0.0.5:8080", "http://10.0.0.5:8080/"])
def test_the_link_has_the_address_of_the_service_however_that_is_written(http):
    assert RobotMap.of(FILE, http).link == TOWN.link


def test_a_map_is_enabled_and_deleted_by_its_id_and_version_alone():
    for action, kind in ((TOWN.enable("a2"), "enableMap"), (TOWN.delete("a3"), "deleteMap")):
        assert (action["actionType"], action["actionParameters"]) == (kind, NAMED)


def test_a_downloaded_map_is_disabled_until_it_is_enabled():
    named = {"mapId": "town", "mapVersion": "7", "mapDescriptor": "the yard"}
    # Whatever the operator wants robots to use: FILE is ENABLED at the service.
    assert TOWN.state() == named | {"mapStatus": "DISABLED"}
    assert TOWN.state(enabled=True) == named | {"mapStatus": "ENABLED"}


def test_a_saved_file_is_disabled_also_where_its_version_is_in_force():
    told = vda5050(
        "town", MapVersion(version=7, in_force=True, summary=MapVersionSummary()), "ab" * 32, "http://files/town.zip"
    )
    assert told == {
        "mapId": "town", "mapVersion": "7", "mapStatus": "DISABLED", "mapHash": "ab" * 32,
        "mapDownloadLink": "http://files/town.zip",
    }  # fmt: skip
    assert "mapDownloadLink" not in vda5050("town", MapVersion(version=7, summary=MapVersionSummary()), "ab" * 32, "")
