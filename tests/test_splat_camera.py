"""MuJoCo's bodies and a map in one picture, against the float64 twin with bodies as surfaces."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drawing import decibels
from rosplat_core.cameras import look_at
from rosplat_core.first_look import sample
from rosplat_core.formats import load
from rosplat_core.generated import generate
from rosplat_core.models import Model
from rosplat_core.quaternions import from_matrices
from rosplat_core.rendering import (
    CpuRenderer,
    insert_groups,
    move,
    over_opaque,
    posed,
)
from rosplat_core.rigid import placed
from rosplat_core.splats import InputError, Splats
from rosplat_core.upright import find_up, standing_pose
from rosplat_lab import reference
from rosplat_tools.lidars.scanning import Lidar, Pattern
from rosplat_tools.simulation import body_pictures
from rosplat_tools.simulation.robot_model import RobotModel, put_in_map
from rosplat_tools.simulation.solids import solids
from rosplat_tools.simulation.splat_camera import SplatCamera

mujoco = pytest.importorskip("mujoco", reason="no mujoco here (PyPI)")

# Without lights, a body has the colour that it emits: pictures of bodies are known exactly.
MODEL = """
<mujoco>
  <statistic extent="3" center="0 0 0.5"/>
  <visual><headlight ambient="0 0 0" diffuse="0 0 0" specular="0 0 0"/></visual>
  <asset>
    <material name="red" rgba="0.8 0.2 0.1 1" emission="1"/>
    <material name="blue" rgba="0.1 0.3 0.9 1" emission="1"/>
    <mesh name="ball" builtin="sphere" params="3" scale="0.35 0.35 0.35"/>
    <material name="glass" rgba="0.2 0.9 0.4 0.3" emission="1"/>
  </asset>
  <worldbody>
    <camera name="first" pos="0 -3 1" xyaxes="1 0 0 0 0.2 1" fovy="50" resolution="160 110"/>
    <camera name="lens" pos="2 -1.5 1" xyaxes="0.6 0.8 0 -0.2 0.15 1" resolution="170 120"
      sensorsize="0.004 0.003" focal="0.004 0.0042" principal="0.0002 -0.0001"/>
    <camera name="flat" pos="0 0.2 4" xyaxes="1 0 0 0 1 0" projection="orthographic" fovy="2.5"/>
    <geom name="wall" type="box" size="1.5 0.05 0.6" pos="0 1.2 0.3" material="glass"/>
    <geom name="unseen" type="box" size="3 3 3" group="3"/>
    <body name="ball" pos="0.2 -0.2 0.5">
      <freejoint/>
      <geom type="mesh" mesh="ball" material="red"/>
    </body>
    <body name="box" pos="-0.6 0.2 0.4">
      <geom type="box" size="0.2 0.3 0.4" euler="20 30 40" material="blue"/>
    </body>
  </worldbody>
</mujoco>
"""
CAMERAS = ("first", "lens", "flat")
MOBILE = Path(__file__).parents[1] / "rosplat_tools" / "robots" / "mobile.xml"
COLOURS = {"ball": (0.8, 0.2, 0.1), "box": (0.1, 0.3, 0.9), "world": (0.2, 0.9, 0.4)}


def cloud() -> Splats:
    """Splats of all opacities, in front of the bodies, behind them, and within."""
    random, count = np.random.default_rng(5), 500
    orientations = random.normal(size=(count, 4)).astype(np.float32)
    return Splats(
        positions=random.normal((0, 0, 0.5), (0.8, 0.8, 0.4), (count, 3)).astype(np.float32),
        orientations=orientations / np.linalg.norm(orientations, axis=1, keepdims=True),
        scales=(0.15 * random.uniform(0.05, 1, size=(count, 3)) ** 2).astype(np.float32),
        opacities=random.uniform(0.05, 1, count).astype(np.float32),
        sh=random.normal(scale=0.8, size=(count, 1, 3)).astype(np.float32),
    )  # fmt: skip


@pytest.fixture(scope="module")
def model() -> Any:
    return mujoco.MjModel.from_xml_string(MODEL)


@pytest.fixture
def data(model: Any) -> Any:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def cast(model: Any, data: Any, camera: Any) -> tuple[np.ndarray, np.ndarray]:
    """Depths along z and bodies (height, width) by MuJoCo's own rays, in float64; -1: no body."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    u, v = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    pose = camera.camera_to_world
    if camera.orthographic:
        eyes = np.stack([u, v, 0 * u, np.ones_like(u)], -1).reshape(-1, 4) @ pose.T[:, :3]
        rays = np.broadcast_to(pose[:3, 2], eyes.shape)
    else:
        rays = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3) @ pose[:3, :3].T
        eyes = np.broadcast_to(pose[:3, 3], rays.shape)
    groups, geometry = np.array([1, 1, 1, 0, 0, 0], np.uint8), np.zeros(1, np.int32)
    depths, bodies = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for i, (eye, ray) in enumerate(zip(eyes, rays, strict=True)):
        distance = mujoco.mj_ray(model, data, eye, ray, groups, 1, -1, geometry, None)
        if distance >= 0:  # in lengths of the ray, whose z is 1
            depths[i], bodies[i] = distance, model.geom_bodyid[geometry[0]]
    return depths.reshape(y.shape), bodies.reshape(y.shape)


def edge(bodies: np.ndarray) -> np.ndarray:
    """Whether a pixel's neighbours are of another body."""
    found = np.zeros(bodies.shape, bool)
    for axis in (0, 1):
        differ = np.diff(bodies, axis=axis) != 0
        pad = [(0, 0), (0, 0)]
        for pad[axis] in ((0, 1), (1, 0)):
            found |= np.pad(differ, pad)
    return found


@pytest.mark.parametrize("name", CAMERAS)
def test_bodies_are_where_rays_meet_them(model: Any, data: Any, name: str) -> None:
    """To the pixel, edges included: but for rays that pass an edge by next to nothing."""
    eye = SplatCamera(model, data, cloud()[:0], width=150, height=130)
    assert eye.problem == ""
    picture = eye.picture(name, bodies=True)
    depths, bodies = cast(model, data, picture.camera)
    assert picture.bodies is not None
    seen = np.isfinite(depths)
    assert seen.mean() > 0.1
    off = (np.isfinite(picture.depth) != seen) | (picture.bodies != bodies.clip(0))
    assert not (off & ~edge(bodies)).any()
    assert off.mean() < 2e-4
    near = seen & ~off
    np.testing.assert_allclose(picture.depth[near], depths[near], rtol=1e-3)
    expected = np.array([COLOURS[model.body(int(b)).name] for b in bodies[near]])
    assert np.abs(picture.colour[near] / 255 - expected).max() < 1.5 / 255


@pytest.mark.parametrize("placed", [False, True])
@pytest.mark.parametrize("name", CAMERAS)
def test_matches_the_float64_twin(model: Any, data: Any, name: str, placed: bool) -> None:
    splats, pose = cloud(), np.eye(4)
    if placed:
        pose = np.linalg.inv(look_at((0.3, 0.1, 0.2), (0.2, 0.6, 0.4)))
        splats = replace(
            splats, positions=((splats.positions - pose[:3, 3]) @ pose[:3, :3]).astype("f4")
        )
    eye = SplatCamera(model, data, splats, map_pose=pose, width=150, height=130)
    picture = eye.picture(name)
    camera = picture.camera
    depths, bodies = cast(model, data, camera)
    in_map = replace(camera, world_to_camera=camera.world_to_camera @ pose)
    twin = reference.render(splats, in_map, scene_depth=depths)
    colours = np.array([COLOURS[model.body(b).name] for b in range(model.nbody)] + [(0, 0, 0)])
    expected = twin.rgba[..., :3] + (1 - twin.rgba[..., 3:]) * colours[bodies]
    expected = np.round(255 * expected.clip(0, 1)) / 255
    assert decibels(picture.colour / 255, expected) >= 60
    surface = twin.rgba[..., 3] >= 0.5
    clear = np.abs(twin.rgba[..., 3] - 0.5) > 0.01
    depth = np.where(surface, twin.median, depths)
    assert (surface & clear).mean() > 0.1
    assert (~surface & clear & np.isfinite(depths)).mean() > 0.02  # bodies are seen, too
    same = np.isclose(picture.depth, depth, rtol=1e-3)
    assert same[clear].mean() > 0.998


def test_splats_over_what_is_opaque_are_numpy_s() -> None:
    random, size = np.random.default_rng(2), (7, 9)
    colour = random.uniform(-0.2, 1.3, (*size, 4)).astype(np.float32)
    colour[..., 3] = random.uniform(0, 1, size)
    depth, farther = random.uniform(1, 9, (2, *size)).astype(np.float32)
    below = random.integers(0, 256, (*size, 3)).astype(np.uint8)
    alpha = colour[..., 3:].astype(np.float64)
    for behind in (below[::-1], None):
        rgb, nearest, surface = over_opaque(
            colour, depth, behind, None if behind is None else farther
        )
        light = 0 if behind is None else (1 - alpha) * behind
        expected = (255 * colour[..., :3].astype(np.float64) + light).clip(0, 255)
        assert rgb.dtype == np.uint8 and np.abs(rgb - expected).max() <= 0.5 + 1e-3
        beyond = np.inf if behind is None else farther
        np.testing.assert_array_equal(surface, alpha[..., 0] >= 0.5)
        np.testing.assert_array_equal(nearest, np.where(surface, depth, beyond))
    for wrong in ((colour[:3], depth), (colour, depth.T), (colour, depth, below[:, :3])):
        with pytest.raises(ValueError, match="expected pictures of one size"):
            over_opaque(*wrong)


def test_render_is_the_picture_without_the_bodies(model: Any, data: Any) -> None:
    eye = SplatCamera(model, data, cloud())
    rgb, depth = eye.render("first")
    picture = eye.picture(0, bodies=True)
    assert rgb.dtype == np.uint8 and rgb.shape == (110, 160, 3)
    assert depth.dtype == np.float32 and depth.shape == (110, 160)
    np.testing.assert_array_equal(rgb, picture.colour)
    np.testing.assert_array_equal(depth, picture.depth)


def test_environments_share_a_map_and_each_has_its_own_bodies(model: Any, data: Any) -> None:
    renderer = CpuRenderer(cloud())
    other = mujoco.MjData(model)
    other.qpos[:3] += (0.3, 0, 0.4)
    mujoco.mj_forward(model, other)
    eyes = [SplatCamera(model, of, renderer) for of in (data, other, data)]
    first, second, third = (eye.render("first")[0] for eye in eyes)
    np.testing.assert_array_equal(first, third)
    assert (first != second).any()


def test_environments_of_a_model_share_a_camera_in_any_thread(model: Any) -> None:
    """Each picture is that of a SplatCamera that one environment has for itself."""
    random, datas = np.random.default_rng(3), [mujoco.MjData(model) for _ in range(8)]
    for of in datas:
        of.qpos[:3] += random.uniform(-0.4, 0.4, 3)
        mujoco.mj_forward(model, of)
    on_body = placed(np.array([0.3, 0.0, -0.1]), turned([0.4, 0.1, -0.2]))
    renderer, riding = CpuRenderer(cloud()), {"ball": (cloud()[:50], on_body)}
    alone = [SplatCamera(model, of, renderer, riding=riding).render("first") for of in datas]
    eye = SplatCamera(model, datas[0], renderer, riding=riding)
    with ThreadPoolExecutor(4) as pool:
        shared = list(pool.map(lambda of: eye.render("first", of), 4 * datas))
    for seen, known in zip(shared, 4 * alone, strict=True):
        np.testing.assert_array_equal(seen[0], known[0])
        np.testing.assert_array_equal(seen[1], known[1])
    assert (alone[0][0] != alone[1][0]).any()
    other = mujoco.MjModel.from_xml_string("<mujoco><worldbody><body/></worldbody></mujoco>")
    with pytest.raises(ValueError, match="data: expected an MjData of the SplatCamera's model"):
        eye.render("first", mujoco.MjData(other))


@pytest.mark.parametrize("model_of_splats", ["ewa", "ray", "disc"])
def test_a_card_draws_the_same(model: Any, data: Any, model_of_splats: str) -> None:
    """By EGL without a display, with splats that ride, from another thread; bodies hide splats to
    the pixel, and depths are the processor's."""
    offscreen = pytest.importorskip("rviz_gaussian_plugin.offscreen")
    splats = replace(cloud(), model=Model.of(model_of_splats))
    riding = {"ball": (splats[:50], placed(np.array([0.3, 0.0, -0.1]), turned([0.4, 0.1, -0.2])))}
    card = offscreen.CardRenderer(splats)
    eye = SplatCamera(model, data, card, riding=riding, width=150, height=131)
    twin = SplatCamera(model, data, splats, riding=riding, width=150, height=131)
    bare = SplatCamera(model, data, splats[:0], width=150, height=131)
    with ThreadPoolExecutor(1) as another:
        for name in (*CAMERAS, CAMERAS[0]):
            picture = another.submit(eye.picture, name, bodies=True).result()
            expected = twin.picture(name, bodies=True)
            assert decibels(picture.colour / 255, expected.colour / 255) >= 55
            assert np.mean(picture.bodies != expected.bodies) < 2e-3
            assert np.mean(np.isinf(picture.depth) != np.isinf(expected.depth)) < 2e-3
            same = np.isclose(picture.depth, expected.depth, rtol=1e-4)
            bodies = expected.depth == bare.picture(name).depth
            assert same[bodies].mean() > 0.998 and same.mean() > 0.99
    with pytest.raises(ValueError, match="one SplatCamera has `riding`"):
        SplatCamera(model, data, card).render("first")


@pytest.mark.parametrize("splats_in_line", [40, 5000])
def test_a_card_s_depths_are_the_float64_twin_s(model: Any, data: Any, splats_in_line: int) -> None:
    """Where half of the light is left, in lists that are cut into segments, too."""
    offscreen = pytest.importorskip("rviz_gaussian_plugin.offscreen")
    random = np.random.default_rng(7)
    count = splats_in_line
    splats = Splats(
        positions=random.uniform((-0.3, -0.5, 0.3), (0.3, 1.0, 0.9), (count, 3)).astype(np.float32),
        orientations=np.tile(np.float32([0, 0, 0, 1]), (count, 1)),
        scales=np.full((count, 3), 0.05, np.float32),
        opacities=np.full(count, 40 / count, np.float32).clip(0.01, 0.9),
        sh=random.normal(scale=0.5, size=(count, 1, 3)).astype(np.float32),
    )  # fmt: skip
    camera = SplatCamera(model, data, splats[:0]).camera("first")
    twin = reference.render(splats, camera)
    colour, depth, surface = offscreen.CardRenderer(splats).over(camera)
    assert decibels(colour / 255, twin.rgba[..., :3].clip(0, 1)) >= 55
    clear = np.abs(twin.rgba[..., 3] - 0.5) > 0.01
    np.testing.assert_array_equal(surface[clear], np.isfinite(twin.median)[clear])
    assert (surface & clear).mean() > 0.02
    # Which of many faint splats leaves half is decided by their opacities as maps hold them.
    np.testing.assert_allclose(depth[surface & clear], twin.median[surface & clear], rtol=1e-2)
    np.testing.assert_allclose(depth, CpuRenderer(splats).over(camera)[1], rtol=1e-5)
    assert np.isinf(depth[~surface]).all()


def test_without_opengl_the_map_alone_is_seen_and_it_says_why(
    model: Any, data: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: Any) -> Any:
        raise body_pictures.NoGL("egl: no driver")

    monkeypatch.setattr(body_pictures, "_open", none)
    eye = SplatCamera(model, data, cloud())
    assert eye.problem == "egl: no driver"
    picture = eye.picture("first", bodies=True)
    drawn = CpuRenderer(cloud()).draw(posed(picture.camera), median_depth=True)["colour"]
    assert decibels(picture.colour / 255, drawn[..., :3]) > 50
    assert picture.bodies is not None and not picture.bodies.any()


def test_a_camera_that_there_is_not_is_named(model: Any, data: Any) -> None:
    eye = SplatCamera(model, data, cloud())
    for wrong in ("second", 3, -1):
        with pytest.raises(ValueError, match=f"camera '{wrong}': the model has first, lens, flat"):
            eye.render(wrong)


def test_without_mujoco_its_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match="pip install mujoco"):
        SplatCamera(None, None, cloud())


def test_an_opengl_that_mujoco_lacks_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "mujoco.py").write_text("raise AttributeError('no glGetError')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, "mujoco", raising=False)
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    with pytest.raises(InputError, match="MUJOCO_GL='osmesa': no glGetError"):
        SplatCamera(None, None, cloud())


def turned(vector: list[float]) -> Any:
    """The rotation matrix of a rotation vector [rad]."""
    return Rotation.from_rotvec(vector).as_matrix()


def test_splats_ride_on_bodies() -> None:
    """They are drawn, and measured by a lidar, as if the map held them where the body is."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    map_pose = placed(np.array([0.1, -0.2, 0.3]), turned([0.2, -0.3, 0.5]))
    on_body = placed(np.array([0.3, 0.0, -0.1]), turned([0.4, 0.1, -0.2]))
    room, thing = cloud(), cloud()[:100]
    camera = SplatCamera(model, data, room, map_pose=map_pose, riding={"ball": (thing, on_body)})
    pattern = Pattern.of(4, 64, -0.3, 0.3)
    for turn in ([0.0, 0.0, 0.0], [0.5, -1.0, 2.0]):
        data.qpos[:3] = np.add([0.2, -0.2, 0.5], turn)
        data.qpos[3:7] = np.roll(from_matrices(turned(turn)), 1)
        mujoco.mj_forward(model, data)
        body = placed(data.body("ball").xpos, data.body("ball").xmat)
        whole = CpuRenderer()
        in_map = np.linalg.inv(map_pose) @ body @ on_body
        revision = insert_groups(whole, [room, thing])
        pose = (*in_map[:3, 3].tolist(), *from_matrices(in_map[:3, :3]).tolist())
        move(whole, {1: pose}, revision + 1)
        expected = SplatCamera(model, data, whole, map_pose=map_pose)
        for name in CAMERAS:
            seen, known = camera.picture(name), expected.picture(name)
            np.testing.assert_array_equal(seen.colour, known.colour)
            np.testing.assert_array_equal(seen.depth, known.depth)
        scans = [
            Lidar(pattern).scan(each.renderer, map_pose, each.riders.at(data, map_pose))
            for each in (camera, expected)
        ]
        np.testing.assert_array_equal(scans[0].ranges, scans[1].ranges)
    with pytest.raises(ValueError, match="no body 'chair'"):
        SplatCamera(model, data, room, riding={"chair": (thing, on_body)})


def test_an_object_falls_and_comes_to_rest() -> None:
    floor = generate(60_000, scene="rooms")
    places = floor.positions
    above = (np.abs(places[:, :2] - (-1.2, -1.2)) < 0.3).all(axis=1) & (places[:, 2] < 0.05)
    thing = replace(floor[above], origin=np.array([0.4, 0.0, 0.5]))  # a slab of floor, in the air
    standing = put_in_map(
        MOBILE, floor, (0, 0, 1), (-1.2, -1.2, 0.0), resolution=0.1, objects={"slab": thing}
    )
    robot = standing.robot
    began = robot.pose(robot.model.body("slab").id)[2, 3]
    robot.step(3.0)
    pose = robot.pose(robot.model.body("slab").id)
    assert began - pose[2, 3] > 0.3
    at_rest = pose[2, 3]
    robot.step(1.0)
    assert abs(robot.pose(robot.model.body("slab").id)[2, 3] - at_rest) < 0.005
    camera = SplatCamera(
        robot.model, robot.data, CpuRenderer(floor), map_pose=standing.map_pose,
        riding=standing.riding,
    )  # fmt: skip
    (moved,) = camera.riders.poses(robot.data, standing.map_pose).values()
    assert moved[2, 3] < -0.3
    robot.reset()
    (moved,) = camera.riders.poses(robot.data, standing.map_pose).values()
    np.testing.assert_allclose(moved, np.eye(4), atol=1e-6)


def test_a_box_dropped_in_a_trained_scene_comes_to_rest(data_folder: Path, tmp_path: Path) -> None:
    """On the ground of playbot, which is two metres wide."""
    splats = load(data_folder / "playbot")
    pose = standing_pose(sample(splats), find_up(splats))
    boxes = solids(splats, pose)
    for x, y in ((-0.5, -0.5), (0.6, 0.4), (0.7, -0.3)):
        (tmp_path / "box.xml").write_text(
            f'<mujoco><worldbody><body name="box" pos="{x} {y} 0.6"><freejoint/><geom type="box" '
            'size="0.05 0.06 0.04" mass="0.3"/></body></worldbody></mujoco>'
        )
        robot = RobotModel(tmp_path / "box.xml", boxes, np.eye(4))
        robot.step(3.0)
        rest = robot.pose(1)[:3, 3].copy()
        assert 0 < rest[2] < 0.3
        robot.step(3.0)
        assert np.linalg.norm(robot.pose(1)[:3, 3] - rest) < 1e-3


def test_the_same_commands_lead_to_the_same_pictures() -> None:
    """To the bit."""
    room = generate(60_000, scene="rooms")
    films = []
    for _ in range(2):
        stands = put_in_map(MOBILE, room, (0, 0, 1), (-1.2, -1.2, 0.0), resolution=0.1)
        robot = stands.robot
        eye = SplatCamera(robot.model, robot.data, room, map_pose=stands.map_pose)
        robot.command("linear_x", 0.3)
        robot.command("angular_z", 1.0)
        film = []
        for _ in range(4):
            robot.step(0.25)
            film += [*eye.render("camera"), *eye.render("chase"), robot.data.qpos.copy()]
        films.append(film)
    for one, other in zip(*films, strict=True):
        np.testing.assert_array_equal(one, other)
    assert (films[0][0] != films[0][-3]).any()
