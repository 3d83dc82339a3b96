"""What goes wrong is a sentence in the Display's Status, and rviz2 goes on."""

from __future__ import annotations

from pathlib import Path

from rviz_harness import Rviz, World, configuration, disc, map_display, needs_rviz, red

pytestmark = needs_rviz


def test_bad_input_is_explained(rviz: Rviz, world: World, tmp_path: Path) -> None:
    from std_msgs.msg import String

    rviz.set("Map", "Topic", value="/nobody")
    rviz.until_status("Map", "Topic", "Warn", "Nobody publishes")
    rviz.set("Map", "Topic", value="")
    rviz.until_status("Map", "Topic", "Warn", "No topic set")
    rviz.set("Map", "Topic", value="no topic/at all")
    rviz.until_status("Map", "Topic", "Error", "no topic/at all")
    strings = world.node.create_publisher(String, "/strings", 1)
    rviz.set("Map", "Topic", value="/strings")
    rviz.until_status(
        "Map", "Topic", "Error", "std_msgs/msg/String", "rosplat_msgs/msg/GaussianArray"
    )
    world.node.destroy_publisher(strings)
    rviz.set("Map", "Topic", value="/empty")
    for path, reason in [
        ("/nowhere/scene.ply", "No such file"),
        (str(Path(__file__)), "not a scene"),
    ]:
        rviz.set("Map", "Scene File", value=path)
        rviz.until_status("Map", "Scene File", "Error", path, reason)
    rviz.set("Map", "Scene File", value="")
    rviz.set("Map", "Topic", value="/gaussians")

    world.map.replace(disc((1, 0, 0)))
    rviz.until_status("Map", "Transform", "Error", world.frame, "map")
    assert not red(rviz.picture()).any()
    world.place()
    rviz.until(lambda s: red(s).any())
    rviz.until_status("Map", "Transform", "Ok")
    rviz.until_status("Map", "Topic", "Ok")
    assert rviz.status("Map").get("Scene File", ("Ok", ""))[0] == "Ok"


def test_opengl_that_is_too_old(tmp_path: Path, world: World) -> None:
    world.place()
    world.map.replace(disc((1, 0, 0)))
    rviz = Rviz(tmp_path, config=configuration(map_display()), MESA_GL_VERSION_OVERRIDE="3.3COMPAT")
    try:
        rviz.until_status("Map", "OpenGL", "Error", "OpenGL 4.4 is needed", "3.3", "driver")
        rviz.set("Map", value=False)
        rviz.set("Map", value=True)
        rviz.until_status("Map", "OpenGL", "Error", "OpenGL 4.4 is needed")
        assert not red(rviz.picture()).any()
        assert rviz.quit() == 0
    finally:
        rviz.close()
