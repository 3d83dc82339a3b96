"""A lifecycle node that publishes a map while it is configured, as in docs/guides/publish.md."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

from rosplat_core.splats import Splats
from rosplat_ros.map_publisher import MapPublisher
from rosplat_testing import Listener


class Slam(LifecycleNode):
    """Its map has one splat more each time that it is configured."""

    def __init__(self, node: Node, random_splats: Callable[[int], Splats]) -> None:
        super().__init__("slam", namespace=node.get_namespace(), context=node.context)
        self._random_splats, self.splats = random_splats, 0

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.splats += 1
        self.map = MapPublisher(self)
        self.map.replace(self._random_splats(self.splats))
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.map.close()
        return TransitionCallbackReturn.SUCCESS


def test_each_configuration_is_a_map_of_one_publisher(
    node: Node, listener: Listener, random_splats: Callable[[int], Splats]
) -> None:
    slam = Slam(node, random_splats)
    topic = node.resolve_topic_name("gaussians")
    maps = []
    for _ in range(3):
        assert slam.trigger_configure() == TransitionCallbackReturn.SUCCESS
        maps.append(slam.map.map_id)
        listener.wait_for(slam.splats)
        assert node.count_publishers(topic) == 1
        assert slam.trigger_cleanup() == TransitionCallbackReturn.SUCCESS
        listener.wait(lambda: not node.count_publishers(topic))
        listener.wait(lambda: not node.count_services(f"{topic}/pull"))
    # None came back after another had replaced it.
    heard = list(dict.fromkeys(batch.map_id for batch in listener.batches))
    assert [batch.map_id for batch in listener.batches] == maps == heard
    slam.destroy_node()
