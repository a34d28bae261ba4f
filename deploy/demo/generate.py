#!/usr/bin/env python3
"""Writes the demo's model, cage and posed cage as OBJ files: python3 generate.py FOLDER"""
import argparse
from pathlib import Path

import cage
import character
import obj


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    obj.write(folder / "character.obj", *character.build())
    vertices, quads = cage.build()
    obj.write(folder / "cage.obj", vertices, quads)
    obj.write(folder / "cage_posed.obj", cage.posed(vertices), quads)


if __name__ == "__main__":
    main()
