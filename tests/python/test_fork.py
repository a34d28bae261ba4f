"""Forks, in a process where gRPC's asyncio part was never used (it does not survive them)."""

import subprocess
import sys
from pathlib import Path


def test_forks(real_daemon, environment):
    cases = Path(__file__).parent / "support" / "fork_cases.py"
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(cases)], env=environment,
                          capture_output=True, text=True, timeout=180)
    assert done.returncode == 0 and "6 passed" in done.stdout, done.stdout
