#!/usr/bin/env python3
"""Proves that a wrong include does not compile.

check_views.py COMPILER CORE LAYER=FOLDER:FOLDER... : with the include folders of each layer, a one-line file that
includes a header of the layer itself or of one to its left is preprocessed, and one to its right is not found.
"""
import subprocess
import sys
from pathlib import Path

import house


def preprocess(compiler, folders, header):
    command = [compiler, "-std=c++20", "-E", "-x", "c++", "-", "-o", "/dev/null"]
    command += [f"-I{f}" for f in folders if f]
    return subprocess.run(command, input=f'#include "{header}"\n', capture_output=True, text=True, check=False)


def main():
    compiler, core = sys.argv[1], Path(sys.argv[2])
    views = dict(argument.split("=", 1) for argument in sys.argv[3:])
    headers = {layer: sorted((core / layer).glob("*.h"))[0] for layer in house.LAYERS}
    failures = []
    for number, layer in enumerate(house.LAYERS):
        folders = views[layer].split(":")
        for other, header in headers.items():
            name = f"{other}/{header.name}"
            result = preprocess(compiler, folders, name)
            if house.LAYERS.index(other) <= number:
                if result.returncode != 0:
                    failures.append(f"{layer} cannot include {name}:\n{result.stderr}")
            elif result.returncode == 0:
                failures.append(f"{layer} can include {name}, which is to its right")
            elif name not in result.stderr:
                failures.append(f"{layer} cannot include {name}, but for another reason:\n{result.stderr}")
    print("\n".join(failures) or "every layer sees itself and what is to its left, and nothing else")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
