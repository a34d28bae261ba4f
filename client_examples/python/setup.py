"""What pyproject.toml cannot say: the messages (`barycast/v1`) are generated from the repository's `proto` while a
wheel is built, by protoc and grpc_python_plugin where both are on PATH (Debian: protobuf-compiler,
protobuf-compiler-grpc), else by grpc_tools (pip: grpcio-tools). Nothing is written into the source folder."""

import importlib.util
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
FILES = [f"barycast/v1/{name}.proto" for name in ("cage", "options", "barycast")]


def proto_folder() -> Path:
    """Beside this file in a source distribution, at the top of the repository otherwise."""
    for folder in (HERE / "proto", HERE.parents[1] / "proto"):
        if (folder / FILES[0]).exists():
            return folder
    raise SystemExit(f"barycast: no API description {FILES[0]} in {HERE}/proto or in the repository's proto folder; "
                     "build from a checkout of the repository or from its source distribution")


def generate(out: Path) -> None:
    """Writes barycast/v1 below out."""
    protoc, plugin = shutil.which("protoc"), shutil.which("grpc_python_plugin")
    if protoc and plugin:
        command = [protoc, f"--plugin=protoc-gen-grpc_python={plugin}"]
    elif importlib.util.find_spec("grpc_tools"):
        command = [sys.executable, "-m", "grpc_tools.protoc"]
    else:
        raise SystemExit("barycast: nothing here generates the messages: install protoc and grpc_python_plugin "
                         "(Debian: protobuf-compiler, protobuf-compiler-grpc) or grpcio-tools (pip)")
    subprocess.run([*command, "-I", str(proto_folder()), f"--python_out={out}", f"--pyi_out={out}",
                    f"--grpc_python_out={out}", *FILES], check=True)


class BuildWithMessages(build_py):
    def run(self) -> None:
        super().run()
        out = Path(self.build_lib)
        out.mkdir(parents=True, exist_ok=True)
        generate(out)
        (out / "barycast" / "v1" / "__init__.py").touch()


class SourcesWithProto(sdist):
    def make_release_tree(self, base_dir, files) -> None:
        super().make_release_tree(base_dir, files)
        for name in FILES:
            target = Path(base_dir) / "proto" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(proto_folder() / name, target)


with tempfile.TemporaryDirectory(prefix="barycast-build-") as scratch:
    setup(cmdclass={"build_py": BuildWithMessages, "sdist": SourcesWithProto},
          options={"build": {"build_base": scratch}, "egg_info": {"egg_base": scratch}})
