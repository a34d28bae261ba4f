"""When another attempt is made, without waiting for it."""

import pytest

from barycast import ServerError
from barycast.retry import Retry

AWAY = ServerError("no connection", code="UNAVAILABLE")
BUSY = ServerError("too busy", code="RESOURCE_EXHAUSTED", retry_seconds=2.0)


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def make(retry_seconds=10.0, timeout_seconds=None, uniform=lambda low, high: high):
    clock = Clock()
    return Retry(retry_seconds, timeout_seconds, clock, uniform), clock


def waits(retry, clock, error, attempt_seconds=0.0):
    """All waits until it gives up."""
    seen = []
    for _ in range(1000):
        try:
            seen.append(retry.wait_after(error))
        except ServerError as raised:
            assert raised is error
            return seen
        clock.now += seen[-1] + attempt_seconds
    raise AssertionError("no end")


def test_bounds_double_and_the_budget_ends_them():
    seen = waits(*make(), AWAY)
    assert seen[:6] == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2] and sum(seen) == pytest.approx(10)


def test_jitter_is_full():
    asked = []
    retry, _ = make(uniform=lambda low, high: asked.append((low, high)) or low)
    assert [retry.wait_after(AWAY) for _ in range(3)] == [0, 0, 0]
    assert asked == [(0, 0.1), (0, 0.2), (0, 0.4)]


def test_failing_attempts_cost_budget_too():
    assert len(waits(*make(), AWAY, attempt_seconds=4.0)) == 3


def test_busy_servers_say_how_long():
    retry, clock = make()
    assert waits(retry, clock, BUSY)[:2] == [2.1, 2.2]
    with pytest.raises(ServerError):  # longer than there is time
        make(retry_seconds=1.0)[0].wait_after(BUSY)


@pytest.mark.parametrize("code", ["INTERNAL", "UNKNOWN", "DEADLINE_EXCEEDED", "CANCELLED", "FAILED_PRECONDITION",
                                  "DATA_LOSS", "ABORTED", "RESOURCE_EXHAUSTED"])
def test_other_codes_are_final(code):
    with pytest.raises(ServerError):
        make()[0].wait_after(ServerError("no", code=code))


def test_rows_end_the_loss_and_shorten_waits():
    retry, clock = make(retry_seconds=1.0)
    for _ in range(3):
        assert retry.wait_after(AWAY) == 0.1
        clock.now += 0.3
        retry.progressed()
        clock.now += 1000  # rows arrive: nothing is lost
        retry.progressed()
    assert waits(retry, clock, AWAY) == [pytest.approx(0.1)]


def test_the_deadline_covers_all_attempts():
    retry, clock = make(timeout_seconds=5.0)
    assert retry.timeout() == 5.0
    clock.now += 2
    assert retry.timeout() == 3.0
    assert sum(waits(retry, clock, AWAY)) < 3.0
    clock.now += 10
    assert retry.timeout() == 0.0
    assert make()[0].timeout() is None


def test_no_retries():
    with pytest.raises(ServerError):
        make(retry_seconds=0.0)[0].wait_after(AWAY)
