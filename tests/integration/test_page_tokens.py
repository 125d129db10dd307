"""The tokens of pages outlive a restart, where the disk has room for what makes them unreadable."""

from __future__ import annotations

import errno

import pytest

from revisit.core.errors import BadField
from revisit.service import composition
from revisit.service.engines.local.sqlite.migration import migrate
from revisit.service.features.resources.paging import PageTokens
from revisit.service.settings import Settings
from revisit.service.settings_loading import UnusableSettings, load_settings


@pytest.fixture
def started(tmp_path):
    """Starts the service's installation on one data folder, again and again; its tokens."""
    settings, opened = Settings(home=tmp_path), []
    migrate(settings.database)

    def start() -> PageTokens:
        opened.append(composition.build_context(settings, gateway=True))
        return PageTokens(opened[-1].secret)

    yield start
    for installation in opened:
        installation.transactions.close()


def test_a_token_is_good_after_a_restart(started):
    token = started().after("acme", 17)
    assert started().number_in("acme", token) == 17


def test_a_token_of_another_tenant_or_another_service_is_refused(started):
    token = started().after("acme", 17)
    for tokens, tenant in ((started(), "other"), (PageTokens(b"another service"), "acme")):
        with pytest.raises(BadField):
            tokens.number_in(tenant, token)


def test_gateways_of_one_secret_take_the_tokens_of_each_other(tmp_path):
    def tokens(home: str, secret: str) -> PageTokens:
        return PageTokens(composition.page_secret(Settings(home=tmp_path / home, secret=secret)))

    token = tokens("one", "s" * 32).after("acme", 17)
    assert tokens("two", "s" * 32).number_in("acme", token) == 17
    with pytest.raises(BadField):
        tokens("two", "t" * 32).number_in("acme", token)


def test_a_short_secret_ends_the_start_and_is_not_shown(monkeypatch):
    monkeypatch.setenv("REVISIT_SECRET", "hunter2")
    with pytest.raises(UnusableSettings, match="REVISIT_SECRET") as refused:
        load_settings()
    assert "hunter2" not in str(refused.value)


def test_on_a_full_disk_the_service_starts_and_its_tokens_last_until_it_ends(started, monkeypatch):
    def full(path):
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(composition, "kept_secret", full)
    tokens = started()
    assert tokens.number_in("acme", tokens.after("acme", 2**62)) == 2**62
