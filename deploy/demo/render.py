#!/usr/bin/env python3
"""Renders a model inside its cage, at rest and optionally posed beside it, to a PNG.

    python3 render.py OUT.png --model M.obj --cage C.obj [--posed-model P.obj --posed-cage Q.obj]

Colours come from the model's materials. Of the posed model only the positions are read: its faces and colours are
those of --model, so the output of a deformer, which has no materials, can be given as it is.
"""
import argparse
from dataclasses import dataclass

import matplotlib.image
import numpy as np

import light
import obj
import raster

SUPERSAMPLING = 2
GROUND = 150  # points along one side of the ground
BACKGROUND_TOP = np.array([0.80, 0.87, 0.90])
BACKGROUND_BOTTOM = np.array([0.97, 0.95, 0.91])
PLAIN = np.array([0.76, 0.57, 0.44])  # a model without materials: terracotta
CAGE = np.array([0.10, 0.21, 0.40])
SKY_LIGHT = np.array([0.58, 0.64, 0.72])
KEY_LIGHT = np.array([0.98, 0.89, 0.77])


@dataclass
class Panel:
    points: np.ndarray
    triangles: np.ndarray
    colour: np.ndarray  # per triangle, linear light
    cage_points: np.ndarray
    cage_edges: np.ndarray


class Camera:
    """A perspective camera that looks at `centre` from `distance`, turned by yaw and pitch (degrees)."""

    def __init__(self, centre, distance, yaw, pitch, focal, principal):
        yaw, pitch = np.radians(yaw), np.radians(pitch)
        back = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
        right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        self.frame = np.stack([right, np.cross(back, right), back], axis=1)
        self.eye = centre + distance * back
        self.focal, self.principal = focal, np.asarray(principal, dtype=float)
        self.heading = (right, np.array([np.sin(yaw), 0.0, np.cos(yaw)]))

    def project(self, p):
        """Pixels and a depth that is linear on the screen."""
        q = (p - self.eye) @ self.frame
        z = np.minimum(q[:, 2], -1e-6)
        return self.principal + self.focal * np.stack([q[:, 0], -q[:, 1]], axis=1) / -z[:, None], 1.0 / z


def to_linear(srgb):
    return np.asarray(srgb) ** 2.2


def to_triangles(faces):
    """A fan per face, and the face each triangle came from."""
    triangles, source = [], []
    for i, f in enumerate(faces):
        for k in range(1, len(f) - 1):
            triangles.append((f[0], f[k], f[k + 1]))
            source.append(i)
    return np.array(triangles), np.array(source)


def edges_of(faces):
    return np.array(sorted({tuple(sorted((f[i - 1], f[i]))) for f in faces for i in range(len(f))}))


def vertex_normals(p, triangles):
    face = np.cross(p[triangles[:, 1]] - p[triangles[:, 0]], p[triangles[:, 2]] - p[triangles[:, 0]])
    n = np.stack([sum(np.bincount(triangles[:, k], face[:, a], len(p)) for k in range(3)) for a in range(3)], axis=1)
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)


def background(width, height):
    """A soft vertical gradient, brighter behind the models."""
    y, x = np.mgrid[0:height, 0:width]
    t = (y / height)[..., None]
    image = to_linear(BACKGROUND_TOP) * (1 - t) + to_linear(BACKGROUND_BOTTOM) * t
    glow = np.exp(-(((x / width - 0.5) / 0.55) ** 2 + ((y / height - 0.5) / 0.6) ** 2))[..., None]
    return image * (0.90 + 0.12 * glow)


def ground_grid(panel, extent):
    """A square of ground under the model: points and triangles."""
    middle = 0.5 * (panel.points.min(axis=0) + panel.points.max(axis=0))
    s = np.linspace(-1.5, 1.5, GROUND) * extent
    gx, gz = np.meshgrid(s, s)
    floor = np.full(GROUND * GROUND, panel.points[:, 1].min())
    corner = np.arange(GROUND * GROUND).reshape(GROUND, GROUND)
    a, b, c, d = (corner[i:GROUND - 1 + i, j:GROUND - 1 + j].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([middle[0] + gx.ravel(), floor, middle[2] + gz.ravel()], axis=1), triangles


def draw_ground(image, points, triangles, sky, key, camera, extent):
    """Darkens the background where the ground below the model is in shadow.

    Shadows are soft, so one value serves all samples of a pixel of the result.
    """
    shade = 0.55 * sky + 0.45 * key / max(key.max(), 1e-9)
    away = np.hypot(*(points - points.mean(axis=0))[:, [0, 2]].T) / extent
    shade = 1 - np.clip(1.5 - away, 0, 1) ** 2 * (1 - shade)
    xy, depth = camera.project(points)
    ss = SUPERSAMPLING
    owner, _, w = raster.nearest_triangles(xy / ss, depth, triangles, image.shape[1] // ss, image.shape[0] // ss)
    hit = owner >= 0
    value = np.ones(owner.shape)
    value[hit] = interpolate(shade[:, None], triangles[owner[hit]], w[hit])[:, 0]
    # Shadows are a little blue: only the sky lights them.
    tint = value[..., None] ** np.array([1.0, 0.93, 0.82])
    image *= tint.repeat(ss, axis=0).repeat(ss, axis=1)


def smooth_over_edges(values, triangles, passes):
    """Averages values with those of the neighbours along edges, which hides the depth maps' cells."""
    a = np.concatenate([triangles, np.roll(triangles, 1, axis=1), np.roll(triangles, 2, axis=1)]).ravel()
    b = np.concatenate([np.roll(triangles, 1, axis=1), np.roll(triangles, 2, axis=1), triangles]).ravel()
    count = np.maximum(np.bincount(a, minlength=len(values)), 1)
    for _ in range(passes):
        values = 0.5 * (values + np.bincount(a, values[b], len(values)) / count)
    return values


def interpolate(values, corners, w):
    w1, w2 = w[:, :1].astype(float), w[:, 1:].astype(float)
    return values[corners[:, 0]] * (1 - w1 - w2) + values[corners[:, 1]] * w1 + values[corners[:, 2]] * w2


def draw_model(image, panel, normals, sky, key, camera):
    """Shades the model into the image and returns its z-buffer."""
    p, triangles = panel.points, panel.triangles
    towards, _ = light.key_directions(camera.heading)
    xy, depth = camera.project(p)
    owner, nearest, w = raster.nearest_triangles(xy, depth, triangles, image.shape[1], image.shape[0])
    hit = owner >= 0
    corners = triangles[owner[hit]]
    n = interpolate(normals, corners, w[hit])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    lit = interpolate(np.stack([sky, key], axis=1), corners, w[hit])
    view = camera.eye - interpolate(p, corners, w[hit])
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    n *= np.sign((n * view).sum(axis=1, keepdims=True) + 1e-12)  # open or inverted surfaces: light the side we see
    albedo = panel.colour[owner[hit]]
    ambient = lit[:, :1]
    # Light that bounces between parts takes on their colour, so creases are warm and not grey.
    bounced = ambient ** (1.0 - 0.35 * albedo)
    up = 0.5 + 0.5 * n[:, 1:2]
    colour = albedo * (SKY_LIGHT * bounced * (0.72 + 0.28 * up) + KEY_LIGHT * lit[:, 1:2]
                       + np.array([0.10, 0.075, 0.05]) * (1 - up) * ambient)
    half = towards + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    gloss = np.maximum((n * half).sum(axis=1), 0)[:, None] ** 28
    rim = (1 - np.clip((n * view).sum(axis=1), 0, 1))[:, None] ** 3
    colour += 0.055 * gloss * lit[:, 1:2] + 0.13 * rim * ambient * SKY_LIGHT * (0.35 + albedo)
    image[hit] = colour
    return nearest


def draw_cage(image, nearest, panel, camera, scale):
    """Edges as lines and control vertices as dots, far to near; nearer ones are wider and more opaque."""
    xy, depth = camera.project(panel.cage_points)
    closeness = (depth.max() - depth) / max(np.ptp(depth), 1e-12)
    bias = np.ptp(depth) * 0.004
    colour = to_linear(CAGE)
    pieces = [(depth[[a, b]].mean(), a, b) for a, b in panel.cage_edges]
    pieces += [(depth[v] - bias, v, v) for v in range(len(xy))]
    for _, a, b in sorted(pieces, reverse=True):
        near = 0.5 * (closeness[a] + closeness[b])
        width = (0.55 + 0.75 * near) if a != b else (1.7 + 1.9 * near)
        opacity = 0.42 + 0.50 * near
        raster.blend_line(image, nearest, xy[a], xy[b], depth[a], depth[b], scale * width, colour, opacity,
                          0.20 if a != b else 0.16, bias)


def layout(panels, width, height, yaw, pitch):
    """One camera per panel, all of the same scale, so that every cage fits its column and all stand on one line."""
    boxes = [np.concatenate([q.points, q.cage_points]) for q in panels]
    extent = max(np.ptp(b, axis=0).max() for b in boxes)
    focal = 1.0
    cameras, bounds = [], []
    for b, q in zip(boxes, panels):
        centre = 0.5 * (b.min(axis=0) + b.max(axis=0))
        centre[1] = q.points[:, 1].min() + 0.5 * extent
        cameras.append(Camera(centre, 4.2 * extent, yaw, pitch, focal, (0, 0)))
        xy, _ = cameras[-1].project(b)
        bounds.append((xy.min(axis=0), xy.max(axis=0)))
    top, bottom = min(lo[1] for lo, _ in bounds), max(hi[1] for _, hi in bounds)
    total = sum(hi[0] - lo[0] for lo, hi in bounds)
    gap = 0.045 * width
    scale = min((width - gap * (len(panels) + 1)) / total, 0.90 * height / (bottom - top))
    gap = (width - scale * total) / (len(panels) + 1)
    x = gap
    for camera, (lo, hi) in zip(cameras, bounds):
        camera.focal = scale
        camera.principal = np.array([x - scale * lo[0], 0.5 * height - 0.5 * scale * (top + bottom)])
        x += scale * (hi[0] - lo[0]) + gap
    return cameras, extent


def render(panels, width, height, yaw, pitch):
    ss = SUPERSAMPLING
    image = background(width * ss, height * ss)
    cameras, extent = layout(panels, width * ss, height * ss, yaw, pitch)
    lit = []
    for panel, camera in zip(panels, cameras):
        ground, tiles = ground_grid(panel, extent)
        normals = vertex_normals(panel.points, panel.triangles)
        occluders = light.surface_samples(panel.points, panel.triangles, extent / light.CELLS)
        sky, key = light.sky_and_key(np.concatenate([panel.points, ground]),
                                     np.concatenate([normals, np.tile([0.0, 1.0, 0.0], (len(ground), 1))]),
                                     occluders, camera.heading, extent)
        n = len(panel.points)
        draw_ground(image, ground, tiles, *(smooth_over_edges(v[n:], tiles, 2) for v in (sky, key)), camera, extent)
        lit.append((normals, *(smooth_over_edges(v[:n], panel.triangles, 3) for v in (sky, key))))
    buffers = [draw_model(image, panel, *light_on, camera) for panel, light_on, camera in zip(panels, lit, cameras)]
    for panel, camera, nearest in zip(panels, cameras, buffers):
        draw_cage(image, nearest, panel, camera, width * ss / 1600)
    # Averaged after the gamma curve, which makes edges look smoother than averaging light does.
    image = np.clip(image, 0, 1) ** (1 / 2.2)
    return image.reshape(height, ss, width, ss, 3).mean(axis=(1, 3))


def load(model, cage, posed_model=None, posed_cage=None):
    points, faces, colour = obj.read(model)
    triangles, source = to_triangles(faces)
    colour = to_linear(PLAIN if colour is None else colour[source])
    colour = np.broadcast_to(colour, (len(triangles), 3))
    cage_points, cage_faces, _ = obj.read(cage)
    edges = edges_of(cage_faces)
    panels = [Panel(points, triangles, colour, cage_points, edges)]
    if posed_model:
        panels.append(Panel(obj.read(posed_model)[0], triangles, colour, obj.read(posed_cage)[0], edges))
    return panels


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out")
    parser.add_argument("--model", required=True)
    parser.add_argument("--cage", required=True)
    parser.add_argument("--posed-model")
    parser.add_argument("--posed-cage")
    parser.add_argument("--size", default="1600x900", help="width x height in pixels")
    parser.add_argument("--yaw", type=float, default=24.0)
    parser.add_argument("--pitch", type=float, default=9.0)
    args = parser.parse_args()
    if bool(args.posed_model) != bool(args.posed_cage):
        parser.error("--posed-model and --posed-cage go together")
    width, height = (int(t) for t in args.size.split("x"))
    panels = load(args.model, args.cage, args.posed_model, args.posed_cage)
    matplotlib.image.imsave(args.out, render(panels, width, height, args.yaw, args.pitch))


if __name__ == "__main__":
    main()
