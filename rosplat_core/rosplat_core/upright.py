"""Which way is up in a scene whose file doesn't tell.

Most surfaces of a scene that was built or grown lie level: floors, tables, streets. So along the
vertical the splats gather in a few thin layers, and reach less far than along the ground.

1. Some thousand splats are drawn by the area that they cover: a bare floor of few large splats
   counts like a detailed one.
2. Directions to try are those that flat splats face, normals of planes through three splats
   (RANSAC, Fischler and Bolles 1981), and the axes.
3. The best of them are turned until the layers across them are thinnest.
4. A direction counts as up by how thin its layers are for its extent, how flat the scene lies that
   way, how much is above the lowest large layer, and how near it is to where trainers have up: -y
   (COLMAP, first cameras, which may look down), z (REP-103, nerfstudio), or, where cameras are
   known, to the top of their pictures.
5. What isn't flat has to stand on its lowest points: an animal has no ground, but legs, and a
   statue is thinnest across, but would fall over.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.cameras import Camera
from rosplat_core.quaternions import to_matrices
from rosplat_core.splats import Splats, check_splats

DRAWN = 8000  # splats that vote
TRIED = 300  # directions of flat splats, and as many of planes
REFINED = 5  # directions that are turned to the thinnest layers
FOOT = 0.06  # height of what a scene stands on, in its own
STEADY_FOOT = 0.3  # how far its middle is within the outline of that, for it to stand [radii]
FALLING = 0.1  # what it counts if it would fall over
LAYER = 0.02  # thickness of a layer, in the scene's radii
APART = 0.9  # cosine of two directions that count as one
OPAQUE = 0.2  # least opacity of a splat that votes
FINEST = 0.004  # of turning [rad]

# Directions that trainers have up, and how much each is expected. The second: of a first camera
# that looked down.
CUSTOMS = ((0, -1, 0, 1.0), (0, -0.8, -0.6, 0.8), (0, 0, 1, 0.55), (0, 1, 0, 0.4), (0, 0, -1, 0.3))
UNCUSTOMARY = 0.1  # what a direction counts that is across all of them
NEARLY = 0.94  # cosine of 20 degrees, within which an axis is preferred to
HARDLY_LESS = 0.75  # what is at most so many times as likely
LEVEL = 1 - 1e-9  # cosine from which a vertical is z
WIDEST, NARROWEST = 1.2, 0.4  # slope of rays of a photograph; between 90 % of them
SHELL = 0.2  # least share of a scene's splats that is left out as a shell around it
VOID = 0.1  # most share of a shell that is on the way to it
DOME = 0.7  # most length of the mean of the directions in which it is
NEARBY = 3  # distance within which a scene's extent is measured, in median ones
STEADY = 0.5  # least length of the mean of the cameras' verticals, for it to be believed


def find_up(splats: Splats, cameras: Sequence[Camera] = ()) -> NDArray[np.float64]:
    """The unit vector (3,) that points up in a scene, by its splats and the cameras that took it.

    -y where there is nothing to tell by.
    """
    check_splats(splats)
    customs = np.array(CUSTOMS, np.float64)
    if cameras := cameras or photographed(splats):
        mean = np.mean([-camera.world_to_camera[1, :3] for camera in cameras], axis=0)
        if np.linalg.norm(mean) > STEADY:
            customs = np.array([[*(mean / np.linalg.norm(mean)), 1.0]])
    random = np.random.default_rng(0)
    points, normals, flatness = _voters(splats, random)
    if len(points) < 3:
        return customs[0, :3]
    tried = np.concatenate(
        [
            normals[random.choice(len(points), TRIED, p=flatness / flatness.sum())],
            _planes(points, random),
            np.eye(3),
            customs[:, :3],
        ]
    )
    axes = np.array([*np.eye(3), customs[0, :3]])
    axes = np.concatenate([axes, 0.0 - axes])
    candidates = [*axes]
    thinness = np.array([_thinness(points @ normal) for normal in tried])
    for _ in range(REFINED):
        if not (first := thinness.argmax()) and not thinness[0] > 0:
            break
        thinnest = _thinnest(points, tried[first])
        candidates += [thinnest, -thinnest]
        thinness[np.abs(tried @ tried[first]) > APART] = 0
    likelihood = np.array([_likelihood(points, up, customs) for up in candidates])
    up: NDArray[np.float64] = candidates[likelihood.argmax()]
    near = int(np.argmax(axes @ up))
    # Few or noisy splats have layers in many directions.
    if axes[near] @ up > NEARLY and likelihood[near] > HARDLY_LESS * likelihood.max():
        return np.asarray(axes[near])
    return up


def photographed(splats: Splats) -> list[Camera]:
    """The camera of a scene that is all before its origin, as one made of a photograph; else none.

    Which looks along z, as most do, or along -z.
    """
    points = splats.positions[splats.opacities > OPAQUE].astype(np.float64) + splats.origin
    for sign in (1.0, -1.0):
        before = sign * points[:, 2] > 0
        slopes = np.abs(points[before, :2]) / (sign * points[before, 2:])
        if (slopes < WIDEST).all(axis=1).sum() > 0.99 * max(len(points), 100):
            spread = np.ptp(
                np.quantile(points[before, :2] / points[before, 2:], [0.05, 0.95], 0), 0
            )
            if spread.min() > NARROWEST:
                return [Camera(0, 2, 2, 1.0, 1.0, 1.0, 1.0, np.diag([1, sign, sign, 1]))]
    return []


def standing_pose(splats: Splats, up: ArrayLike) -> NDArray[np.float64]:
    """The pose (4, 4) in which a scene stands upright in a frame whose z points up. [m]

    The scene turns no more than it must, and its ground is at a height of 0. One whose vertical is
    z already stays where it is.
    """
    pose = np.eye(4)
    vertical = np.asarray(up, np.float64) / np.linalg.norm(up)
    if vertical[2] > LEVEL:
        return pose
    axis = np.array([*np.eye(3)[0]]) if vertical[2] < -LEVEL else np.cross(vertical, (0, 0, 1))
    axis /= np.linalg.norm(axis)
    turn = math.acos(min(1, max(-1, float(vertical[2]))))
    pose[:3, :3] = to_matrices([*(axis * math.sin(turn / 2)), math.cos(turn / 2)])
    heights = splats.positions[splats.opacities > OPAQUE].astype(np.float64) @ vertical
    ground = np.quantile(heights, 0.02) if len(heights) else 0.0
    pose[2, 3] = -(ground + splats.origin @ vertical)
    return pose


def shell(
    positions: NDArray[np.float64], sizes: NDArray[np.float64], counted: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Which splats (n,) are a shell around the scene, with nothing between the two.

    counted: some of the splats, evenly chosen. The third of them that is smallest is the scene's.
    """
    told = sizes[counted]
    small = counted[told <= np.quantile(told, 1 / 3)]
    outward = positions - np.median(positions[small], axis=0)
    away = np.linalg.norm(outward, axis=1)
    far = away > NEARBY * np.quantile(away[small], 0.9)
    outside = counted[far[counted]]
    if len(outside) < SHELL * len(counted):
        return np.zeros(len(far), bool)
    between = np.mean(away[outside] < np.median(away[outside]) / 2)
    around = np.linalg.norm(np.mean(outward[outside] / away[outside, None], axis=0))
    return np.asarray(far & bool(between < VOID and around < DOME))


def _voters(
    splats: Splats, random: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Positions (n, 3) [radii] from the middle, ways that splats face (n, 3), flatness (n,)."""
    rows = np.flatnonzero(splats.opacities > OPAQUE)
    rows = random.permutation(rows)[: 25 * DRAWN] if len(rows) > 25 * DRAWN else rows
    if not len(rows):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    positions = splats.positions[rows].astype(np.float64)
    outside = shell(positions, splats.scales[rows].max(axis=1), np.arange(len(rows)))
    rows, positions = rows[~outside], positions[~outside]
    low, high = np.quantile(positions, [0.05, 0.95], axis=0)
    radius = max(float(np.linalg.norm(high - low)) / 2, 1e-30)
    positions = (positions - (low + high) / 2) / radius
    near = np.linalg.norm(positions, axis=1) < 1.3
    rows, positions = rows[near], positions[near]
    scales = np.sort(splats.scales[rows].astype(np.float64), axis=1)
    areas = splats.opacities[rows] * scales[:, 1] * scales[:, 2]
    areas = np.minimum(areas, np.quantile(areas, 0.95)) if len(areas) else areas
    if not areas.sum() > 0:
        return positions[:0], positions[:0], np.zeros(0)
    drawn = random.choice(len(rows), min(len(rows), DRAWN), p=areas / areas.sum())
    rows = rows[drawn]
    axes = to_matrices(splats.orientations[rows])
    shortest = splats.scales[rows].argmin(axis=1)
    flatness = 1 - scales[drawn, 0] / np.maximum(scales[drawn, 1], 1e-30)
    return positions[drawn], axes[np.arange(len(rows)), :, shortest], flatness + 1e-3


def _planes(points: NDArray[np.float64], random: np.random.Generator) -> NDArray[np.float64]:
    """Unit normals (k, 3) of planes through three of the points each."""
    a, b, c = points[random.choice(len(points), (3, TRIED))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray((normals / np.maximum(lengths, 1e-30))[lengths[:, 0] > 1e-9])


def _layers(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares of the points in layers across a direction. heights (n,): in radii."""
    counts = np.bincount(((heights + 2.6) / LAYER).astype(np.intp).clip(0, 259), minlength=260)
    return counts / len(heights)


def _thinness(heights: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(_layers(heights)))


def _thinnest(points: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """The direction near a normal across which layers are thinnest."""
    best, step = _thinness(points @ normal), 0.06
    while step > FINEST:
        angles = np.arange(6)[:, None] * np.pi / 3
        turned = normal + step * np.hstack([np.cos(angles), np.sin(angles)]) @ level(normal)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        found = [_thinness(points @ direction) for direction in turned]
        if max(found) > best:
            best, normal = max(found), turned[int(np.argmax(found))]
        else:
            step /= 2
    return normal


def level(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two level directions (2, 3), at right angles."""
    aside = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    aside /= np.linalg.norm(aside)
    return np.array([aside, np.cross(up, aside)])


def _stands(points: NDArray[np.float64], up: NDArray[np.float64]) -> float:
    """0 to 1: how far the points' middle is within the outline of the lowest ones."""
    from scipy.spatial import ConvexHull, QhullError  # takes its time

    heights = points @ up
    low, high = np.quantile(heights, [0.005, 0.98])
    flat = points @ level(up).T
    flat -= flat.mean(axis=0)
    foot = flat[heights < low + FOOT * (high - low)]
    try:
        within = -float(ConvexHull(foot).equations[:, 2].max())
    except (QhullError, ValueError):  # a line, or a point
        within = 0.0
    return float(np.clip(within / STEADY_FOOT, 0, 1))


def _likelihood(
    points: NDArray[np.float64], up: NDArray[np.float64], customs: NDArray[np.float64]
) -> float:
    """How likely a direction is up."""
    heights = points @ up
    low, high = np.quantile(heights, [0.02, 0.98])
    height = max(float(high - low), LAYER)
    layers = _layers(heights)
    ground = np.argmax(layers > 0.5 * layers.max()) * LAYER - 2.6 + LAYER / 2
    above = float(np.mean(heights > ground + 1.5 * LAYER))
    below = float(np.mean(heights < ground - 1.5 * LAYER))
    one_sided = 0.1 + (above + 0.01) / (above + below + 0.02)
    custom = UNCUSTOMARY + max(0.0, *(customs[:, 3] * (customs[:, :3] @ up).clip(0, 1) ** 4))
    spread = np.cov(points.T)
    across = level(up)
    narrow = float(np.linalg.eigvalsh(across @ spread @ across.T)[0])
    flat = max(1.0, narrow / max(float(up @ spread @ up), LAYER**2 / 12))
    stands = max(min(1.0, FALLING * flat), _stands(points, up))  # what is flat doesn't fall over
    return float(np.sum(layers**2) * height * math.sqrt(flat) * one_sided * custom * stands)
