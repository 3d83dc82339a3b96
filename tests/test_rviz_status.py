"""What goes wrong is a sentence in the Display's Status, and rviz2 goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rviz_harness import (
    TOP,
    Rviz,
    World,
    configuration,
    disc,
    display,
    map_display,
    needs_rviz,
    red,
)

pytestmark = needs_rviz
ROOT = Path(__file__).resolve().parents[1]


def test_bad_input_is_explained(rviz: Rviz, world: World, tmp_path: Path) -> None:
    from std_msgs.msg import String

    rviz.set("Map", "Topic", value="/nobody")
    rviz.until_status("Map", "Topic", "Warn", "Nobody publishes on /nobody")
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


def test_all_that_a_user_would_see_in_yellow_or_red_is_listed(rviz: Rviz, world: World) -> None:
    """A picture of the documentation shows none of it."""
    lost, grid = display("Nothing", "Lost"), display("Grid", "Grid")
    auto = {"Order Source": "Auto"}
    rviz.load(configuration(lost, grid, map_display(topic="/nobody", **auto)))
    world.place()
    rviz.until_status("Grid", "Transform", "Ok")
    nobody = rviz.until_status("Map", "Topic", "Warn", "Nobody publishes on /nobody")
    loading = "Lost: rviz could not load it"
    world.spin_until(lambda: rviz.complaints() == [loading, f"Map, Status: Warn, Topic: {nobody}"])
    rviz.set("Map", value=False)
    assert rviz.complaints() == [loading]
    rviz.load(configuration(grid, map_display(**auto)))
    world.map.replace(disc((1, 0, 0)))
    world.spin_until(lambda: rviz.status("Map").get("Map") and not rviz.complaints())


def request_picture(
    world: World,
    frame: str = "",
    topic: str = "/gaussians",
    order_timeout: float = 0.0,
    client: Any = None,
    projection: int = 0,
) -> Any:
    """The future of what the display answers to a camera that looks up from a metre below."""
    from rosplat_core.cameras import Camera
    from rosplat_msgs.srv import RenderView
    from rosplat_ros.view_cameras import view_camera

    below = np.eye(4)
    below[2, 3] = 1.0
    camera = view_camera(
        Camera(id=0, width=16, height=16, fx=16, fy=16, cx=8, cy=8, world_to_camera=below)
    )
    camera.header.frame_id, camera.projection = frame, projection
    client = client or world.node.create_client(RenderView, f"{topic}/render")
    world.spin_until(client.service_is_ready)
    return client.call_async(RenderView.Request(camera=camera, order_timeout=order_timeout))


def test_a_display_that_waits_for_a_sorter_says_so(rviz: Rviz, world: World) -> None:
    rviz.until_status("Map", "Sidecar", "Warn", "No sorter publishes /gaussians/order")
    rviz.set("Map", "Order Source", value="Auto")
    world.spin_until(lambda: "Sidecar" not in rviz.status("Map"))


def test_a_publisher_that_keeps_nothing_is_told_of(rviz: Rviz, world: World) -> None:
    """Who looks after its last batch waits for the next, and may wonder why."""
    from rosplat_msgs.msg import GaussianArray
    from rosplat_ros.qos import MAP_VOLATILE

    publisher = world.node.create_publisher(GaussianArray, "/forgetful", MAP_VOLATILE)
    rviz.set("Map", "Topic", value="/forgetful")
    rviz.until_status("Map", "Topic", "Warn", "volatile", "is lost")
    world.node.destroy_publisher(publisher)


def watch_views(world: World, views: list[Any]) -> None:
    """Lists the cameras that orders are asked for."""
    from rosplat_msgs.msg import ViewCamera
    from rosplat_ros.qos import VIEW

    world.node.create_subscription(ViewCamera, "/gaussians/view", views.append, VIEW)


def ask_for_picture(world: World, **request: Any) -> Any:
    """What the display answers to that."""
    picture = request_picture(world, **request)
    world.spin_until(picture.done)
    return picture.result()


def test_pictures_are_answered_whatever_is_seen(rviz: Rviz, world: World) -> None:
    """Before there is a map, and while nobody knows where it belongs: it is kept all the same."""
    answer = ask_for_picture(world)
    assert answer.success and not answer.map_complete
    world.map.replace(disc((1, 0, 0)))
    rviz.until_status("Map", "Transform", "Error", world.frame)
    for frame in ["", world.frame]:
        answer = ask_for_picture(world, frame=frame)
        assert answer.map_complete and answer.splats == 1
        color = np.frombuffer(answer.color.data, np.float32).reshape(16, 16, 4)
        assert color[8, 8, 0] > 0.9
    answer = ask_for_picture(world, frame="elsewhere")
    assert not answer.success and "elsewhere" in answer.message
    assert not red(rviz.picture()).any()
    world.place()
    rviz.until(lambda s: red(s).any())


def test_pictures_wait_for_no_sidecar_where_the_display_sorts(rviz: Rviz, world: World) -> None:
    world.map.replace(disc((1, 0, 0)))
    rviz.until_status("Map", "Map", "Ok", "1 splats")
    for source, sorter in [("Auto", "processor"), ("Off", "unsorted")]:
        rviz.set("Map", "Order Source", value=source)
        answer = ask_for_picture(world, order_timeout=60.0)  # longer than this waits
        assert answer.order_source == sorter
    rviz.set("Map", "Order Source", value="Sidecar")
    assert ask_for_picture(world, order_timeout=0.1).order_source == "processor"


def test_pictures_are_drawn_by_a_display_that_is_told_to(rviz: Rviz, world: World) -> None:
    from rosplat_msgs.srv import RenderView

    views: list[Any] = []
    watch_views(world, views)
    service = world.node.create_client(RenderView, "/gaussians/render")
    as_it_comes = "{Class: rviz_gaussian_plugin/GaussianMap, Name: Map, Enabled: true, Value: true}"
    rviz.load(configuration(f"    - {as_it_comes}\n"))
    rviz.set("Map", "Order Source", value="Sidecar")  # of which there is none
    rviz.set("Map", "Topic", value="/gaussians")
    world.map.replace(disc((1, 0, 0)))
    rviz.until_status("Map", "Map", "Ok", "1 splats")
    for _ in range(2):
        world.spin_until(lambda: not service.service_is_ready())
        rviz.set("Map", "Render Service", value=True)
        picture = request_picture(world, order_timeout=60.0)
        world.spin_until(lambda: any(view.width == 16 for view in views))
        rviz.set("Map", "Render Service", value=False)
        world.spin_until(picture.done)
        assert "turned off" in picture.result().message
        views.clear()
    world.spin_until(lambda: not service.service_is_ready())
    rviz.set("Map", "Render Service", value=True)
    assert ask_for_picture(world).success
    assert "rviz draws no panorama, the viewer" in ask_for_picture(world, projection=2).message
    assert ask_for_picture(world, projection=7).message == "projection is 7, known are 0 and 1"


def test_clients_that_ask_for_pictures_take_turns(rviz: Rviz, world: World) -> None:
    """One that asks for many, and lets each wait for a sorter that isn't there, holds up nobody."""
    from rosplat_msgs.srv import RenderView

    world.map.replace(disc((1, 0, 0)))
    rviz.until_status("Map", "Map", "Ok", "1 splats")
    client = world.node.create_client(RenderView, "/gaussians/render")
    many = [request_picture(world, client=client, order_timeout=60.0) for _ in range(3)]
    assert ask_for_picture(world, order_timeout=60.0).success
    assert not many[-1].done()


def test_what_waits_for_a_picture_is_told_when_the_display_is_removed(
    rviz: Rviz, world: World
) -> None:
    views: list[Any] = []
    watch_views(world, views)

    def told() -> bool:
        rviz.load(configuration(map_display(**{"Order Source": "Sidecar"})))
        rviz.until_status("Map", "Map", "Ok", "1 splats")
        views.clear()
        picture = request_picture(world, order_timeout=60.0)
        world.spin_until(lambda: any(view.width == 16 for view in views))
        rviz.ask("remove", path=["Map"])
        world.spin_until(picture.done)
        return "removed" in picture.result().message

    world.map.replace(disc((1, 0, 0)))
    # A service that ended before the middleware had sent took one answer in ten along.
    assert all(told() for _ in range(20))


def test_a_refused_batch_is_said_until_a_good_one_comes(tmp_path: Path, world: World) -> None:
    """In the log, too, before a simulated clock begins."""
    from rosplat_msgs.msg import GaussianArray
    from rosplat_ros.qos import MAP

    simulated = ["--ros-args", "-p", "use_sim_time:=true"]
    rviz = Rviz(tmp_path, *simulated, config=configuration(map_display()))
    try:
        publisher = world.node.create_publisher(GaussianArray, "gaussians", MAP)
        world.spin_until(publisher.get_subscription_count)
        publisher.publish(GaussianArray(map_id="broken", revision=1, count=1_000_000))
        rviz.until_status("Map", "Topic", "Error", "1 refused", "because")
        assert "a batch is refused" in rviz.processes.said("rviz2")
        world.map.replace(disc((1, 0, 0)))
        rviz.until_status("Map", "Topic", "Ok", "received, 1 refused")
    finally:
        rviz.close()


def test_where_pictures_fail_is_told_while_it_lasts(rviz: Rviz, world: World) -> None:
    def silent() -> None:
        world.spin_until(lambda: "Accuracy" not in rviz.status("Map"))

    world.place()
    world.map.replace(disc((1, 0, 0)))
    rviz.until(lambda s: red(s).any())
    rviz.until_status("Map", "Frame", "Ok")
    silent()
    millimetre = np.full((1, 3), 0.001, np.float32)  # a tenth of a pixel
    world.map.replace(replace(disc((1, 0, 0)), scales=millimetre))
    rviz.until_status("Map", "Accuracy", "Warn", "smaller than a pixel", "EWA Antialiased")
    rviz.set("Map", "Model", value="EWA Antialiased")
    silent()
    world.map.replace(disc((1, 0, 0), x=1e6, sigma=0.1))
    rviz.until_status("Map", "Accuracy", "Warn", "relative to an origin")
    world.map.replace(disc((1, 0, 0)))
    silent()
    world.place(1e6)
    rviz.load(configuration(map_display(), view=TOP.replace("X: 0", "X: 1000000")))
    rviz.until_status("Map", "Accuracy", "Warn", "Fixed Frame")


def test_detail_draws_less_and_says_so(rviz: Rviz, world: World) -> None:
    from rosplat_core.generated import generate

    world.place()
    rviz.load(configuration(map_display(**{"Order Source": "Auto"}), view=TOP.replace("100", "20")))
    world.map.replace(generate(20000))
    rviz.set("Map", "Detail", value="8 px")
    text = rviz.until_status("Map", "Detail", "Ok", "of 20000 splats drawn", "to 8.0 px")
    assert 0 < int(text.split()[0]) < 10000
    rviz.set("Map", "Detail", value="5000")
    rviz.until_status("Map", "Detail", "Ok", "of 20000 splats drawn", "px")
    rviz.set("Map", "Detail", value="some")
    rviz.until_status("Map", "Detail", "Error", "'some'", "expected full")


def test_old_opengl_serves_the_processor_alone(tmp_path: Path, world: World) -> None:
    old = World(frame=world.frame, namespace="old")  # the other rviz2 answers for /gaussians
    rviz = Rviz(
        tmp_path,
        config=configuration(map_display(topic="/old/gaussians")),
        MESA_GL_VERSION_OVERRIDE="3.0COMPAT",
    )
    try:
        old.place()
        old.map.replace(disc((1, 0, 0)))
        rviz.until(lambda s: red(s).sum() > 3000)
        assert ask_for_picture(old, topic="/old/gaussians").success
        rviz.set("Map", "Rasterizer", value="Tiles")
        rviz.until_status(
            "Map", "OpenGL", "Error", "the rasterizer wasn't changed", "OpenGL 4.4 is needed", "3.0"
        )
        # Who drew the map so far goes on.
        assert ask_for_picture(old, topic="/old/gaussians").success
        rviz.set("Map", "Rasterizer", value="Auto")
        rviz.until(lambda s: red(s).sum() > 3000)
        assert ask_for_picture(old, topic="/old/gaussians").success
        assert rviz.quit() == 0
    finally:
        rviz.close()
        old.close()


def test_tiles_without_a_card_are_refused_before_rviz_stands_still(
    tmp_path: Path, world: World
) -> None:
    """Unless the user has told Mesa to draw by the processor, as the other tests have."""
    rviz = Rviz(tmp_path, config=configuration(map_display()), LIBGL_ALWAYS_SOFTWARE="")
    try:
        world.place()
        world.map.replace(disc((1, 0, 0)))
        rviz.until(lambda s: red(s).any())
        if "processor" not in rviz.until_status("Map", "Frame", "Ok"):
            pytest.skip("a graphics card draws")
        rviz.set("Map", "Rasterizer", value="Tiles")
        rviz.until_status("Map", "OpenGL", "Warn", "the processor does", "set Rasterizer to Auto")
        rviz.until_status("Map", "Frame", "Ok", "processor")
        rviz.set("Map", "Rasterizer", value="Auto")
        world.spin_until(lambda: "OpenGL" not in rviz.status("Map"))
    finally:
        rviz.close()


def test_diagnostics_have_the_worst_line_and_figures(rviz: Rviz, world: World) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    heard: list[DiagnosticStatus] = []
    world.node.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda array: heard.extend(s for s in array.status if "rviz" in s.name),
        10,
    )
    rviz.set("Map", "Topic", value="/nobody")
    rviz.until_status("Map", "Topic", "Warn", "Nobody publishes on /nobody")
    world.spin_until(lambda: any(s.message.startswith("Topic: Nobody") for s in heard))
    assert {s.level for s in heard if "Nobody" in s.message} == {DiagnosticStatus.WARN}
    rviz.set("Map", "Topic", value="/gaussians")
    rviz.set("Map", "Order Source", value="Auto")
    world.map.replace(disc((1, 0, 0)))
    world.place()
    rviz.until(lambda s: red(s).any())

    def figures() -> dict[str, str]:
        return {value.key: value.value for value in heard[-1].values}

    # A status from before the first frame may come after it.
    world.spin_until(
        lambda: heard[-1].level == DiagnosticStatus.OK and figures().get("Views") == "1"
    )
    assert heard[-1].name.endswith(": /gaussians")
    values = figures()
    section = (ROOT / "docs/reference.md").read_text().partition("## Diagnostics")[2]
    assert all(word in section for word in values)
    assert int(values["Splats"]) == len(world.map)
    assert values["Map"] == world.map.map_id
    assert int(values["Memory (bytes)"]) > 1e7
