"""Run as a program: rebuilds a map from its topic until a revision, and writes down what came.

receive_map.py TOPIC REVISION OUT.npz: prints "listening" when it does. OUT.npz holds slots and the
arrays of their splats, the revision and operation of each batch, and whether it was pulled.
"""

import sys
import time

import numpy as np
import rclpy

from rosplat_core.maps import Arrival
from rosplat_msgs.msg import GaussianArray
from rosplat_ros.map_receiver import MapReceiver
from rosplat_testing.slot_map import SlotMap, apply

TIMEOUT = 100.0

topic, last_revision, out = sys.argv[1], int(sys.argv[2]), sys.argv[3]
batches: list[tuple[int, int, bool]] = []
built = SlotMap()


def receive(message: GaussianArray, arrival: Arrival) -> None:
    batches.append((message.revision, message.operation, arrival != Arrival.HEARD))
    apply(message, built)


rclpy.init()
node = rclpy.create_node("receiver", cli_args=["--ros-args", "-r", f"gaussians:={topic}"])
heard = MapReceiver(node, receive)
while not node.get_publishers_info_by_topic(topic):
    time.sleep(0.01)
print("listening", flush=True)
deadline = time.monotonic() + TIMEOUT
while (
    not batches or batches[-1][0] < last_revision or heard.pulling
) and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.1)
slots, splats = built.snapshot()
np.savez(
    out,
    slots=slots,
    positions=splats.positions + splats.origin,
    orientations=splats.orientations,
    scales=splats.scales,
    opacities=splats.opacities,
    sh=splats.without_empty_bands().sh,
    revisions=[revision for revision, _, _ in batches],
    operations=[operation for _, operation, _ in batches],
    pulled=[pulled for _, _, pulled in batches],
)
rclpy.shutdown()
