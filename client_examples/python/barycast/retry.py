"""When to try again, and after how long: decisions only, nothing here waits."""

from __future__ import annotations

import random
import time
from typing import Callable, Optional

from .errors import ServerError

RETRY_SECONDS = 15.0  # a daemon that restarts takes two; a wrong address should not take a minute to be told
_BOUND_SECONDS_FIRST = 0.1
_BOUND_SECONDS_MAX = 5.0


class Retry:
    """The attempts of one call.

    retry_seconds: how much time failures may cost altogether, each counted until the next rows arrive.
    timeout_seconds: of all attempts together; None: no limit. Waits are random below a bound that doubles (full
    jitter), so that a farm's clients do not return together.
    """

    def __init__(self, retry_seconds: float, timeout_seconds: Optional[float],
                 now: Callable[[], float] = time.monotonic,
                 uniform: Callable[[float, float], float] = random.uniform) -> None:
        self._now = now
        self._uniform = uniform
        self._budget = retry_seconds
        self._deadline = None if timeout_seconds is None else now() + timeout_seconds
        self._failed_at: Optional[float] = None
        self._waits = 0

    def timeout(self) -> Optional[float]:
        """Seconds left for the next attempt, or None."""
        return None if self._deadline is None else max(0.0, self._deadline - self._now())

    def progressed(self) -> None:
        """Rows arrived: no time is being lost any more, and the next failure starts with short waits."""
        if self._failed_at is not None:
            self._budget -= self._now() - self._failed_at
            self._failed_at = None
            self._waits = 0

    def wait_after(self, error: ServerError) -> float:
        """Seconds to wait before the next attempt. Throws the error when none makes sense: anything but UNAVAILABLE
        and RESOURCE_EXHAUSTED with a delay stated by the server, or the time is used up."""
        busy = error.code == "RESOURCE_EXHAUSTED" and error.retry_seconds is not None
        if error.code != "UNAVAILABLE" and not busy:
            raise error
        now = self._now()
        if self._failed_at is None:
            self._failed_at = now
        left = self._budget - (now - self._failed_at)
        asked = error.retry_seconds or 0.0
        if left <= 0 or asked > left:
            raise error
        bound = min(_BOUND_SECONDS_MAX, _BOUND_SECONDS_FIRST * 2**min(self._waits, 16))
        wait = min(left, asked + self._uniform(0.0, bound))
        if self._deadline is not None and now + wait >= self._deadline:
            raise error
        self._waits += 1
        return wait
