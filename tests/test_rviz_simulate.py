"""A simulated robot in a real rviz2, by the configuration that is shipped."""

from __future__ import annotations

from pathlib import Path

import pytest

from rviz_harness import Rviz, World, needs_rviz

pytestmark = needs_rviz


def test_the_robot_is_in_sight_after_a_reset_too(tmp_path: Path, world: World) -> None:
    """rviz2 forgets all markers when simulated time goes back."""
    pytest.importorskip("mujoco", reason="no mujoco here (PyPI)")
    from ament_index_python.packages import get_package_share_directory
    from std_srvs.srv import Trigger

    from rosplat_core.generated import generate

    share = Path(get_package_share_directory("rviz_gaussian_plugin"))
    rviz = Rviz(
        tmp_path, "--ros-args", "-p", "use_sim_time:=true",
        config=(share / "config/simulate.rviz").read_text(),
    )  # fmt: skip
    try:
        rviz.processes.node(
            "rosplat_tools", "simulate", "--ros-args", "-p", "start:=[-1.2,-1.2,0.0]",
            "-p", "resolution:=0.1",
        )  # fmt: skip
        world.place()
        world.map.replace(generate(60_000, scene="rooms"))

        def in_sight() -> bool:
            return "Namespaces/robot" in rviz.properties("Robot")

        world.spin_until(in_sight)
        world.spin_until(lambda: not rviz.complaints())
        reset = world.node.create_client(Trigger, "/simulate/reset")
        answer = reset.call_async(Trigger.Request())
        world.spin_until(lambda: answer.done() and not in_sight())
        world.spin_until(lambda: in_sight() and not rviz.complaints())
    finally:
        rviz.close()
