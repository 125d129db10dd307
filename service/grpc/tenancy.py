"""Whose resources a call is about."""

from __future__ import annotations

from typing import Any

from revisit.service.application import TenantId
from revisit.service.application.access.callers import current_tenant


def tenant_of(_context: Any) -> TenantId:
    """The tenant of a call: from the credential alone, which `access.Gate` has verified before."""
    return current_tenant()
