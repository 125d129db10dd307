"""Repeating what is retryable."""

from __future__ import annotations

import pytest

from revisit.sdk.errors import ApiError, ErrorDetails, error_of
from revisit.sdk.retry import RetryPolicy


class Service:
    """Fails so often, then answers."""

    def __init__(self, failures: int, retryable: bool = True, retry_after_s: float | None = None):
        self.failures, self.calls = failures, 0
        self.error = error_of(
            ErrorDetails("UNAVAILABLE", "WORKERS_BUSY", "busy", retryable=retryable, retry_after_s=retry_after_s)
        )

    def answer(self) -> str:
        self.calls += 1
        if self.calls <= self.failures:
            raise self.error
        return "answer"


QUICK = RetryPolicy(attempts=4, base_s=0.0)


def test_a_retryable_error_is_repeated_until_it_is_gone():
    service = Service(failures=3)
    assert QUICK.run(service.answer) == "answer"
    assert service.calls == 4


def test_the_last_error_is_raised_when_the_attempts_are_used_up():
    service = Service(failures=4)
    with pytest.raises(ApiError, match="WORKERS_BUSY"):
        QUICK.run(service.answer)
    assert service.calls == 4


def test_what_is_not_retryable_is_not_repeated():
    service = Service(failures=1, retryable=False)
    with pytest.raises(ApiError):
        QUICK.run(service.answer)
    assert service.calls == 1


@pytest.mark.parametrize("reason", ["SEQ_NOT_REACHED", "NO_ANSWER"])
def test_what_the_service_has_waited_for_is_not_asked_again_in_silence(reason):
    service = Service(failures=1)
    service.error = error_of(ErrorDetails("DEADLINE_EXCEEDED", reason, "waited", retryable=True))
    with pytest.raises(ApiError, match=reason):
        QUICK.run(service.answer)
    assert service.calls == 1


def test_a_pause_is_at_least_what_the_service_asks_for_and_at_most_the_cap():
    policy = RetryPolicy(base_s=1.0, cap_s=3.0)
    assert policy.pause_s(1, asked_s=7.0) == 7.0
    pauses = [policy.pause_s(failures) for failures in range(1, 200)]
    assert all(0.0 <= pause <= 3.0 for pause in pauses)
    # Full jitter: early pauses are short too.
    assert min(pauses) < 1.0
