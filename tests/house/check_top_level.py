#!/usr/bin/env python3
"""Checks that the top level holds the known entries only; dot-files and build folders are not looked at."""
import house

KNOWN = {"CMakeLists.txt", "proto", "server", "core", "client_examples", "deploy", "tests", "README.md", "LICENSE"}


def check(root):
    return [f"{p.name}: the top level does not know this entry; it holds {', '.join(sorted(KNOWN))}"
            for p in sorted(root.iterdir())
            if p.name not in KNOWN and not p.name.startswith(".") and not p.name.startswith("build")]


def self_test():
    good = {"README.md": "", "core/a.h": "", ".gitignore": "", "build-asan/x": ""}
    assert house.found_in(check, good) == []
    assert len(house.found_in(check, {**good, "notes.txt": "", "src/a.cpp": ""})) == 2


if __name__ == "__main__":
    house.run(check, self_test)
