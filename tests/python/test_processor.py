"""What the daemon says on processors older than x86-64-v3, which QEMU pretends to be."""

import shutil
import subprocess

import pytest

EMULATOR = shutil.which("qemu-x86_64")
pytestmark = pytest.mark.skipif(EMULATOR is None, reason="no qemu-x86_64 (package qemu-user)")


def version_on(processor, daemon):
    command = [EMULATOR, "-cpu", processor, daemon, "--version"]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("processor", ["Nehalem", "SandyBridge", "Haswell,-bmi2", "Haswell,-movbe", "Haswell,-fma",
                                       "Haswell,-avx2", "Haswell,-xsave"])
def test_an_old_processor_gets_a_sentence(real_daemon, processor):
    done = version_on(processor, real_daemon)
    assert done.returncode == 3
    assert done.stdout == ""
    # QEMU itself may warn first of what it does not emulate.
    said = [line for line in done.stderr.splitlines() if not line.startswith("qemu-x86_64: warning")]
    assert said == ["barycastd: this processor lacks AVX2, FMA or BMI (x86-64-v3), or a hypervisor hides them; run it "
                    "on one from 2015 or later."]


def test_the_oldest_that_is_new_enough(real_daemon):
    done = version_on("Haswell", real_daemon)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("barycastd ")
