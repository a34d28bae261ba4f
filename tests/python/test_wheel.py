"""The package as pip installs it: a wheel from the folder, in a clean environment, against the real daemon."""

import ast
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import PACKAGE, ROOT
from running import write_box

import barycast

PIP_FLAGS = ("--no-index", "--no-deps", "-q", "--disable-pip-version-check")


def run(*command, cwd, **more):
    return subprocess.run(list(map(str, command)), cwd=cwd, capture_output=True, text=True, timeout=300, **more)


def clean_environment():
    return {name: value for name, value in os.environ.items()
            if not name.startswith(("PYTHON", "BARYCAST"))} | {"PYTHONDONTWRITEBYTECODE": "1"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    before = sorted(PACKAGE.rglob("*"))
    done = run(sys.executable, "-m", "pip", "wheel", "--no-build-isolation", *PIP_FLAGS, "-w", folder, PACKAGE,
               cwd=folder, env=clean_environment())
    assert done.returncode == 0, done.stderr
    assert [path for path in sorted(PACKAGE.rglob("*")) if "__pycache__" not in str(path)] == [
        path for path in before if "__pycache__" not in str(path)]  # nothing is left in the sources
    return next(folder.glob("barycast-*.whl"))


def test_what_it_holds(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = archive.read(next(name for name in names if name.endswith("METADATA"))).decode()
    sources = {f"barycast/{path.name}" for path in (PACKAGE / "barycast").iterdir() if path.is_file()}
    generated = {f"barycast/v1/{name}_pb2{end}" for name in ("cage", "options", "barycast")
                 for end in (".py", ".pyi", "_grpc.py")}
    assert sources | generated <= set(names) and "barycast/py.typed" in sources
    for line in (f"Version: {barycast.__version__}", "License: Apache-2.0", "Requires-Python: >=3.9"):
        assert line in metadata
    for dependency in ("grpcio", "protobuf", "numpy", "scipy"):
        assert f"Requires-Dist: {dependency}" in metadata
    assert "extra == 'progress'" in metadata


def test_installed_alone(wheel, real_daemon, tmp_path):
    """The system's packages are visible, the checkout is not."""
    venv = tmp_path / "venv"
    environment = clean_environment()
    done = run(sys.executable, "-m", "venv", "--system-site-packages", venv, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    done = run(venv / "bin" / "pip", "install", *PIP_FLAGS, wheel, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr

    program = venv / "bin" / "barycast"
    done = run(program, "--version", cwd=tmp_path, env=environment)
    assert (done.stdout, done.returncode) == (f"barycast {barycast.__version__}\n", 0)
    done = run(venv / "bin" / "python", "-c", "import barycast.v1.cage_pb2 as m; print(m.__file__)", cwd=tmp_path,
               env=environment)
    assert done.stdout.startswith(str(venv)), done.stderr

    cage, model = write_box(tmp_path)
    bind = (program, "bind", cage, model, "-o", tmp_path / "bind.npz")
    done = run(*bind, cwd=tmp_path, env={**environment, "PATH": "/usr/bin:/bin"})
    assert done.returncode == 3 and "PATH" in done.stderr and "BARYCASTD" in done.stderr
    for found in ({"BARYCASTD": str(real_daemon)}, {"PATH": f"{real_daemon.parent}:/usr/bin:/bin"}):
        done = run(*bind, cwd=tmp_path, env={**environment, **found})
        assert (done.returncode, done.stderr) == (0, "")
        assert "50 points, 8 control vertices" in done.stdout


@pytest.mark.parametrize("readme", [ROOT / "README.md", PACKAGE / "README.md"])
def test_what_the_readmes_say_needs_no_network(readme, tmp_path):
    lines = re.findall(r"^\S+ -m venv .*$|^build/venv/bin/pip install .*$", readme.read_text(), re.MULTILINE)
    script = "\n".join(["set -e", *lines]).replace("build/venv", str(tmp_path / "venv"))
    done = run("sh", "-c", script.replace("/usr/bin/python3", sys.executable), cwd=ROOT,
               env={**clean_environment(), "PIP_NO_INDEX": "1"})
    assert done.returncode == 0, done.stderr
    done = run(tmp_path / "venv" / "bin" / "barycast", "--version", cwd=tmp_path, env=clean_environment())
    assert done.stdout == f"barycast {barycast.__version__}\n"


def test_without_a_generator(tmp_path):
    """Neither protoc nor grpc_tools: one sentence says what to install."""
    blocked = "import sys; sys.modules['grpc_tools'] = None; sys.argv = ['setup.py', '-q', 'bdist_wheel', '-d', '.']\n"
    script = tmp_path / "build.py"
    script.write_text(f"import os, runpy, importlib.util\nfind = importlib.util.find_spec\n"
                      "importlib.util.find_spec = lambda name, *a: None if name == 'grpc_tools' else find(name, *a)\n"
                      f"{blocked}os.chdir({str(PACKAGE)!r}); runpy.run_path('setup.py')\n")
    done = run(sys.executable, script, cwd=tmp_path, env={**clean_environment(), "PATH": str(tmp_path)})
    assert done.returncode != 0 and "protobuf-compiler-grpc" in done.stderr and "grpcio-tools" in done.stderr


def test_one_version():
    project = re.search(r"project\(barycast VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())
    assert barycast.__version__ == project.group(1)


def test_syntax_of_python_3_9():
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text(), str(path), feature_version=(3, 9))
        futures = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module == "__future__"]
        annotated = any(getattr(node, "returns", None) is not None for node in ast.walk(tree))
        assert futures or not annotated or path.name == "setup.py", f"{path}: annotations are evaluated"


def test_on_old_interpreters(tmp_path):
    """Compiles with every older Python that is installed."""
    old = [found for minor in (9, 10) for found in [shutil.which(f"python3.{minor}")] if found]
    if not old:
        pytest.skip("no python3.9 or python3.10")
    for interpreter in old:
        copy = tmp_path / Path(interpreter).name
        shutil.copytree(PACKAGE, copy)
        done = run(interpreter, "-m", "compileall", "-q", copy, cwd=tmp_path)
        if "command not found" not in done.stderr:  # a version manager's shim
            assert done.returncode == 0, done.stdout + done.stderr
