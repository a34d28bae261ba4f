"""Reading and writing Wavefront OBJ: positions, polygons of any size, and one colour per material."""
from pathlib import Path

import numpy as np


def read(path):
    """Points (n x 3), faces (list of index lists), and a colour per face (m x 3, sRGB) or None without materials."""
    path = Path(path)
    points, faces, of_face, colours, current = [], [], [], {}, None
    for line in path.read_text().splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "v":
            points.append([float(t) for t in rest.split()[:3]])
        elif word == "f":
            corners = [int(t.split("/")[0]) for t in rest.split()]
            faces.append([c - 1 if c > 0 else len(points) + c for c in corners])
            of_face.append(current)
        elif word == "usemtl":
            current = rest.strip()
        elif word == "mtllib" and (path.parent / rest.strip()).is_file():
            colours.update(_read_colours(path.parent / rest.strip()))
    colour = None
    if any(name in colours for name in of_face):
        colour = np.array([colours.get(name, (0.7, 0.7, 0.7)) for name in of_face])
    return np.array(points, dtype=float).reshape(-1, 3), faces, colour


def _read_colours(path):
    colours, name = {}, None
    for line in path.read_text().splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "newmtl":
            name = rest.strip()
        elif word == "Kd":
            colours[name] = tuple(float(t) for t in rest.split())
    return colours


def write(path, points, faces, parts=()):
    """Writes an OBJ; `parts` are (name, colour, first face, number of faces) and add a material file beside it."""
    path = Path(path)
    text = []
    if parts:
        library = path.with_suffix(".mtl")
        library.write_text("".join(f"newmtl {n}\nKd {c[0]:.4f} {c[1]:.4f} {c[2]:.4f}\n" for n, c, _, _ in parts))
        text.append(f"mtllib {library.name}")
    # + 0.0 turns -0 into +0, which would otherwise be written as -0.000000
    text += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in np.round(points, 6) + 0.0]
    start = {first: name for name, _, first, _ in parts}
    for i, face in enumerate(faces):
        if i in start:
            text += [f"o {start[i]}", f"usemtl {start[i]}"]
        text.append("f " + " ".join(str(c + 1) for c in face))
    path.write_text("\n".join(text) + "\n")
