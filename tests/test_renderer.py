"""The OpenGL renderer, through Ogre, against its float64 twin and against itself."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import drawing
from drawing import decibels
from rosplat_core import ordering
from rosplat_core.cameras import Camera, look_at
from rosplat_core.maps import BatchError, batch_of
from rosplat_core.models import Model
from rosplat_core.rendering import (
    ClipBox,
    DrawMode,
    OrderSource,
    Rasterizer,
    RenderSettings,
    insert,
    insert_all,
    pose,
)
from rosplat_core.splats import Splats
from rosplat_lab import reference
from rosplat_lab.reference.projection import Projected, project
from rosplat_lab.reference.renderer import blended
from rosplat_sorter.order_slots import PACKED, SHARED, OrderError, pack
from rosplat_sorter.shared_orders import FOLDER, OrderBuffer, SharedOrders
from rosplat_testing import PATIENCE
from rviz_gaussian_plugin.offscreen import Renderer

WIDTH, HEIGHT = 160, 120
TOLD: list[str] = []  # of orders, by the one renderer of this process


class Host:
    """One renderer with shorthands; map ids and sequences count by themselves."""

    def __init__(self) -> None:
        self.renderer = Renderer()
        self.map = 0
        self.revision = 0
        self.sequence = 0

    def apply(self, operation: int, splats: Splats, first: int = 0, **overrides: Any) -> dict:
        self.revision += 1
        fields = {
            "operation": operation,
            "first_slot": first,
            "map_id": str(self.map),
            "revision": self.revision,
        }
        return self.renderer.apply(batch_of(splats, **fields | overrides))

    def set(self, **settings: Any) -> None:
        for name, value in settings.items():
            setattr(self.renderer.settings, name, value)

    def show(self, splats: Splats) -> None:
        """A new map."""
        self.map += 1
        self.revision = 0
        self.apply(0, splats)

    def delete(self, first: int, count: int) -> None:
        self.revision += 1
        self.renderer.apply(
            SimpleNamespace(
                operation=2, first_slot=first, count=count, map_id=str(self.map),
                revision=self.revision,
            )
        )  # fmt: skip

    def look(self, camera: Camera) -> None:
        self.sequence += 1
        self.renderer.set_camera("test", self.sequence, *pose(camera))

    def draw(self, camera: Camera) -> np.ndarray:
        self.look(camera)
        self.renderer.draw("test", sort_now=True)
        return self.renderer.read_color()


@pytest.fixture(scope="module")
def host(display: str) -> Iterator[Host]:
    host = Host()
    yield host
    del host.renderer


@pytest.fixture(autouse=True, params=["tiles", "processor"])
def default_settings(host: Host, request: pytest.FixtureRequest) -> Iterator[None]:
    """Everything holds on the card and on the processor."""
    host.renderer.settings = RenderSettings()
    processor = request.param == "processor"
    host.set(rasterizer=Rasterizer.PROCESSOR if processor else Rasterizer.TILES)
    yield
    assert not host.renderer.failed(), "OpenGL reported an error"
    assert host.renderer.warning == ""  # such as a sort that the driver gets wrong


def cloud(count: int, degree: int = 3, seed: int = 0, size: float = 0.15) -> Splats:
    """Anisotropic splats of all opacities in a ball of 1 m, with view-dependent colours."""
    random = np.random.default_rng(seed)
    orientations = random.normal(size=(count, 4))
    return Splats(
        positions=random.normal(scale=0.4, size=(count, 3)).astype(np.float32),
        orientations=(orientations / np.linalg.norm(orientations, axis=1, keepdims=True)).astype(
            np.float32
        ),
        scales=(size * random.uniform(0.02, 1, size=(count, 3))).astype(np.float32),
        opacities=random.uniform(size=count).astype(np.float32),
        sh=random.normal(scale=0.4, size=(count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def camera_at(eye: tuple[float, float, float], **overrides: Any) -> Camera:
    """A camera that looks at the origin."""
    fields = {
        "width": WIDTH, "height": HEIGHT, "fx": 150.0, "fy": 150.0,
        "cx": WIDTH / 2, "cy": HEIGHT / 2,
    }  # fmt: skip
    return drawing.camera_at(eye, **(fields | overrides))


CAMERAS = {name: camera_at(**view) for name, view in drawing.VIEWS.items()}


@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("degree", range(4))
def test_matches_the_float64_renderer(host: Host, view: str, degree: int) -> None:
    """70 dB is a mean error of a twelfth of an 8-bit grey level."""
    splats = cloud(400, degree)
    expected = reference.render(splats, CAMERAS[view]).rgba
    host.show(splats)
    picture = host.draw(CAMERAS[view])
    assert decibels(picture, expected) >= 70
    assert expected.max() > 0.5  # there was something to see


def test_needles_and_giants_in_a_wide_picture(host: Host) -> None:
    """Diagonals touch few of the tiles around them; a giant's tiles don't fit in a word."""
    splats = cloud(60, degree=0)
    splats.scales[:40] = [1.0, 0.002, 0.002]
    splats.scales[40:] = 3.0
    splats = replace(splats, opacities=splats.opacities * np.float32(0.3))
    camera = camera_at(
        (2.0, 1.0, 0.7), width=1100, height=150, cx=550.0, cy=75.0, fx=500.0, fy=500.0
    )
    expected = reference.render(splats, camera).rgba
    host.show(splats)
    assert decibels(host.draw(camera), expected) >= 70


def test_half_floats_stay_below_a_grey_level(host: Host) -> None:
    splats = cloud(400)
    expected = reference.render(splats, CAMERAS["outside"]).rgba
    host.show(splats)
    picture = host.draw(CAMERAS["outside"])
    assert decibels(picture, expected) >= 55
    assert np.abs(picture - expected).max() < 4 / 255


def test_antialiased_models_keep_their_opacity_compensation(host: Host) -> None:
    splats = replace(cloud(2000, size=0.01), model=Model.EWA_ANTIALIASED)
    expected = reference.render(splats, CAMERAS["outside"]).rgba
    host.show(splats)
    assert decibels(host.draw(CAMERAS["outside"]), expected) >= 70
    plain = reference.render(replace(splats, model=Model.EWA), CAMERAS["outside"]).rgba
    assert decibels(plain, expected) < 40


def tangent_focal(degrees: float) -> float:
    """The focal length at which a picture is so many degrees wide. [px]"""
    return WIDTH / 2 / float(np.tan(np.radians(degrees / 2)))


def hard(name: str) -> tuple[Splats, Camera]:
    """Splats and a camera that are hard to draw along rays."""
    splats = cloud(200, degree=0)
    if name == "140 degrees":
        return splats, camera_at((0.6, 0.3, 0.2), fx=tangent_focal(140), fy=tangent_focal(140))
    if name == "needles":
        splats.scales[:] = [1.0, 0.03, 0.03]  # packed rotations move thinner ones
        return splats, CAMERAS["outside"]
    faint = replace(splats, opacities=splats.opacities * np.float32(0.2))
    if name == "within giants":  # and their centres beside the camera, some all but behind it
        faint.scales[:] *= 400
        faint.positions[:] *= 20
        return faint, CAMERAS["inside"]
    splats.orientations[:] = [0, 0, 0, 1]
    splats.positions[:] *= [4, 4, 0]
    splats.scales[:] *= [3, 3, 0.01]
    height = {"grazed": 0.05, "on edge": 1e-4}[name]
    return splats, camera_at((3.0, 0.0, height), target=(0, 0, height))


HARD = ("140 degrees", "needles", "within giants", "grazed", "on edge")


@pytest.mark.parametrize("case", [*CAMERAS, *HARD])
@pytest.mark.parametrize("model", [Model.RAY, Model.DISC], ids=str)
def test_rays_and_discs_match_the_float64_renderer(host: Host, model: Model, case: str) -> None:
    splats, camera = hard(case) if case in HARD else (cloud(400), CAMERAS[case])
    splats = replace(splats, model=model)
    expected = reference.render(splats, camera)
    host.show(splats)
    picture, depth = host.draw(camera), host.renderer.read_depth()
    assert np.isfinite(picture).all()
    assert decibels(picture, expected.rgba) >= 70
    solid = expected.rgba[..., 3] > 0.4
    assert solid.any()  # there was something to see
    error = np.abs(depth / expected.depth - 1)[solid]
    assert np.median(error) < 1e-3


def test_a_disc_on_edge_is_no_nan(host: Host) -> None:
    """The camera is in the discs' plane, of which float32 knows nothing there."""
    splats, _ = hard("on edge")
    host.show(replace(splats, model=Model.DISC))
    assert np.isfinite(host.draw(camera_at((3.0, 0.0, 0.0)))).all()


def test_far_from_the_origin_nothing_is_lost(host: Host) -> None:
    offset = np.array([4.5e6, -1.2e6, 3.3e5])
    splats = cloud(300)
    near = CAMERAS["outside"]
    shifted = near.world_to_camera.copy()
    shifted[:3, 3] -= shifted[:3, :3] @ offset
    host.show(splats)
    expected = host.draw(near)
    host.show(replace(splats, origin=offset))
    far = host.draw(replace(near, world_to_camera=shifted))
    assert decibels(far, expected) >= 70


def test_beyond_the_depth_buffer_there_is_a_sky(host: Host) -> None:
    """A huge splat far behind the far plane of the opaque scene."""
    sky = one(positions=[[-1e6, 0, 0]], scales=[[1e6] * 3], opacities=[0.9], sh=[[[1, 1, 1]]])
    host.show(sky)
    camera = CAMERAS["outside"]
    picture = host.draw(camera)
    assert picture[..., 3].min() > 0.2
    assert decibels(picture, reference.render(sky, camera).rgba) >= 70


def test_edits_lead_to_the_same_map_as_a_replace(host: Host) -> None:
    splats = cloud(70000, degree=1, size=0.02)  # more than a page of slots
    host.show(splats)
    expected = host.draw(CAMERAS["outside"])
    host.show(splats[:1000])
    for first in range(1000, len(splats), 23000):
        host.apply(1, splats[first : first + 23000], first)
    host.apply(1, cloud(500, degree=1, seed=9), 65400)  # across a page border, then back
    assert np.abs(host.draw(CAMERAS["outside"]) - expected).max() > 0.01
    host.delete(65400, 500)
    host.apply(1, splats[65400:65900], 65400)
    np.testing.assert_array_equal(host.draw(CAMERAS["outside"]), expected)


def test_a_higher_degree_joins_a_plain_map(host: Host) -> None:
    plain, shiny = cloud(200, degree=0), cloud(200, degree=3, seed=5)
    host.show(plain)
    host.apply(1, shiny, first=200)
    padded = np.zeros((200, 16, 3), np.float32)
    padded[:, :1] = plain.sh
    both = Splats(
        **{
            name: np.concatenate([getattr(plain, name), getattr(shiny, name)])
            for name in ("positions", "orientations", "scales", "opacities")
        },
        sh=np.concatenate([padded, shiny.sh]),
    )
    picture = host.draw(CAMERAS["outside"])
    host.show(both)
    np.testing.assert_array_equal(picture, host.draw(CAMERAS["outside"]))


def test_zero_bands_cost_no_memory(host: Host) -> None:
    host.show(cloud(1000, degree=0))
    host.draw(CAMERAS["outside"])
    plain = host.renderer.draw("test")["map_bytes"]
    assert plain >= 1024 * 36
    host.show(cloud(1000, degree=3))
    host.draw(CAMERAS["outside"])
    assert host.renderer.draw("test")["map_bytes"] == plain + 1024 * 60


def test_the_order_given_is_the_order_drawn(host: Host) -> None:
    splats = cloud(300)
    host.show(splats)
    host.set(order=OrderSource.SIDECAR)
    host.look(CAMERAS["outside"])
    slots = np.random.default_rng(3).permutation(300)[:200].astype(np.uint32)
    host.renderer.set_order("test", host.sequence, str(host.map), 1, "mine", 0.001, slots)
    host.renderer.upload(all=True)
    assert host.renderer.has_order("test")
    report = host.renderer.draw("test")
    expected = reference.render(splats, CAMERAS["outside"], order=slots).rgba
    assert report["order_source"] == "mine"
    assert report["splats"] == 200
    assert decibels(host.renderer.read_color(), expected) >= 70


def test_orders_that_travelled_are_drawn_like_those_given(host: Host) -> None:
    """Bit by bit and through shared memory, in turn through the same few buffers."""
    host.show(cloud(300))
    host.set(order=OrderSource.SIDECAR)
    orders = SharedOrders()
    buffer = OrderBuffer(orders)
    random = np.random.default_rng(3)

    def offer(**fields: Any) -> str:
        return host.renderer.read_order(
            "test", host.sequence, str(host.map), 1, "mine", 0.001,
            **{"packed": b"", "count": 0, "slot_bits": 0, "segment": "", "generation": 0} | fields,
        )  # fmt: skip

    def drawn() -> np.ndarray:
        host.renderer.upload(all=True)
        assert host.renderer.has_order("test")
        host.renderer.draw("test")
        return host.renderer.read_color()

    try:
        for count in (200, 300, 17, 250, 0):
            slots = random.permutation(300)[:count].astype(np.uint32)
            host.look(CAMERAS["outside"])
            host.renderer.set_order("test", host.sequence, str(host.map), 1, "mine", 0.0, slots)
            expected = drawn()
            offer(encoding=PACKED, packed=pack(slots, 9), count=count, slot_bits=9)
            np.testing.assert_array_equal(drawn(), expected)
            buffer.begin(count)[:] = slots
            segment, generation = buffer.finish()
            offer(encoding=SHARED, count=count, segment=segment, generation=generation)
            np.testing.assert_array_equal(drawn(), expected)
            assert host.renderer.segment_key == orders.key
        with (FOLDER / segment).open("r+b") as file:
            file.seek(8)
            file.write(struct.pack("=I", 2))  # of a sorter of another version
        packed = {"encoding": PACKED, "packed": pack(slots, 9), "count": count, "slot_bits": 9}
        TOLD.extend(offer(**packed, segment=segment) for _ in range(2))
        assert "".join(TOLD).count("is of version 2") == 1  # whatever else the process draws
        assert host.renderer.segment_key == 0
    finally:
        orders.close()
    with pytest.raises(OrderError):
        offer(encoding=SHARED, count=1, segment=segment, generation=generation)
    assert host.renderer.segment_key == 0
    host.look(CAMERAS["inside"])
    offer(encoding=PACKED, packed=pack(np.array([300], np.uint32), 9), count=1, slot_bits=9)
    host.renderer.upload(all=True)
    assert not host.renderer.has_order("test")  # no such slot


@pytest.mark.parametrize("view", CAMERAS)
def test_depth_is_the_mean_of_planes_along_the_axis(host: Host, view: str) -> None:
    splats = cloud(400)
    expected = reference.render(splats, CAMERAS[view])
    host.show(splats)
    picture = host.draw(CAMERAS[view])
    depth = host.renderer.read_depth()
    np.testing.assert_array_equal(host.draw(CAMERAS[view]), picture)  # as without depths
    solid = expected.rgba[..., 3] > 0.1
    error = np.abs(depth[solid] / expected.depth[solid] - 1)
    assert np.mean(error < 1e-3) > 0.998  # the rest: where a splat ends a pixel earlier or later
    assert error.max() < 0.02
    assert np.isfinite(depth[expected.rgba[..., 3] == 0]).sum() < 5


def test_opaque_objects_hide_and_are_hidden(host: Host) -> None:
    """A white box between two splats: the far one is gone, the near one covers the box."""
    camera = camera_at((3.0, 0.0, 0.0))
    red, blue = [1.7, -1.7, -1.7], [-1.7, -1.7, 1.7]
    two = Splats(
        positions=np.array([[1, 0.3, 0], [-1, -0.3, 0]], np.float32),
        orientations=np.array([[0, 0, 0, 1]] * 2, np.float32),
        scales=np.full((2, 3), 0.1, np.float32),
        opacities=np.ones(2, np.float32),
        sh=np.array([[red], [blue]], np.float32),
    )
    host.show(two)
    try:
        host.renderer.set_box((0, 0, 0), (0.2, 2, 2))
        host.draw(camera)
        picture = host.renderer.read_color8((0, 0, 0))
    finally:
        host.renderer.set_box((0, 0, -1e6), (1, 1, 1))
    ahead, behind = picture[60, 80 + 22], picture[60, 80 - 11]
    assert ahead[0] > 200 and ahead[2] < 60
    np.testing.assert_array_equal(behind, 255)


@pytest.mark.parametrize("orthographic", [False, True])
def test_translucent_objects_are_between_splats(host: Host, orthographic: bool) -> None:
    """A white veil, half opaque, before, between and behind splats of many opacities."""
    focal_length = 50.0 if orthographic else 150.0
    camera = camera_at((3.0, 0, 0), orthographic=orthographic, fx=focal_length, fy=focal_length)
    splats = cloud(120, seed=4)

    def blended(part: np.ndarray) -> np.ndarray:
        host.show(splats[part])
        return host.draw(camera).astype(np.float64)

    try:
        for x in (-2.0, 0.0, 2.0):
            host.renderer.set_box((x - 0.005, 0, 0), (0.01, 9, 9), 0.5)  # its near face at x
            host.show(splats)
            host.draw(camera)
            picture = host.renderer.read_color8((0, 0, 0))
            host.renderer.set_box((0, 0, -1e6), (1, 1, 1))
            before, behind = (
                blended(part) for part in (splats.positions[:, 0] > x, splats.positions[:, 0] < x)
            )
            veiled = 0.5 + 0.5 * np.clip(behind[..., :3], 0, 1)
            expected = before[..., :3] + (1 - before[..., 3:]) * veiled
            np.testing.assert_allclose(picture, 255 * np.clip(expected, 0, 1), atol=2.5)
    finally:
        host.renderer.set_box((0, 0, -1e6), (1, 1, 1))
    assert not host.renderer.failed()


def test_the_gpu_finds_the_order_of_the_sorters(host: Host) -> None:
    """Bit by bit, ties included: a thousand splats in each of a hundred planes, across pages."""
    splats = cloud(100_000, degree=0, size=0.01)
    planes = splats.positions.copy()
    planes[:, 0] = np.round(planes[:, 0] * 40) / 40
    splats = replace(splats, positions=planes)
    host.show(splats)
    along_x = camera_at((3.0, 0.0, 0.0))
    for camera in (along_x, *CAMERAS.values()):
        host.set(order=OrderSource.AUTO)
        picture = host.draw(camera)
        host.set(order=OrderSource.SIDECAR)
        host.look(camera)
        slots = ordering.depth_order(splats, camera)
        host.renderer.set_order("test", host.sequence, str(host.map), 1, "given", 0.0, slots)
        assert host.renderer.draw("test")["order_source"] == "given"
        np.testing.assert_array_equal(picture, host.renderer.read_color())


def test_the_first_frame_that_needs_more_room_is_whole(host: Host) -> None:
    """More visible splats, more tiles and more bits of depth than in any frame before."""
    splats = cloud(150_000, degree=0, size=0.02)
    camera = replace(CAMERAS["outside"], near=1e-6)
    host.show(splats[:10])
    host.draw(camera)
    host.show(splats)
    first = host.draw(camera)
    assert host.renderer.draw("test")["splats"] > 100_000
    host.draw(CAMERAS["inside"])
    np.testing.assert_array_equal(first, host.draw(camera))


def test_static_frames_are_identical(host: Host) -> None:
    """Ties in depth, too: a wall of coplanar splats must not flicker."""
    splats = cloud(500)
    splats = replace(splats, positions=splats.positions * np.float32([0, 1, 1]))
    host.show(splats)
    first = host.draw(CAMERAS["outside"])
    for _ in range(5):
        np.testing.assert_array_equal(host.draw(CAMERAS["outside"]), first)


def test_no_splat_makes_a_pixel_nan(host: Host) -> None:
    """Extremes of every attribute that pass as finite numbers."""
    splats = cloud(2000)
    random = np.random.default_rng(1)
    extremes = np.float32([0, 1e-38, 1e-12, 1e12, 1e19, 3e38])
    splats = replace(
        splats,
        positions=np.where(
            random.random((2000, 3)) < 0.2, random.choice(extremes, (2000, 3)), splats.positions
        ).astype(np.float32),
        scales=np.where(
            random.random((2000, 3)) < 0.3, random.choice(extremes, (2000, 3)), splats.scales
        ).astype(np.float32),
        sh=np.where(
            random.random(splats.sh.shape) < 0.01,
            random.choice(np.concatenate([extremes, -extremes]), splats.sh.shape),
            splats.sh,
        ).astype(np.float32),
    )
    host.show(splats)
    for view in CAMERAS.values():
        assert np.isfinite(host.draw(view)).all()


def test_a_map_that_no_picture_shows_does_not_wait(host: Host) -> None:
    splats = cloud(3000)
    host.show(splats)
    deadline = time.monotonic() + 20
    last = 0.0
    while last != pytest.approx(splats.opacities[2999], abs=1e-5):
        assert time.monotonic() < deadline
        host.renderer.upload()
        last = host.renderer.read_slots([2999])[0]["opacity"]


def test_what_means_nothing_is_left_out_and_counted(host: Host) -> None:
    splats = cloud(10)
    splats.positions[3, 1] = np.nan
    splats.orientations[4] = 0
    host.map += 1
    host.revision = 0
    assert host.apply(0, splats)["dropped"] == 2
    assert host.renderer.splats == 8
    assert np.isfinite(host.draw(CAMERAS["outside"])).all()


def test_a_wrong_batch_is_refused_and_the_map_stays(host: Host) -> None:
    splats = cloud(10)
    host.show(splats)
    with pytest.raises(BatchError, match="positions"):
        host.apply(1, splats, positions=splats.positions.ravel()[:-1])
    with pytest.raises(BatchError, match="sh_degree"):
        host.apply(1, splats, sh_degree=7)
    assert host.renderer.splats == 10
    assert host.renderer.revision == 1


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("fx", 0.0),
        ("width", 0),
        ("orientation", (0.0, 0.0, 0.0, 0.0)),
        ("position", (np.nan, 0, 0)),
        ("fx", 1e100),
        ("near", 1e-100),
    ],
)
def test_a_camera_that_cannot_see_is_refused(host: Host, field: str, value: Any) -> None:
    camera: dict[str, Any] = {
        "position": (0, 0, 0), "orientation": (0, 0, 0, 1), "projection": 0, "fx": 1.0, "fy": 1.0,
        "cx": 0.0, "cy": 0.0, "width": 8, "height": 8,
    }  # fmt: skip
    with pytest.raises(ValueError, match=field):
        host.renderer.set_camera("test", host.sequence + 1, **(camera | {field: value}))


@pytest.mark.parametrize("projection", [0, 1])
@pytest.mark.parametrize(
    "numbers",
    [
        {"fx": 4e9, "fy": 4e-9},
        {"cx": 4e9, "cy": -4e9},
        {"near": 1e-9},
        {"near": 1e6, "far": 1.001e6},
        {"near": 1.0, "far": 1.0 + 2e-7},
        {"far": np.inf},
        {"position": (1e18, -1e18, 1e18)},
    ],
)
def test_a_camera_that_is_not_refused_draws(
    host: Host, numbers: dict[str, Any], projection: int
) -> None:
    """Ogre ends the process over a matrix that overflows."""
    host.show(cloud(10))
    host.sequence += 1
    camera: dict[str, Any] = {
        "position": (0, 0, -5), "orientation": (0, 0, 0, 1), "fx": 8.0, "fy": 8.0, "cx": 4.0,
        "cy": 4.0, "width": 8, "height": 8,
    }  # fmt: skip
    host.renderer.set_camera("test", host.sequence, projection=projection, **(camera | numbers))
    assert host.renderer.draw("test", sort_now=True)["revision"] == host.revision
    assert host.renderer.read_color8().shape == (8, 8, 3)


def test_an_empty_map_is_an_empty_picture(host: Host) -> None:
    host.show(cloud(0))
    assert not host.draw(CAMERAS["outside"]).any()
    assert np.isnan(host.renderer.read_depth()).all()


def test_what_was_never_drawn_is_not_read(display: str) -> None:
    """In a process of its own: here, others have drawn."""
    program = """
from rviz_gaussian_plugin.offscreen import Renderer
renderer = Renderer()
refused = []
for ask in (
    renderer.read_color, renderer.read_depth, renderer.read_color8,
    lambda: renderer.draw("view"), lambda: renderer.pick("view", 0, 0, 1, 1),
):
    try:
        ask()
    except RuntimeError as error:
        refused.append(str(error))
print(refused)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("there is no picture") == 3
    assert done.stdout.count("view 'view' has no camera") == 2


@pytest.mark.parametrize("version", ["2.1", "3.0COMPAT"])
def test_the_processor_needs_no_newer_opengl_than_rviz(display: str, version: str) -> None:
    """The window's bytes are those of the newest OpenGL, with a box and with a veil amid splats."""
    program = """
import hashlib, sys
from rosplat_lab.bench import renderers, scenes
from rosplat_core import rendering
from rosplat_core.rendering import Rasterizer
from rviz_gaussian_plugin.offscreen import Renderer
renderer = Renderer()
if "Mesa" not in renderer.renderer_info:
    sys.exit("no Mesa")
splats = scenes.load("procedural:2000")
rendering.insert_all(renderer, splats)
view = renderers.NumberedView(renderer)
renderer.settings.rasterizer = Rasterizer.PROCESSOR if sys.argv[1] else Rasterizer.AUTO
view.set_camera(scenes.overview(splats, 320, 180, 1)[0])
for opacity in (1.0, 0.5):
    renderer.set_box((0, 0, 0.5), (0.5, 9, 1), opacity)
    assert view.draw(sort_now=True)["rasterizer"] == "processor"
    print(hashlib.sha256(renderer.read_color8((0.2, 0.2, 0.2)).tobytes()).hexdigest())
assert not renderer.failed()
"""

    def shown(*arguments: str, **environment: str) -> str:
        command = [sys.executable, "-c", program, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment)
        if done.stderr == "no Mesa\n":
            pytest.skip("only Mesa can be told to offer an older OpenGL")
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert shown("", MESA_GL_VERSION_OVERRIDE=version) == shown("named")


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_scale_and_opacity_modifiers(host: Host, scale: float) -> None:
    splats = cloud(300)
    host.show(splats)
    host.set(scale=scale, opacity=0.6)
    changed = replace(
        splats,
        scales=splats.scales * np.float32(scale),
        opacities=splats.opacities * np.float32(0.6),
    )
    for view in CAMERAS.values():
        assert decibels(host.draw(view), reference.render(changed, view).rgba) >= 70


def test_a_scale_that_is_set_after_the_camera_counts(host: Host) -> None:
    host.show(cloud(300))
    host.look(CAMERAS["inside"])
    host.set(scale=4.0)
    drawn = host.renderer.draw("test", sort_now=True)["splats"]
    picture = host.renderer.read_color()
    np.testing.assert_array_equal(host.draw(CAMERAS["inside"]), picture)
    assert host.renderer.draw("test", sort_now=True)["splats"] == drawn


def test_a_picture_can_be_read_after_one_that_followed_the_camera(host: Host) -> None:
    host.show(cloud(300))
    expected = host.draw(CAMERAS["outside"])
    host.set(interactive=True)
    host.look(CAMERAS["outside"])
    until = time.monotonic() + PATIENCE
    while not host.renderer.draw("test", sort_now=True)["order_fresh"]:
        assert time.monotonic() < until
        time.sleep(0.01)
    host.set(interactive=False)
    np.testing.assert_array_equal(host.draw(CAMERAS["outside"]), expected)


def test_splats_age_while_nothing_moves(host: Host) -> None:
    host.show(cloud(300))
    host.set(mode=DrawMode.AGE, age_range=4.0)
    host.look(CAMERAS["outside"])
    host.renderer.draw("test", sort_now=True)
    young = host.renderer.read_color()
    time.sleep(1.5)
    host.renderer.draw("test", sort_now=True)
    assert np.abs(host.renderer.read_color() - young).max() > 0.1


def test_only_what_is_in_the_clip_box_is_drawn(host: Host) -> None:
    splats = replace(cloud(300), origin=np.array([10.0, 20.0, 30.0]))
    world = splats.positions + splats.origin
    inside = (np.abs(world - [10.1, 20, 30]) <= [0.2, 0.4, 10]).all(axis=1)
    box = ClipBox()
    box.enabled, box.centre, box.size = True, (10.1, 20, 30), (0.4, 0.8, 20)
    camera = camera_at((12.0, 21.0, 30.7), world_to_camera=look_at((12, 21, 30.7), (10, 20, 30)))
    host.show(splats)
    host.set(clip_box=box)
    assert 20 < inside.sum() < 250
    assert decibels(host.draw(camera), reference.render(splats[inside], camera).rgba) >= 70


def test_a_single_band_alone(host: Host) -> None:
    splats = cloud(300)
    band = splats.sh.copy()
    band[:, [0, *range(4, 16)]] = 0  # what is left is band 1
    host.show(splats)
    host.set(only_band=1)
    expected = reference.render(replace(splats, sh=band), CAMERAS["outside"]).rgba
    assert decibels(host.draw(CAMERAS["outside"]), expected) >= 70
    # A band that the map lacks shows nothing, not another band.
    low_splats = replace(splats, sh=splats.sh[:, :4])
    host.show(low_splats)
    host.set(only_band=3)
    expected = reference.render(replace(low_splats, sh=0 * low_splats.sh), CAMERAS["outside"]).rgba
    assert decibels(host.draw(CAMERAS["outside"]), expected) >= 70
    host.show(splats)
    host.set(only_band=-1, max_sh_degree=1)
    low = reference.render(replace(splats, sh=splats.sh[:, :4]), CAMERAS["outside"]).rgba
    assert decibels(host.draw(CAMERAS["outside"]), low) >= 70


@pytest.mark.parametrize("on", [True, False])
def test_a_model_can_be_forced(host: Host, on: bool) -> None:
    models = [Model.EWA, Model.EWA_ANTIALIASED]
    splats = replace(cloud(2000, size=0.01), model=models[not on])
    host.show(splats)
    host.set(model=models[on])
    expected = reference.render(replace(splats, model=models[on]), CAMERAS["outside"]).rgba
    assert decibels(host.draw(CAMERAS["outside"]), expected) >= 70


def one(**fields: Any) -> Splats:
    """A single splat at the origin, long along x, flat along z."""
    values: dict[str, Any] = {
        "positions": [[0, 0, 0]], "orientations": [[0, 0, 0, 1]], "scales": [[0.4, 0.1, 0.02]],
        "opacities": [0.5], "sh": [[[1, 0, -1]]],
    }  # fmt: skip
    return Splats(
        **{name: np.array(value, np.float32) for name, value in (values | fields).items()}
    )


ABOVE = camera_at((0.0, -0.01, 3.0))  # +y is up in the picture
CENTRE = (HEIGHT // 2, WIDTH // 2)


def test_normals_show_the_shortest_axis(host: Host) -> None:
    host.show(one())
    host.set(mode=DrawMode.NORMALS)
    r, g, b, alpha = host.draw(ABOVE)[CENTRE]
    np.testing.assert_allclose([r / alpha, g / alpha, b / alpha], [0.5, 0.5, 1.0], atol=0.01)


def test_balls_are_solid_and_shaded(host: Host) -> None:
    host.show(one())
    host.set(mode=DrawMode.FLAT_BALL)
    flat = host.draw(ABOVE)
    assert set(np.unique(flat[..., 3])) == {0, 1}
    columns = np.flatnonzero(flat[HEIGHT // 2, :, 3])
    # 0.22 of the peak at 1.74 sigma of 0.4 m, 3 m away
    assert len(columns) == pytest.approx(2 * 1.74 * 0.4 / 3 * 150, abs=2)
    host.set(mode=DrawMode.GAUSSIAN_BALL)
    shaded = host.draw(ABOVE)
    rim = shaded[HEIGHT // 2, columns[1], 0]
    assert 0.2 < rim / shaded[CENTRE][0] < 0.35


def test_billboards_are_round(host: Host) -> None:
    host.show(one())
    host.set(mode=DrawMode.BILLBOARD)
    alpha = host.draw(ABOVE)[..., 3]
    across, along = (alpha[HEIGHT // 2] > 0.1).sum(), (alpha[:, WIDTH // 2] > 0.1).sum()
    assert abs(int(across) - int(along)) <= 1


def test_depth_opacity_and_age_are_colour_mapped(host: Host) -> None:
    """Turbo runs from blue to red: far, transparent, old are blue; near, opaque, new are red."""
    far_and_near = replace(
        one(positions=[[0, 0.5, -2], [0, -0.5, 1]], orientations=[[0, 0, 0, 1]] * 2,
            scales=[[0.2] * 3] * 2, opacities=[0.9, 0.05], sh=[[[0, 0, 0]]] * 2),
    )  # fmt: skip
    host.show(far_and_near)

    def hues() -> list[str]:
        picture = host.draw(ABOVE)
        spots = [np.unravel_index(np.argmax(half), half.shape) for half in
                 (picture[: HEIGHT // 2, :, 3], picture[HEIGHT // 2 :, :, 3])]  # fmt: skip
        pixels = [picture[spots[0]], picture[spots[1][0] + HEIGHT // 2, spots[1][1]]]
        return ["red" if p[0] > 2 * p[2] else "blue" for p in pixels]

    host.set(mode=DrawMode.DEPTH)
    assert hues() == ["blue", "red"]
    host.set(depth_range=(0.1, 0.2))  # both beyond
    assert hues() == ["blue", "blue"]
    host.set(mode=DrawMode.OPACITY)
    assert hues() == ["red", "blue"]
    host.set(mode=DrawMode.AGE, age_range=1000.0)
    assert hues() == ["red", "red"]
    host.set(age_range=1e-9)
    assert hues() == ["blue", "blue"]


def test_near_fade_thins_what_is_close(host: Host) -> None:
    host.show(one())
    solid = host.draw(ABOVE)[CENTRE][3]
    host.set(near_fade=6.0)
    assert host.draw(ABOVE)[CENTRE][3] == pytest.approx(solid / 2, rel=0.02)


def test_slots_are_drawn_unsorted_where_nobody_is_to_sort(host: Host) -> None:
    splats = cloud(300)
    host.show(splats)
    host.set(order=OrderSource.OFF)
    host.look(CAMERAS["outside"])
    assert host.renderer.draw("test")["order_source"] == "unsorted"
    expected = reference.render(splats, CAMERAS["outside"], order=np.arange(300)).rgba
    assert decibels(host.renderer.read_color(), expected) >= 70


def test_what_is_sorted_now_is_sorted_where_that_takes_least(host: Host) -> None:
    """By what rasterises, unless another is named."""
    best = "gpu"
    if host.renderer.settings.rasterizer == Rasterizer.PROCESSOR:
        best = "processor"
    splats = cloud(300)
    host.show(splats)
    for source in OrderSource.__members__.values():
        host.set(order=source)
        host.look(CAMERAS["outside"])
        report = host.renderer.draw("test", sort_now=True)
        assert report["order_source"] == ("unsorted" if source == OrderSource.OFF else best)
        unsorted = np.arange(300) if source == OrderSource.OFF else None
        expected = reference.render(splats, CAMERAS["outside"], order=unsorted).rgba
        assert decibels(host.renderer.read_color(), expected) >= 70


@pytest.mark.parametrize("view", CAMERAS)
def test_a_pixel_picks_what_contributes_most_to_it(host: Host, view: str) -> None:
    """Where the float64 renderer's best is no tie, and not at the limit of what counts."""
    splats = cloud(2000, degree=0, size=0.04)  # several batches of a workgroup
    slots, most = reference.pick(splats, CAMERAS[view])
    host.show(splats)
    host.draw(CAMERAS[view])
    picked = host.renderer.pick("test", 0, 0, WIDTH, HEIGHT).astype(np.int64)
    picked[picked == 2**32 - 1] = -1
    slots[most < 0.05] = -1
    limit = np.abs(most - 0.05) < 1e-3
    assert (picked == slots)[~limit].mean() > 0.998
    assert len(np.unique(slots)) > 15


def test_a_pick_changes_no_depth(host: Host) -> None:
    host.show(cloud(500))
    host.draw(CAMERAS["outside"])
    depth = host.renderer.read_depth()
    host.renderer.pick("test", 5, 5, 30, 20)
    np.testing.assert_array_equal(host.renderer.read_depth(), depth)


@pytest.mark.parametrize("shape", [(0, 0), (3, 0), (0, 4), (-1, 4)])
def test_a_rectangle_without_pixels_picks_nothing(host: Host, shape: tuple[int, int]) -> None:
    host.show(cloud(500))
    host.draw(CAMERAS["outside"])
    height, width = shape
    assert host.renderer.pick("test", 5, 5, width, height).shape == (max(height, 0), width)


@pytest.mark.parametrize("view", CAMERAS)
def test_a_part_of_the_picture_picks_as_the_whole(host: Host, view: str) -> None:
    """As a click of rviz's mouse does, for large splats too, whose ellipses a wide angle bends."""
    host.show(cloud(2000, degree=0, size=0.2))
    host.draw(CAMERAS[view])
    whole = host.renderer.pick("test", 0, 0, WIDTH, HEIGHT)
    for left, top in np.random.default_rng(0).integers((0, 0), (WIDTH - 4, HEIGHT - 3), (50, 2)):
        part = host.renderer.pick("test", left, top, 4, 3)
        np.testing.assert_array_equal(part, whole[top : top + 3, left : left + 4])


def test_a_faint_splat_does_not_hide_what_is_seen_through_it(host: Host) -> None:
    """0.4 before a solid one: the solid one; three times 0.4 before it: the first of them."""
    wall = Splats(
        positions=np.array([[-1, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]], np.float32),
        orientations=np.array([[0, 0, 0, 1]] * 4, np.float32),
        scales=np.full((4, 3), 0.3, np.float32),
        opacities=np.array([1, 0, 0, 0.4], np.float32),
        sh=np.zeros((4, 1, 3), np.float32),
    )
    camera = camera_at((3.0, 0.0, 0.0))
    for opacities, seen in [((1, 0, 0, 0.4), 0), ((1, 0.4, 0.4, 0.4), 3), ((0, 0, 0, 0.02), None)]:
        host.show(replace(wall, opacities=np.float32(opacities)))
        host.draw(camera)
        slot = host.renderer.pick("test", WIDTH // 2, HEIGHT // 2, 1, 1)[0, 0]
        assert slot == (2**32 - 1 if seen is None else seen)


def test_slots_are_read_back_as_they_were_sent(host: Host) -> None:
    splats = replace(cloud(70000, degree=2), origin=np.array([1e6, -2e6, 3.0]))
    host.show(splats)
    host.draw(CAMERAS["outside"])
    slots = [69999, 0, 65536, 65535, 0]
    for slot, read in zip(slots, host.renderer.read_slots(slots), strict=True):
        assert read["slot"] == slot
        np.testing.assert_allclose(
            read["position"], splats.positions[slot] + splats.origin, rtol=0, atol=1e-6
        )
        np.testing.assert_allclose(read["scale"], splats.scales[slot], rtol=4e-4)
        turned = np.abs(np.dot(read["orientation"], splats.orientations[slot].astype(float)))
        assert turned == pytest.approx(1, abs=1e-7)
        assert read["opacity"] == pytest.approx(splats.opacities[slot], abs=1e-5)
        np.testing.assert_allclose(read["sh"], splats.sh[slot], atol=2e-3)
    host.delete(65536, 1)
    host.draw(CAMERAS["outside"])
    emptied, beyond = host.renderer.read_slots([65536, 10**6])
    assert emptied["opacity"] == beyond["opacity"] == 0


# The last test: the renderer keeps the maps that this adds, and one order is of one map.
def test_maps_of_all_models_are_sorted_together(host: Host) -> None:
    maps = [replace(cloud(150, degree=0, seed=model), model=model) for model in Model]
    host.show(maps[0])
    others = [host.renderer.add_map() for _ in maps[1:]]
    for other, splats in zip(others, maps[1:], strict=True):
        insert_all(other, splats)
    for camera in (CAMERAS["outside"], CAMERAS["inside"]):
        together = [project(splats, camera) for splats in maps]
        joined = Projected(
            **{
                name: np.concatenate([vars(of)[name] for of in together])
                for name in vars(together[0])
            }
        )
        nearest_first = joined[np.argsort(joined.depths, kind="stable")]
        expected = blended(nearest_first, (0, 0, WIDTH, HEIGHT))
        assert decibels(host.draw(camera), expected.rgba) >= 70
        if host.renderer.settings.rasterizer == Rasterizer.TILES:
            solid = expected.rgba[..., 3] > 0.4
            error = np.abs(host.renderer.read_depth() / expected.depth - 1)[solid]
            assert np.median(error) < 1e-3
    for other in others:
        insert(other, maps[0][:0], slice(0, 0), 1)
    host.set(model=Model.RAY)  # of all maps; one is left
    expected = reference.render(replace(maps[0], model=Model.RAY), CAMERAS["outside"]).rgba
    assert decibels(host.draw(CAMERAS["outside"]), expected) >= 70
