"""Forks, in a process where gRPC's asyncio part was never used (it does not survive them)."""

import subprocess
import sys
from pathlib import Path


def test_forks(real_daemon, environment):
    """Twice at most: with gRPC 1.51 about one child in 400, forked right after a call, still hangs."""
    cases = Path(__file__).parent / "support" / "fork_cases.py"
    for _ in range(2):
        done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(cases)],
                              env=environment, capture_output=True, text=True, timeout=180)
        if done.returncode == 0:
            break
    assert done.returncode == 0 and "6 passed" in done.stdout, done.stdout
