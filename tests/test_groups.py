"""Submaps: groups of splats with poses, drawn by the processor and by OpenGL's renderer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import NDArray

from drawing import Target, camera_at, decibels
from rosplat_core.rendering import (
    ClipBox,
    CpuRenderer,
    DrawMode,
    Rasterizer,
    posed,
)
from rosplat_core.splats import Splats, concatenate
from rosplat_core.view import frame_at
from rosplat_lab import reference
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.batches import pose_values

Array = NDArray[Any]

BLOCK = GaussianArray.SLOTS_PER_BLOCK
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


def random_pose(random: np.random.Generator) -> Pose:
    """Within half a metre, with a quaternion of some length."""
    x, y, z = random.uniform(-0.5, 0.5, 3)
    qx, qy, qz, qw = random.normal(size=4)
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def placed(splats: Splats, at: Pose) -> Splats:
    """The same splats in the map's frame."""
    return splats.moved(frame_at(*pose_values(at)))


@pytest.fixture(params=["processor", "levels", "tiles"])
def target(request: pytest.FixtureRequest) -> Iterator[Target]:
    """The ways on which a map comes into a picture."""
    if request.param in ("processor", "levels"):
        renderer = CpuRenderer(threads=2)
        renderer.settings.detail = "2.5px" if request.param == "levels" else "full"
        yield Target(renderer)
        return
    opengl: Target = request.getfixturevalue("opengl")
    settings = opengl.renderer.settings
    settings.rasterizer = Rasterizer.TILES
    yield opengl
    assert not opengl.renderer.failed(), "OpenGL reported an error"


@dataclass
class Submaps:
    """Some clouds in groups of their own around a place, and the same as one map."""

    about: Array
    splats: dict[int, Splats] = field(default_factory=dict)
    poses: dict[int, Pose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        random = np.random.default_rng(7)
        self.splats = {3: cloud(300, 1), 0: cloud(200, 2), 32767: cloud(300, 3)}
        # Where a pose brings them to, whatever their own origins are.
        self.splats[3] = replace(self.splats[3], origin=np.array([-2e6, 5.0, 1e6]))
        for group, splats in self.splats.items():
            at = random_pose(random)
            beside, _ = pose_values(at)
            at.position = Point()
            turned = placed(splats, at)
            x, y, z = self.about + beside - (turned.origin + turned.positions.mean(axis=0))
            at.position = Point(x=x, y=y, z=z)
            self.poses[group] = at

    def slots(self, group: int) -> Array:
        return list(self.splats).index(group) * BLOCK + np.arange(len(self.splats[group]))

    def show(self, target: Target) -> None:
        target.begin()
        for group, splats in self.splats.items():
            target.write(self.slots(group), splats, group)
        target.move(self.poses)

    def baked(self) -> Splats:
        return concatenate(
            [placed(splats, self.poses[group]) for group, splats in self.splats.items()]
        )


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
        target.begin(baked)
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
        picked = target.renderer.pick(posed(camera))
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
    opengl.move(submaps.poses)
    *first, last = submaps.splats.items()
    for group, splats in first:
        opengl.write(submaps.slots(group), splats, group)
    assert opengl.draw(camera).any()
    settings.rasterizer = after
    opengl.draw(camera)
    group, splats = last  # that was placed, but had no splats
    opengl.write(submaps.slots(group), splats, group)
    picture = opengl.draw(camera)
    submaps.show(opengl)
    np.testing.assert_array_equal(picture, opengl.draw(camera))


@dataclass
class Model:
    """A map of groups in plain Python: what batches have left, and how to load it at once."""

    random: np.random.Generator
    poses: dict[int, Pose] = field(default_factory=dict)
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
            target.move(poses)
        elif kind == "delete" and self.splats:
            slots = self.random.choice(list(self.splats), len(self.splats) // 3, replace=False)
            self._delete(target, slots)
        elif kind == "empty a block":
            block = self.random.integers(4)
            self._delete(target, np.arange(block * BLOCK, (block + 1) * BLOCK))
        else:
            self._write(
                target, GaussianArray.REPLACE if kind == "replace" else GaussianArray.UPSERT
            )

    def _delete(self, target: Target, slots: Array) -> None:
        target.delete(slots)
        for slot in slots:
            self.splats.pop(int(slot), None)

    def _write(self, target: Target, operation: int) -> None:
        block = int(self.random.integers(4))
        if operation == GaussianArray.REPLACE:
            self.poses, self.origins, self.splats = {}, {}, {}
        used = any(slot // BLOCK == block for slot in self.splats)
        group = self.group_of[block] if used else int(self.random.integers(4))
        self.group_of[block] = group
        count = int(self.random.integers(1, 120))
        slots = block * BLOCK + self.random.choice(BLOCK, count, replace=False)
        splats = cloud(count, int(self.random.integers(1 << 30)), int(self.random.integers(4)))
        splats = replace(splats, origin=np.round(self.random.normal(scale=0.2, size=3), 2))
        target.write(slots, splats, group, operation)
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
        target.move(self.poses)
        for block in sorted({slot // BLOCK for slot in self.splats}):
            slots = np.array(sorted(slot for slot in self.splats if slot // BLOCK == block))
            target.write(
                slots, concatenate([self.splats[slot] for slot in slots]), self.group_of[block]
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
