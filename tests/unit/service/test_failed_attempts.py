"""Failed attempts have a budget for each address, or network of IPv6 addresses."""

from __future__ import annotations

import pytest

from revisit.service.capacity.limits import ADDRESS_FAILURES_AT_ONCE
from revisit.service.features.keys.failed_attempts import FailedAttempts

AT_ONCE = int(ADDRESS_FAILURES_AT_ONCE)


@pytest.mark.parametrize(("address", "other"), [("2001:db8::{:x}", "2001:db8:0:1::1"), ("10.0.0.9", "10.0.0.10")])
def test_another_address_of_the_same_holder_brings_no_further_attempts(address, other):
    attempts = FailedAttempts(lambda: 0.0)
    assert [attempts.count(address.format(number)) for number in range(AT_ONCE)] == [0.0] * AT_ONCE
    assert attempts.count(address.format(AT_ONCE)) > 0.0
    assert attempts.count(other) == 0.0
