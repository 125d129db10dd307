"""Whose resources a call is about."""

from __future__ import annotations

from typing import Any

from service.application import DEFAULT_TENANT, TenantId


def tenant_of(_context: Any) -> TenantId:
    """The tenant of a call. Tenants come from credentials, which a later issue adds; until then there is one."""
    return DEFAULT_TENANT
