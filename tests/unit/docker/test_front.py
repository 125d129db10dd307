"""The front for exposed sites fits the service that is behind it, and nginx takes its file."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import trustme

from revisit.service.domain import limits
from revisit.service.features.events.calls import HEARTBEAT_S
from revisit.service.rest.limits import MIB, HttpLimits
from revisit.service.settings import Settings

ROOT = Path(__file__).resolve().parents[3]
FRONT = (ROOT / "docker/nginx.conf").read_text()


def values(directive):
    """What follows a directive, wherever it stands."""
    return re.findall(rf"^\s*{directive}\s+([^;{{]+);", FRONT, re.MULTILINE)


def test_the_front_leads_to_the_ports_of_the_service_on_this_machine():
    settings = {name: field.default for name, field in Settings.model_fields.items()}
    assert values("server") == [f"127.0.0.1:{settings[port]}" for port in ("http_port", "grpc_port")]


def test_the_front_takes_as_large_a_body_as_the_service_and_waits_as_long():
    rest, rpc = values("client_max_body_size")
    assert (rest, rpc) == (f"{HttpLimits().body_bytes // MIB}m", "0")
    (patience,) = values("proxy_read_timeout")
    assert int(patience.removesuffix("s")) > max(limits.WAIT_S.most, HEARTBEAT_S)


def test_the_front_hands_on_the_name_it_was_asked_by():
    assert "Host $host" in values("proxy_set_header")


@pytest.mark.parametrize("directive", ["limit_conn", "limit_req_zone", "limit_req", "http2_max_concurrent_streams"])
def test_the_front_bounds_what_one_address_may_do(directive):
    assert values(directive)


def test_nginx_takes_the_file(tmp_path):
    nginx = shutil.which("nginx")
    if nginx is None:
        pytest.skip("nginx is not installed: scripts/test_tools.sh brings it")
    certificate = trustme.CA().issue_cert("maps.example")
    certificate.cert_chain_pems[0].write_to_path(tmp_path / "chain.pem")
    certificate.private_key_pem.write_to_path(tmp_path / "key.pem")
    own = f"pid {tmp_path}/nginx.pid;\nerror_log {tmp_path}/error.log;\n"
    own += FRONT.replace("/etc/revisit", str(tmp_path)).replace(
        "http {\n", f"http {{\n    access_log off;\n{paths(tmp_path)}", 1
    )
    (tmp_path / "nginx.conf").write_text(own)
    checked = subprocess.run(
        [nginx, "-t", "-e", str(tmp_path / "error.log"), "-c", str(tmp_path / "nginx.conf")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert checked.returncode == 0, checked.stderr
    assert "[warn]" not in checked.stderr


def paths(folder):
    """The folders that nginx would make elsewhere, below one that we may write."""
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    return "".join(f"    {kind}_temp_path {folder}/{kind};\n" for kind in kinds)
