"""A map's solid parts: boxes against the surfaces that generated rooms are made of."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rosplat_core.generated import generate
from rosplat_core.generated.rooms import Rooms
from rosplat_core.rigid import placed
from rosplat_core.splats import InputError, Splats
from rosplat_tools.convert import main
from rosplat_tools.simulation import solids as module
from rosplat_tools.simulation.robot_model import BrokenState, RobotModel, robot_file
from rosplat_tools.simulation.solids import Boxes, add_solids, free_place, solids

mujoco = pytest.importorskip("mujoco", reason="no mujoco here (PyPI)")

ROBOTS = Path(__file__).resolve().parents[1] / "robots"
RESOLUTION = 0.05
FREE = (-1.2, -1.2)  # a place in the middle room, between its doors [m]
WALL = -1.93  # y of the inner side of the middle room's wall there [m]
BOW = 0.165  # of the mobile robot, from its origin [m]


@pytest.fixture(scope="module")
def splats() -> Splats:
    return generate(200_000, scene="rooms")


@pytest.fixture(scope="module")
def boxes(splats: Splats) -> Boxes:
    return solids(splats, np.eye(4), RESOLUTION)


def cast(boxes: Boxes, eyes: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Distances (n, k) that rays (n, k, 3) from eyes (n, 3) go until they meet a box; -1: never."""
    spec = mujoco.MjSpec()
    add_solids(spec, boxes, np.eye(4))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found, count = np.empty(rays.shape[:2]), rays.shape[1]
    geometry = np.zeros(count, np.int32)
    for eye, ray, into in zip(eyes, rays, found, strict=True):
        mujoco.mj_multiRay(
            model, data, eye, ray.ravel(), None, 1, -1, geometry, into, None, count, 1e9
        )
    return found


def test_boxes_hold_all_voxels_and_no_others() -> None:
    random = np.random.default_rng(2)
    cells = np.unique(random.integers(-6, 6, (900, 3)), axis=0)
    low, high, of = module._fewest(cells)
    assert len(low) < len(cells) / 2
    held = [
        cell
        for first, beyond in zip(low, high, strict=True)
        for cell in product(*(range(a, b) for a, b in zip(first, beyond, strict=True)))
    ]
    assert sorted(held) == sorted(map(tuple, cells.tolist()))
    assert ((cells >= low[of]) & (cells < high[of])).all()


def test_boxes_are_where_surfaces_are(boxes: Boxes) -> None:
    rooms = Rooms(np.random.default_rng(0))  # of seed 0, as the map
    low = np.array([box.low for box in rooms._boxes])
    high = np.array([box.high for box in rooms._boxes])
    random = np.random.default_rng(1)
    eyes = random.uniform((-5.8, -5.8, 0.05), (5.8, 5.8, 1.2), (400, 3))
    eyes = eyes[~((eyes[:, None] > low - 0.1) & (eyes[:, None] < high + 0.1)).all(2).any(1)]
    rays = random.normal(size=(len(eyes), 40, 3))
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    true, found = cast(Boxes(low, high), eyes, rays), cast(boxes, eyes, rays)
    met = true > 0
    assert met.mean() > 0.5
    assert (found[met] < 0).mean() < 2e-3  # between boxes
    error = np.abs(found - true)[met & (found > 0)]
    assert np.median(error) < RESOLUTION / 2
    assert np.quantile(error, 0.9) < RESOLUTION


def test_a_robot_is_put_where_it_has_room() -> None:
    floor, hanging, wall = (
        (-3, -3, -0.1, 3, 3, 0),
        (-0.1, -0.1, 0.2, 0.1, 0.1, 2),
        (1, -3, 0, 2, 3, 2),
    )
    sides = np.array([floor, hanging, wall], np.float64)
    boxes = Boxes(sides[:, :3], sides[:, 3:])
    assert free_place(boxes, (-1, 0)) == pytest.approx((-1, 0, 0))
    x, y, ground = free_place(boxes, (0, 0)) or (0, 0, 1)
    assert ground == 0
    assert 0.34 < np.hypot(x, y) < 0.6  # not below what hangs there
    assert (free_place(boxes, (1.5, 0)) or (0,))[0] > 2.2  # beyond the wall
    assert free_place(Boxes(sides[:0, :3], sides[:0, 3:]), (0, 0)) is None


def test_what_is_enclosed_is_solid_where_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    shell = np.array([c for c in product(range(5), repeat=3) if 0 in c or 4 in c])

    class Shell:
        def surface(self, _: float) -> dict[str, Any]:
            return {"cells": shell.astype(np.int32), "positions": (shell + 0.5) * 0.1}

    monkeypatch.setattr(module, "occupied_by", lambda *_: Shell())
    hollow, filled = (solids(None, np.eye(4), 0.1, filled=filled) for filled in (False, True))  # type: ignore[arg-type]
    centre = np.array([[0.25, 0.25, 0.25]])
    assert len(filled) == 1
    np.testing.assert_allclose(filled.high - filled.low, 0.5 - 2 * 0.1 * (0.5 - module.SKIN))
    assert not ((hollow.low < centre) & (hollow.high > centre)).all(axis=1).any()


def test_a_robot_stops_at_a_wall(boxes: Boxes) -> None:
    """Within a voxel of it, and on the floor."""
    x, y, ground = free_place(boxes, FREE) or (0, 0, 1)
    assert (x, y) == pytest.approx(FREE)
    assert abs(ground) < RESOLUTION / 2
    start = placed((*FREE, ground), ((0, 1, 0), (-1, 0, 0), (0, 0, 1)))  # it faces along -y
    robot = RobotModel(ROBOTS / "mobile.xml", boxes, np.linalg.inv(start))
    robot.step(0.5)
    base = robot.base
    assert robot.model.body(base).name == "base_link"
    assert abs(robot.pose(base)[2, 3]) < 0.005
    robot.command("linear_x", 0.4)
    robot.step(1.0)
    assert robot.velocity(base)[0] == pytest.approx(0.4, abs=0.02)
    robot.step(3.0)
    bow = (start @ robot.pose(base) @ (BOW, 0, 0, 1))[1]
    assert abs(bow - WALL) < RESOLUTION
    assert abs(robot.velocity(base)[0]) < 0.02
    robot.reset()
    assert robot.time == 0 and robot.pose(base)[0, 3] == 0


def test_a_box_that_falls_comes_to_rest_on_the_floor(boxes: Boxes, tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(
        '<mujoco><worldbody><body name="box" pos="-1.2 -1.2 1" euler="10 20 0"><freejoint/>'
        '<geom type="box" size="0.05 0.08 0.04" mass="0.3"/></body></worldbody></mujoco>'
    )
    robot = RobotModel(tmp_path / "box.xml", boxes, np.eye(4))
    robot.step(3.0)
    rest = robot.pose(1)[:3, 3].copy()
    assert abs(rest[2] - 0.04) < RESOLUTION / 2
    robot.step(2.0)
    assert np.linalg.norm(robot.pose(1)[:3, 3] - rest) < 1e-3


def test_the_same_commands_lead_to_the_same_states(boxes: Boxes) -> None:
    ends = []
    for _ in range(2):
        robot = RobotModel(ROBOTS / "mobile.xml", boxes, np.eye(4))
        robot.command("angular_z", 1.0)
        robot.step(1.0)
        ends.append(robot.data.qpos.copy())
    np.testing.assert_array_equal(*ends)


def test_a_state_that_is_none_is_told_and_reset_recovers(tmp_path: Path) -> None:
    nothing = Boxes(np.zeros((0, 3)), np.zeros((0, 3)))
    robot = RobotModel(ROBOTS / "mobile.xml", nothing, np.eye(4))
    robot.data.qvel[:] = np.nan
    with pytest.raises(BrokenState, match=r"the state is not finite after 0\.00 s"):
        robot.step(0.01)
    robot.reset()
    robot.step(0.01)
    assert np.isfinite(robot.data.qpos).all()
    with pytest.raises(ValueError, match="linear_x: nan is not finite"):
        robot.command("linear_x", np.nan)


def test_defaults_of_a_robot_s_file_are_not_the_map_s(tmp_path: Path) -> None:
    """Many files have geometries collide with nothing unless they say so."""
    (tmp_path / "ball.xml").write_text(
        '<mujoco><default><geom contype="0" conaffinity="0" group="2" type="mesh" margin="0.1"/>'
        '</default><worldbody><body pos="0 0 1"><freejoint/><geom type="sphere" size="0.1" '
        'contype="1" conaffinity="1" margin="0"/></body></worldbody></mujoco>'
    )
    floor = Boxes(np.array([[-5.0, -5, -1]]), np.array([[5.0, 5, 0]]))
    robot = RobotModel(tmp_path / "ball.xml", floor, np.eye(4))
    robot.step(2.0)
    assert robot.pose(1)[2, 3] == pytest.approx(0.1, abs=0.01)
    assert robot.model.geom_group.tolist() == [2, module.GROUP]


@pytest.mark.parametrize("name", ["mobile", "arm", "quadrotor"])
def test_own_robots_stay_where_they_are_without_commands(name: str) -> None:
    floor = Boxes(np.array([[-5.0, -5, -1]]), np.array([[5.0, 5, 0]]))
    robot = RobotModel(robot_file(name, ROBOTS), floor, np.eye(4))
    before = {body: robot.pose(body) for body, _, _ in robot.bodies()}
    robot.step(2.0)
    for body, pose in before.items():
        assert np.linalg.norm(robot.pose(body)[:3, 3] - pose[:3, 3]) < 0.02
    assert robot.model.ncam >= 2
    assert robot.travels is (name != "arm")


def test_files_that_are_no_robots_are_named(tmp_path: Path) -> None:
    nothing = Boxes(np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(InputError, match="robot 'no': expected arm, mobile, quadrotor, or an MJCF"):
        robot_file("no", ROBOTS)
    faults = {
        "no XML": "<mujoco",
        "no mesh": '<mujoco><asset><mesh name="a" file="away.stl"/></asset></mujoco>',
        "a name twice": '<mujoco><worldbody><camera name="eye"/><camera name="eye"/></worldbody>'
        "</mujoco>",
    }
    for fault, text in faults.items():
        path = tmp_path / f"{fault}.xml"
        path.write_text(text)
        with pytest.raises(InputError, match=f"{fault}.xml: ") as raised:
            RobotModel(path, nothing, np.eye(4))
        assert "\n" not in str(raised.value)


def test_an_object_named_like_a_body_of_the_robot_is_named(boxes: Boxes) -> None:
    for name in ("base_link", "world", module.BODY):
        with pytest.raises(InputError, match=f"^object {name}: the robot has a body of this name"):
            RobotModel(ROBOTS / "mobile.xml", boxes, np.eye(4), {name: boxes})


def test_convert_writes_what_mujoco_reads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "rooms.xml"
    arguments = ["rooms:20000", str(target), "--resolution", "0.1"]
    assert main(arguments) == 0
    assert "boxes of voxels of 0.1 m, up is 0.00 0.00 1.00" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path(str(target))
    assert model.ngeom > 50
    assert (model.geom_group == module.GROUP).all()
    assert model.site("map").pos.tolist() == [0, 0, 0]
    assert main(arguments) == 1
    assert "exists already" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*arguments[:3], "0"])
    assert "'0' is no voxel's edge in metres, 0.005 to 10" in capsys.readouterr().err
