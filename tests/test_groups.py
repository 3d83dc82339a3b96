"""Submaps: groups of splats with poses, drawn by the processor and by OpenGL's renderer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_lab import reference
from rosplat_lab.bench.embedded import View, pose
from rosplat_lab.reference.projection import rotation_matrices
from rosplat_msgs.msg import GaussianArray
from rosplat_tools import harmonics
from rosplat_tools.cameras import Camera, look_at
from rosplat_tools.splats import Splats
from rviz_gaussian_plugin import offscreen
from rviz_gaussian_plugin.offscreen import (
    ClipBox,
    CpuRenderer,
    DrawMode,
    OrderSource,
    Rasterizer,
    Renderer,
)

Array = NDArray[Any]

BLOCK = GaussianArray.SLOTS_PER_BLOCK
REPLACE, UPSERT, DELETE, MOVE = (
    GaussianArray.REPLACE,
    GaussianArray.UPSERT,
    GaussianArray.DELETE,
    GaussianArray.MOVE,
)
IDENTITY = np.array([0, 0, 0, 0, 0, 0, 1.0])
NO_FLOATS = np.zeros(0, np.float32)
FAR = np.array([4.5e6, -3.2e6, 12.5])  # [m]


def cloud(count: int, seed: int, degree: int = 3) -> Splats:
    """Anisotropic splats around zero whose colours depend on the direction."""
    random = np.random.default_rng(seed)
    coefficients = (degree + 1) ** 2
    return Splats(
        positions=random.normal(scale=0.35, size=(count, 3)).astype(np.float32),
        orientations=random.normal(size=(count, 4)).astype(np.float32),
        scales=(0.15 * random.uniform(0.05, 1, size=(count, 3)) ** 2).astype(np.float32),
        opacities=random.uniform(0, 1, count).astype(np.float32),
        sh=random.normal(scale=0.3, size=(count, coefficients, 3)).astype(np.float32),
    )


def random_pose(random: np.random.Generator, reach: float = 0.5) -> Array:
    """x y z [m], quaternion x y z w of some length."""
    return np.concatenate([random.uniform(-reach, reach, 3), random.normal(size=4)])


def camera_at(eye: tuple[float, float, float], about: Array | None = None) -> Camera:
    """A camera that looks at a place from an eye beside it. [m]"""
    target = np.zeros(3) if about is None else about
    return Camera(
        id=0, width=190, height=130, fx=170.0, fy=170.0, cx=95.0, cy=65.0,
        world_to_camera=look_at(target + eye, target),
    )  # fmt: skip


@dataclass
class Target:
    """Something that draws a map, and its batches."""

    renderer: Any
    view: View | None = None
    map_id: int = 0
    revision: int = 0

    def apply(
        self,
        operation: int,
        slots: Array | None = None,
        splats: Splats | None = None,
        group: int = 0,
        poses: dict[int, Array] | None = None,
    ) -> None:
        self.revision += 1
        slots = np.zeros(0, np.uint32) if slots is None else np.asarray(slots, np.uint32)
        floats = [NO_FLOATS] * 5
        if splats is not None:
            arrays = (splats.positions, splats.orientations, splats.scales, splats.opacities)
            floats = [values.ravel() for values in (*arrays, splats.sh)]
        poses = poses or {}
        self.renderer.apply(
            operation, 0, len(slots), slots, splats.sh_degree if splats else 0,
            False, tuple(splats.origin) if splats else (0.0, 0.0, 0.0), *floats,
            str(self.map_id), self.revision, group=group,
            groups=np.array(list(poses), np.uint32),
            poses=np.array(list(poses.values()), np.float64),
        )  # fmt: skip

    def begin(self) -> None:
        """A new map, empty."""
        self.map_id += 1
        self.revision = 0
        self.apply(REPLACE)

    def draw(self, camera: Camera) -> Array:
        if self.view is None:
            drawn: Array = self.renderer.draw(offscreen.Camera(*pose(camera)))["colour"]
            return drawn
        self.view.look(camera)
        self.view.draw(sort_now=True)
        picture: Array = self.renderer.read_color()
        return picture


@pytest.fixture(scope="module")
def opengl(display: str) -> Iterator[Target]:
    renderer = Renderer()
    target = Target(renderer, View(renderer))
    yield target
    del target.renderer, target.view  # before the display


@pytest.fixture(params=["processor", "levels", "tiles", "quads", "built-in order"])
def target(request: pytest.FixtureRequest) -> Iterator[Target]:
    """The ways on which a map comes into a picture."""
    if request.param in ("processor", "levels"):
        renderer = CpuRenderer(threads=2)
        renderer.settings.detail = "2.5px" if request.param == "levels" else "full"
        yield Target(renderer)
        return
    opengl: Target = request.getfixturevalue("opengl")
    settings = opengl.renderer.settings
    settings.float_blending = True
    settings.rasterizer = Rasterizer.TILES if request.param == "tiles" else Rasterizer.QUADS
    settings.order = OrderSource.BUILT_IN if request.param == "built-in order" else OrderSource.AUTO
    yield opengl
    settings.order = OrderSource.AUTO
    assert not opengl.renderer.failed(), "OpenGL reported an error"


def placed(splats: Splats, place: Array) -> Splats:
    """The same splats in the map's frame, in float64: their harmonics turned with them."""
    x, y, z, w = place[3:] / np.linalg.norm(place[3:])
    rotation = rotation_matrices(np.array([[x, y, z, w]]))[0]
    bx, by, bz, bw = splats.orientations.astype(np.float64).T
    turned = np.stack(
        [
            w * bx + x * bw + y * bz - z * by,
            w * by - x * bz + y * bw + z * bx,
            w * bz + x * by - y * bx + z * bw,
            w * bw - x * bx - y * by - z * bz,
        ],
        axis=1,
    )
    # f'(d) = f(R^T d), for as many directions as determine it.
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    degree = splats.sh_degree
    turn = np.linalg.pinv(harmonics.basis(directions, degree)) @ harmonics.basis(
        directions @ rotation, degree
    )
    positions = (splats.positions.astype(np.float64) + splats.origin) @ rotation.T + place[:3]
    origin = np.round(positions.mean(axis=0))
    return Splats(
        positions=(positions - origin).astype(np.float32),
        orientations=turned.astype(np.float32),
        scales=splats.scales,
        opacities=splats.opacities,
        sh=np.einsum("kj,njc->nkc", turn, splats.sh).astype(np.float32),
        origin=origin,
    )


def decibels(picture: Array, expected: Array) -> float:
    """PSNR of what a screen could show, peak 1."""
    error = np.clip(picture, 0, 1).astype(np.float64) - np.clip(expected, 0, 1)
    return float(-10 * np.log10(np.mean(error**2) + 1e-300))


def joined(parts: list[Splats]) -> Splats:
    """All splats, relative to the first origin."""
    origin = parts[0].origin
    moved = [part.positions + (part.origin - origin).astype(np.float32) for part in parts]
    return replace(
        parts[0],
        positions=np.concatenate(moved),
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("orientations", "scales", "opacities", "sh")
        },
    )


@dataclass
class Submaps:
    """Some clouds in groups of their own around a place, and the same as one map."""

    about: Array
    splats: dict[int, Splats] = field(default_factory=dict)
    poses: dict[int, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        random = np.random.default_rng(7)
        self.splats = {3: cloud(300, 1), 0: cloud(200, 2), 32767: cloud(300, 3)}
        # Where a pose brings them to, whatever their own origins are.
        self.splats[3] = replace(self.splats[3], origin=np.array([-2e6, 5.0, 1e6]))
        for group, splats in self.splats.items():
            turn = random_pose(random)
            rotated = placed(splats, np.concatenate([np.zeros(3), turn[3:]]))
            turn[:3] += self.about - (rotated.origin + rotated.positions.mean(axis=0))
            self.poses[group] = turn

    def slots(self, group: int) -> Array:
        return list(self.splats).index(group) * BLOCK + np.arange(len(self.splats[group]))

    def show(self, target: Target) -> None:
        target.begin()
        for group, splats in self.splats.items():
            target.apply(UPSERT, self.slots(group), splats, group)
        target.apply(MOVE, poses=self.poses)

    def baked(self) -> Splats:
        return joined([placed(splats, self.poses[group]) for group, splats in self.splats.items()])


@pytest.mark.parametrize("about", [np.zeros(3), FAR], ids=["near", "4,500 km away"])
def test_groups_with_poses_are_the_same_map_baked(target: Target, about: Array) -> None:
    submaps = Submaps(about)
    submaps.show(target)
    camera = camera_at((1.5, 1.0, 0.8), about)
    if isinstance(target.renderer, CpuRenderer):
        target.renderer.settings.detail = "full"
    expected = reference.render(submaps.baked(), camera).rgba
    assert decibels(target.draw(camera), expected) >= 70
    assert expected[..., 3].mean() > 0.2  # there was something to see


@pytest.mark.parametrize("mode", [DrawMode.COLOR, DrawMode.NORMALS, DrawMode.DEPTH])
def test_clip_box_and_normals_are_in_the_map_s_frame(target: Target, mode: DrawMode) -> None:
    submaps = Submaps(np.array([100.0, -20.0, 3.0]))
    camera = camera_at((1.5, 1.0, 0.8), submaps.about)
    settings = target.renderer.settings
    box = ClipBox()
    box.enabled = True
    box.centre, box.size = tuple(np.add(submaps.about, (0.1, 0, 0.05))), (0.5, 0.7, 0.9)
    settings.clip_box, settings.mode, settings.depth_range = box, mode, (1.0, 3.0)
    try:
        submaps.show(target)
        picture = target.draw(camera)
        baked = submaps.baked()
        target.begin()
        target.apply(UPSERT, np.arange(len(baked)), baked)
        assert decibels(picture, target.draw(camera)) >= 60
        assert 0.05 < (picture[..., 3] > 0).mean() < 0.5
    finally:
        settings.clip_box, settings.mode = ClipBox(), DrawMode.COLOR


def test_picks_and_values_of_slots_are_in_the_map_s_frame(target: Target) -> None:
    submaps = Submaps(FAR)
    submaps.show(target)
    baked = submaps.baked()
    slots = np.concatenate([submaps.slots(group) for group in submaps.splats])
    camera = camera_at((1.5, 1.0, 0.8), FAR)
    expected, most = reference.pick(baked, camera)
    if isinstance(target.renderer, CpuRenderer):
        target.renderer.settings.detail = "full"
        picked = target.renderer.pick(offscreen.Camera(*pose(camera)))
    else:
        target.draw(camera)
        picked = target.renderer.pick(target.view.name, 0, 0, camera.width, camera.height)
        for number in range(0, len(slots), 97):
            (values,) = target.renderer.read_slots([int(slots[number])])
            position = baked.positions[number] + baked.origin
            np.testing.assert_allclose(values["position"], position, rtol=0, atol=1e-5)
            turned = baked.orientations[number].astype(np.float64)
            cosine = np.dot(turned, values["orientation"]) / np.linalg.norm(turned)
            assert abs(cosine) == pytest.approx(1, abs=1e-6)
            assert values["group"] == list(submaps.splats)[slots[number] // BLOCK]
    clear = most > 0.06
    wrong = picked.astype(np.int64)[clear] != slots[expected[clear]]
    assert clear.mean() > 0.2
    assert wrong.mean() < 2e-3  # of next to equal contributions


@pytest.mark.parametrize(
    ("before", "after"),
    [(Rasterizer.PROCESSOR, Rasterizer.TILES), (Rasterizer.TILES, Rasterizer.PROCESSOR)],
    ids=["to the graphics card", "to the processor"],
)
def test_poses_go_along_when_another_rasteriser_takes_over(
    opengl: Target, before: Rasterizer, after: Rasterizer
) -> None:
    submaps = Submaps(np.zeros(3))
    camera = camera_at((1.5, 1.0, 0.8))
    settings = opengl.renderer.settings
    settings.rasterizer = before
    opengl.begin()
    opengl.apply(MOVE, poses=submaps.poses)
    *first, last = submaps.splats.items()
    for group, splats in first:
        opengl.apply(UPSERT, submaps.slots(group), splats, group)
    assert opengl.draw(camera).any()
    settings.rasterizer = after
    opengl.draw(camera)
    group, splats = last  # that was placed, but had no splats
    opengl.apply(UPSERT, submaps.slots(group), splats, group)
    picture = opengl.draw(camera)
    submaps.show(opengl)
    np.testing.assert_array_equal(picture, opengl.draw(camera))


@dataclass
class Model:
    """A map of groups in plain Python: what batches have left, and how to load it at once."""

    random: np.random.Generator
    poses: dict[int, Array] = field(default_factory=dict)
    origins: dict[int, Array] = field(default_factory=dict)
    group_of: dict[int, int] = field(default_factory=dict)  # by block
    splats: dict[int, Splats] = field(default_factory=dict)  # by slot, one each

    def edit(self, target: Target) -> None:
        """A random batch, to the target and to this."""
        kind = self.random.choice(["write"] * 5 + ["move"] * 3 + ["delete"] * 2 + ["empty a block"])
        if self.random.random() < 0.04:
            kind = "replace"
        if kind == "move":
            groups = self.random.permutation(4)[: self.random.integers(1, 5)]
            poses = {int(group): random_pose(self.random) for group in groups}
            self.poses.update(poses)
            target.apply(MOVE, poses=poses)
        elif kind == "delete" and self.splats:
            slots = self.random.choice(list(self.splats), len(self.splats) // 3, replace=False)
            self._delete(target, slots)
        elif kind == "empty a block":
            block = self.random.integers(4)
            self._delete(target, np.arange(block * BLOCK, (block + 1) * BLOCK))
        else:
            self._write(target, REPLACE if kind == "replace" else UPSERT)

    def _delete(self, target: Target, slots: Array) -> None:
        target.apply(DELETE, slots)
        for slot in slots:
            self.splats.pop(int(slot), None)

    def _write(self, target: Target, operation: int) -> None:
        block = int(self.random.integers(4))
        if operation == REPLACE:
            self.poses, self.origins, self.splats = {}, {}, {}
        used = any(slot // BLOCK == block for slot in self.splats)
        group = self.group_of[block] if used else int(self.random.integers(4))
        self.group_of[block] = group
        count = int(self.random.integers(1, 120))
        slots = block * BLOCK + self.random.choice(BLOCK, count, replace=False)
        splats = cloud(count, int(self.random.integers(1 << 30)), int(self.random.integers(4)))
        splats = replace(splats, origin=np.round(self.random.normal(scale=0.2, size=3), 2))
        target.apply(operation, slots, splats, group)
        origin = self.origins.setdefault(group, splats.origin)
        rebased = splats.positions.astype(np.float64) + splats.origin - origin
        if (splats.origin != origin).any():
            splats = replace(splats, positions=rebased.astype(np.float32))
        splats = replace(splats, origin=origin)
        for number, slot in enumerate(slots):
            self.splats[int(slot)] = splats[number : number + 1]

    def load(self, target: Target) -> None:
        """The same as a new map."""
        target.begin()
        target.apply(MOVE, poses=self.poses)
        degree = max((one.sh_degree for one in self.splats.values()), default=0)
        for slot in sorted(self.splats):
            one = self.splats[slot]
            sh = np.zeros((1, (degree + 1) ** 2, 3), np.float32)
            sh[:, : one.sh.shape[1]] = one.sh
            target.apply(
                UPSERT, np.array([slot]), replace(one, sh=sh), self.group_of[slot // BLOCK]
            )


@pytest.mark.parametrize("seed", range(4))
def test_after_any_edits_the_picture_is_that_of_the_map_loaded_afresh(
    target: Target, seed: int
) -> None:
    model = Model(np.random.default_rng(seed))
    camera = camera_at((1.4, -1.0, 0.6))
    target.begin()
    shown = 0
    for _ in range(4):
        for _ in range(15):
            model.edit(target)
            if model.random.random() < 0.3:
                target.draw(camera)
        edited = target.draw(camera)
        model.load(target)  # and goes on from there
        np.testing.assert_array_equal(edited, target.draw(camera))
        shown += bool(edited.any())
    assert shown >= 3
