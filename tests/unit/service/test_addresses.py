"""What a webhook may lead to: the internet, and nothing that only the service can reach."""

from __future__ import annotations

import pytest

from revisit.core.errors import BadField
from revisit.service.features.webhooks.rules import is_public, validated_url

PUBLIC = ("93.184.215.14", "2606:2800:21f:cb07:6820:80da:af6b:8b2c", "::ffff:93.184.215.14")
PRIVATE = (
    "127.0.0.1", "127.9.9.9", "0.0.0.0", "10.0.0.1", "172.16.0.1", "172.31.255.255", "192.168.1.1", "169.254.169.254",
    "100.64.0.1", "192.0.0.1", "192.0.2.1", "198.18.0.1", "224.0.0.1", "240.0.0.1", "255.255.255.255", "::", "::1",
    "fe80::1", "fe80::1%eth0", "fc00::1", "fd12::1", "ff02::1", "::ffff:127.0.0.1", "::ffff:10.0.0.1",
    "64:ff9b::7f00:1", "64:ff9b::a9fe:a9fe", "2002:7f00:1::", "2001:0:7f00:1::", "2001:db8::1", "nonsense", "",
    # Never given out as addresses of the internet, and yet dialled by some systems, as the IPv4 address inside.
    "::127.0.0.1", "::10.0.0.1", "::ffff:0:127.0.0.1", "fec0::1", "4000::1", "5f00::1", "3fff::1", "100::1",
)  # fmt: skip


@pytest.mark.parametrize("address", PUBLIC)
def test_addresses_of_the_internet_are_public(address):
    assert is_public(address)


@pytest.mark.parametrize("address", PRIVATE)
def test_what_is_not_of_the_internet_is_not_public(address):
    assert not is_public(address)


@pytest.mark.parametrize(
    "url",
    ["https://hooks.example.com/revisit", "https://hooks.example.com:8443/a?b=c", "https://93.184.215.14/"],
)
def test_urls_of_the_internet_are_taken(url):
    assert validated_url(url, private=False) == url


@pytest.mark.parametrize(
    "url",
    [
        "", "hooks.example.com", "http://hooks.example.com/", "ftp://a.b/", "file:///etc/passwd", "https://",
        "https://user:word@a.b/", "https://a.b/#part", "https://a.b:99999/", "https://a b/", "https://a.b\n/",
        "https://ä.example/", "https://localhost/", "https://LOCALHOST./", "https://x.localhost/", "https://127.0.0.1/",
        "https://2130706433/", "https://0x7f000001/", "https://127.1/", "https://[::1]/", "https://[::ffff:7f00:1]/",
        "https://169.254.169.254/latest/meta-data", "https://a.b\\@127.0.0.1/", "https://a.b/" + "a" * 2000,
    ],
)  # fmt: skip
def test_urls_that_lead_elsewhere_are_refused(url):
    with pytest.raises(BadField):
        validated_url(url, private=False)


@pytest.mark.parametrize("url", ["http://127.0.0.1:9000/", "https://[::1]/", "http://hooks.lan/"])
def test_where_private_networks_are_allowed_they_may_be_named(url):
    assert validated_url(url, private=True) == url
    with pytest.raises(BadField):
        validated_url("file:///etc/passwd", private=True)
