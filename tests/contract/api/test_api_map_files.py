"""Map files, the same over REST and gRPC: published, listed, enabled, downloaded whole and in parts. Made up."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from dataclasses import replace

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli import map_files
from revisit.cli.app import app
from revisit.cli.map_files import by_session, placed_submaps, reference_points
from revisit.cli.map_versions import write_from_service
from revisit.core.geometry import se3
from revisit.formats.map_file import MapFile
from revisit.sdk.errors import DataLoss, InvalidArgument, NotFound, unreachable
from revisit.sdk.map_downloads import fetch_file
from revisit.sdk.retry import RetryPolicy
from tests.support.service_world import TENANT, cloud_points, pose

AT_ONCE = RetryPolicy(attempts=3, base_s=0.0, cap_s=0.0)
_numbers = itertools.count(1)


@pytest.fixture
def driven(client):
    """A map of three submaps with a version; the name of the map."""
    session = client.create_session(client.create_map(f"filed-{next(_numbers)}", leave_distance_m=0), "monday")
    for place in range(1, 4):
        client.wait(client.post_submap(session, f"s{place}", cloud_points(place), pose(5.0 * place), place))
    map_name = session.name.partition("/sessions/")[0]
    client.wait(client.optimise_map(map_name))
    return map_name


@pytest.fixture
def published(client, driven):
    """The file of the map's version."""
    result = client.wait(client.publish_map(driven, "the yard, monday")).result
    return client.get_map_file(result["map_file"])


def test_a_file_is_told_in_the_words_of_vda_5050(client, driven, published):
    assert published.name == f"{driven}/files/1"
    assert (published.map_id, published.map_version) == (driven.partition("/")[2], "1")
    assert (published.map_status, published.map_descriptor) == ("DISABLED", "the yard, monday")
    assert published.map_download_link == f"/v1/{published.name}:download"
    assert (len(published.map_hash), published.submaps) == (64, 3)
    assert client.map_files(driven) == [published]


def test_the_service_serves_the_bytes_that_a_client_would_write(client, driven, published, tmp_path):
    fetched, written = tmp_path / "fetched.rvmap", tmp_path / "written.rvmap"
    assert client.download_map_file(published, fetched) == published
    write_from_service(client, written, client.get_map(driven), client.get_map_version(f"{driven}/versions/1"))
    assert fetched.read_bytes() == written.read_bytes()
    assert hashlib.sha256(fetched.read_bytes()).hexdigest() == published.map_hash
    with MapFile.open(fetched) as opened:
        opened.verify()
        assert [one.name for one in opened.submaps] == [f"{driven}/sessions/monday/submaps/s{n}" for n in (1, 2, 3)]
    assert list(tmp_path.iterdir()) and not list(tmp_path.glob("*.part"))


def test_publishing_again_gives_the_same_file_and_another_version_another_one(client, driven, published):
    assert client.wait(client.publish_map(driven)).result["map_hash"] == published.map_hash
    client.wait(client.optimise_map(driven))
    second = client.wait(client.publish_map(driven)).result
    assert second["map_file"] == f"{driven}/files/2" and second["map_hash"] != published.map_hash


def test_the_command_map_check_tells_what_changed_between_two_versions(client, driven, published, tmp_path):
    files = tmp_path / "first.rvmap", tmp_path / "second.rvmap"
    client.download_map_file(published, files[0])
    client.wait(client.post_submap(f"{driven}/sessions/monday", "s4", cloud_points(4), pose(20.0), 4))
    client.delete(f"{driven}/sessions/monday/submaps/s1")
    client.wait(client.optimise_map(driven))
    second = client.wait(client.publish_map(driven)).result["map_file"]
    client.download_map_file(client.get_map_file(second), files[1])
    names = [str(file) for file in files]
    told = json.loads(CliRunner().invoke(app, ["map", "check", names[1], "--since", names[0], "--json"]).stdout)[
        "changes"
    ]
    submaps = f"{driven}/sessions/monday/submaps"
    assert (told["added"], told["removed"], told["other_frame"]) == ([f"{submaps}/s4"], [f"{submaps}/s1"], [])
    assert sorted(told["moved_m"]) == [f"{submaps}/s2", f"{submaps}/s3"]
    assert told["bytes_known"] > 0 and told["bytes_new"] > 0
    shown = CliRunner().invoke(app, ["map", "check", names[1], "--since", names[0]])
    assert shown.exit_code == 0 and re.search(r"submaps added\D+1\b", shown.output)
    same = json.loads(CliRunner().invoke(app, ["map", "check", names[0], "--since", names[0], "--json"]).stdout)[
        "changes"
    ]
    assert (same["added"], same["removed"], same["bytes_new"]) == ([], [], 0) and set(same["moved_m"].values()) == {0.0}


def test_one_file_of_a_map_is_enabled_at_most(client, driven, published):
    client.wait(client.optimise_map(driven))
    client.wait(client.publish_map(driven))
    for chosen in ("1", "2", "2", "1"):
        assert client.enable_map_file(f"{driven}/files/{chosen}").map_status == "ENABLED"
        enabled = [one.map_version for one in client.map_files(driven) if one.map_status == "ENABLED"]
        assert enabled == [chosen]


def test_a_download_that_breaks_off_goes_on_where_it_stopped(client, published, tmp_path):
    whole, out, offsets = tmp_path / "whole", tmp_path / "map.rvmap", []
    client.download_map_file(published, whole)

    def breaking(name, offset):
        offsets.append(offset)
        for piece in client._transport.map_file_bytes(name, offset):
            yield piece[:700]
            raise unreachable("here", "the link broke")

    fetch_file(published, out, breaking, AT_ONCE)
    assert out.read_bytes() == whole.read_bytes()
    assert offsets == list(range(0, published.size_bytes, 700))


def test_a_download_that_comes_to_nothing_is_given_up_and_damage_is_not_kept(client, published, tmp_path):
    def dead(name, offset):
        raise unreachable("here", "no link")

    with pytest.raises(Exception, match="no link"):
        fetch_file(published, tmp_path / "a", dead, AT_ONCE)
    with pytest.raises(DataLoss):
        fetch_file(
            published, tmp_path / "b", lambda name, offset: iter([bytes(published.size_bytes - offset)]), AT_ONCE
        )
    assert not list(tmp_path.glob("b*"))
    other = replace(published, map_hash="0" * 64)
    with pytest.raises(DataLoss):
        fetch_file(other, tmp_path / "c", client._transport.map_file_bytes, AT_ONCE)


def test_http_answers_ranges_of_bytes_as_rfc_9110_has_them(service, client, published):
    size, etag = published.size_bytes, f'"{published.map_hash}"'
    with httpx.Client(base_url=service.http, trust_env=False) as http:

        def ask(**headers):
            return http.get(published.map_download_link, headers={k.replace("_", "-"): v for k, v in headers.items()})

        whole = ask()
        assert (whole.status_code, whole.headers["etag"], whole.headers["accept-ranges"]) == (200, etag, "bytes")
        for asked, start, end in (
            ("bytes=0-0", 0, 1), ("bytes=10-99", 10, 100), (f"bytes={size - 5}-", size - 5, size),
            ("bytes=-7", size - 7, size), (f"bytes=3-{10 * size}", 3, size), (f"bytes=-{10 * size}", 0, size),
        ):  # fmt: skip
            part = ask(Range=asked, If_Range=etag)
            assert (part.status_code, part.content) == (206, whole.content[start:end])
            assert part.headers["content-range"] == f"bytes {start}-{end - 1}/{size}"
        for asked in (f"bytes={size}-", "bytes=-0"):
            refused = ask(Range=asked)
            assert (refused.status_code, refused.headers["content-range"]) == (416, f"bytes */{size}")
        for headers in ({"Range": "bytes=9-3"}, {"Range": "lines=1-2"}, {"Range": "bytes=0-1,4-5"},
                        {"Range": "bytes=0-1", "If_Range": '"other"'}):  # fmt: skip
            assert (ask(**headers).status_code, len(ask(**headers).content)) == (200, size)
        for known in (etag, f"W/{etag}", f'"other", W/{etag}', "*"):
            assert ask(If_None_Match=known).status_code == 304
        assert ask(If_None_Match='"other", W/"*"').status_code == 200


def test_a_file_goes_with_its_deletion_and_with_a_session_that_it_holds(client, driven, published):
    client.delete(published)
    with pytest.raises(NotFound):
        client.get_map_file(published.name)
    client.wait(client.publish_map(driven))
    client.delete(f"{driven}/sessions/monday/submaps/s2")
    assert client.map_files(driven) == []
    again = client.get_map_file(client.wait(client.publish_map(driven)).result["map_file"])
    assert (again.submaps, again.map_hash != published.map_hash) == (2, True)


def test_what_cannot_be_published_is_refused(client, driven, tmp_path):
    with pytest.raises(NotFound):
        client.publish_map(f"{driven}/versions/7")
    with pytest.raises(InvalidArgument):
        client.publish_map(driven, "two\nlines")
    with pytest.raises(NotFound):
        client.download_map_file(f"{driven}/files/1", tmp_path / "nothing")
    assert not list(tmp_path.iterdir())


def test_the_file_of_a_fleet_without_neural_maps_fails_with_a_reason(client, service):
    from tests.support.fleet_in_service import fleet_in

    bare = fleet_in(service.world, f"bare-{next(_numbers)}", sessions=2, submaps=4, per_pair=2)
    client.wait(client.optimise_map(bare.name))
    with pytest.raises(Exception, match="NOT_READY"):
        client.wait(client.publish_map(bare.name))
    assert client.map_files(bare.name) == []


def test_descriptors_and_manifest_of_a_file_are_those_of_the_map(client, driven, published, tmp_path):
    client.download_map_file(published, tmp_path / "map.rvmap")
    with MapFile.open(tmp_path / "map.rvmap") as opened:
        for row, one in enumerate(opened.submaps):
            known = client.get_submap(one.name, full=True)
            np.testing.assert_array_equal(opened.descriptors[row], np.float32(known.descriptor))
        version = client.get_map_version(f"{driven}/versions/1")
        assert opened.description.content_hash == version.content_hash
        assert json.dumps(dict(opened.description.loop_policy))


def test_reference_points_of_a_session_lie_at_one_spot_in_both_frames(service, client, driven):
    placed = placed_submaps(service.http, driven.partition("/")[2])
    (pairs,) = reference_points(service.http, placed).values()
    T_map_odom = client.correction(f"{driven}/sessions/monday").T_map_odom
    robot = np.column_stack([pairs["robot"], np.zeros(3)])
    np.testing.assert_allclose(se3.apply(T_map_odom, robot)[:, :2], pairs["rmf"], atol=0.05)
    assert list(by_session(placed)) == ["monday"] and len(pairs["rmf"]) == 3


def test_an_export_tells_of_loops_that_its_version_does_not_know(service, client, driven, capsys):
    map_id = driven.partition("/")[2]
    placed_submaps(service.http, map_id)
    assert "loop closures" not in capsys.readouterr().err
    session = client.create_session(driven, "wednesday")
    for place in range(1, 4):
        client.wait(client.post_submap(session, f"s{place}", cloud_points(place), pose(5.0 * place), place))
    placed_submaps(service.http, map_id)
    assert f"version 1 of map {map_id} was made before 3 of its loop closures" in capsys.readouterr().err
    client.wait(client.optimise_map(driven))
    placed_submaps(service.http, map_id)
    assert "loop closures" not in capsys.readouterr().err


@pytest.fixture
def written(monkeypatch):
    """The submaps that each mesh was made of."""
    asked = []

    def merged_mesh(_http, placed, _report, *, ever):
        asked.append([one.name[-2:] for one in placed])
        return np.eye(3), np.eye(3), np.array([[0, 1, 2]], dtype=np.int32)

    monkeypatch.setattr(map_files, "merged_mesh", merged_mesh)
    return asked


def test_files_are_made_of_the_neural_maps_that_retention_has_left(service, client, driven, tmp_path, written):
    map_id, transactions = driven.partition("/")[2], service.world.context.transactions

    def without_map(*submaps):
        def work(uow):
            rows = [uow.submaps.get(TENANT, map_id, "monday", one) for one in submaps]
            uow.submaps.revise(rows, state="RETIRED", neural_map_sha256=None, neural_map_bytes=None)

        transactions.write(work).result()

    def export(form="glb", *more):
        asked = [
            "export",
            "--map",
            map_id,
            "--format",
            form,
            "--out",
            str(tmp_path / "site.glb"),
            "--http",
            service.http,
        ]
        done = CliRunner().invoke(app, [*asked, *more])
        return done.exit_code, done.output.replace("\n", " ")

    without_map("s1")
    assert "2 submaps, 1 left out" in export()[1] and written == [["s2", "s3"]]
    assert export("kitti")[0] == 0 and len((tmp_path / "site.glb").read_text().splitlines()) == 3
    assert export("glb", "--as-of", "2")[0] == 0 and written.pop() == ["s2"], "what shows the place of the first one"
    without_map("s3")
    assert export()[0] == 0 and written.pop() == ["s2"]
    code, said = export("glb", "--as-of", "3")
    assert code == 1 and "removed 1 neural maps of that moment" in said
    without_map("s2")
    assert export()[0] == 1 and len(written) == 1
