"""The node over real DDS."""

import fcntl
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
import uuid
from copy import copy
from pathlib import Path

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from rosplat_msgs.msg import GaussianArray, SplatOrder, ViewCamera
from rosplat_msgs.srv import PullMap
from rosplat_ros import qos
from rosplat_ros.program.said_once import Throttled
from rosplat_sorter import shared_orders
from rosplat_sorter.node import SorterNode
from rosplat_sorter.order_slots import OrderError, OrderReader
from rosplat_sorter.shared_orders import FOLDER

EXECUTABLE = Path(get_package_prefix("rosplat_sorter"), "lib", "rosplat_sorter", "sorter")
PATIENCE = 180.0  # with programs, however busy the machine is [s]


class Peer:
    """A publisher of maps and a viewer."""

    def __init__(self, map_qos=qos.MAP):
        self.node = rclpy.create_node("peer")
        self.orders = []
        self.reader = OrderReader()
        self._map = self.node.create_publisher(GaussianArray, "gaussians", map_qos)
        self._view = self.node.create_publisher(ViewCamera, "gaussians/view", qos.VIEW)
        self.node.create_subscription(SplatOrder, "gaussians/order", self.orders.append, qos.ORDER)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def edit(self, message):
        self._map.publish(message)

    def look(self, message):
        self._view.publish(message)

    def wait(self, condition, what):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, what
            self._executor.spin_once(timeout_sec=0.05)

    def meet(self):
        """Waits for the sorter, and has it hear the map."""
        self.wait(
            lambda: (
                self._view.get_subscription_count()
                and self.node.count_publishers("gaussians/order")
            ),
            "no sorter",
        )
        self.look(ViewCamera(view_id="wakes", sequence=1))  # of which no order can be made
        self.wait(self._map.get_subscription_count, "no subscription")

    def order(self, sequence, revision=1):
        """The order that answers a sequence with a revision of the map."""

        def matching():
            return [o for o in self.orders if (o.sequence, o.revision) == (sequence, revision)]

        self.wait(matching, f"no order for sequence {sequence}, revision {revision}")
        return matching()[-1]

    def answer(self, view_id, sequence):
        """The last order that answers a view's sequence."""

        def matching():
            return [o for o in self.orders if (o.view_id, o.sequence) == (view_id, sequence)]

        self.wait(matching, f"no order for sequence {sequence} of {view_id}")
        return matching()[-1]

    def listen(self, seconds):
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.02)

    def slots(self, sequence, revision=1):
        """Those of that order, as a list."""
        return self.reader.read(self.order(sequence, revision)).tolist()

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()


@pytest.fixture
def ros():
    """A namespace of its own, away from other nodes of this machine."""
    name = f"/test_{os.getpid()}_{time.monotonic_ns()}"
    rclpy.init(args=["--ros-args", "-r", f"__ns:={name}"])
    yield name
    rclpy.try_shutdown()


@pytest.fixture
def sorter(ros):
    node = SorterNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    yield node
    executor.shutdown()
    thread.join()
    node.destroy_node()


@pytest.fixture
def peer(sorter):
    peer = Peer()
    peer.meet()
    yield peer
    peer.close()


def test_a_map_is_ordered_as_it_changes(peer, make_batch, make_look):
    peer.edit(make_batch(4, operation=GaussianArray.REPLACE))
    look = make_look(sequence=3)
    look.header.stamp.sec = 17
    peer.look(look)
    order = peer.order(3)
    assert peer.reader.read(order).tolist() == [3, 2, 1, 0]
    assert (order.header.stamp.sec, order.header.frame_id) == (17, "map")
    assert (order.view_id, order.map_id) == ("view", "map")
    assert order.backend and order.sort_time > 0
    peer.edit(make_batch(1, revision=2, first_slot=9, positions=[0.0, 0.0, 1.5]))
    assert peer.slots(3, 2) == [3, 2, 1, 9, 0]
    peer.edit(make_batch(2, revision=3, operation=GaussianArray.DELETE, slots=[0, 3]))
    assert peer.slots(3, 3) == [2, 1, 9]
    peer.edit(make_batch(2, map_id="other"))
    peer.look(make_look(sequence=4))
    peer.wait(lambda: peer.orders[-1].map_id == "other", "the new map")
    assert peer.reader.read(peer.orders[-1]).tolist() == [1, 0]


def test_it_hears_the_map_only_while_views_want_orders(ros, make_batch, make_look, tmp_path):
    """Then its process begins anew, as it was set."""
    program = tmp_path / "sorter.py"
    program.write_text("from rosplat_sorter import node\nnode.FORGET_AFTER = 1\nnode.main()\n")
    process = subprocess.Popen(
        [sys.executable, program, "--ros-args", "-r", f"__ns:={ros}", "-p", "backend:=native"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    peer = Peer()

    def hears():
        return peer.node.count_subscribers("gaussians")

    try:
        peer.edit(make_batch(3, operation=GaussianArray.REPLACE))
        settings = peer.node.create_client(SetParameters, "sorter/set_parameters")
        peer.wait(settings.service_is_ready, "no sorter")
        backend = Parameter("backend", value="numpy").to_parameter_msg()
        settings.call_async(SetParameters.Request(parameters=[backend]))
        files = []
        for sequence in (1, 2):
            peer.wait(peer._view.get_subscription_count, "no sorter")
            files.append(len(list(Path(f"/proc/{process.pid}/fd").iterdir())))
            peer.look(make_look(sequence=0))  # no order is wanted
            peer.listen(0.3)
            assert not hears()
            peer.meet()
            peer.look(make_look(sequence=sequence))
            assert peer.order(sequence).backend == "numpy"
            peer.wait(lambda: not hears(), "it hears the map for ever")
        peer.meet()
        assert files[1] - files[0] < 3  # as many as Fast DDS leaves open each time
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=20)
        peer.close()
    assert process.returncode == 0
    assert output.count("waits for a view") == 3
    assert output.count("forgotten") == 2
    assert "Traceback" not in output


def test_the_map_is_pulled_though_nothing_is_heard(sorter, ros, make_batch, make_look):
    """Of two servers: one has no map, and is the first to answer."""
    peer, asked = Peer(qos.MAP_VOLATILE), []

    def serve(request, response):
        asked.append((request.map_id, request.after_revision, request.first_block))
        time.sleep(0.2)
        response.batches = [make_batch(3, revision=7, operation=GaussianArray.REPLACE)]
        return response

    other = Peer(qos.MAP_VOLATILE)
    try:
        peer.node.create_service(PullMap, "gaussians/pull", serve)
        other.node.create_service(PullMap, "gaussians/pull", lambda _, response: response)
        threading.Thread(target=other._executor.spin).start()
        peer.meet()
        peer.look(make_look())
        assert peer.slots(1, revision=7) == [2, 1, 0]
        assert asked == [("", 0, 0)]
    finally:
        other.close()
        peer.close()


@pytest.mark.parametrize("beside", ["nobody", "a client of pulls that nobody serves"])
def test_a_sorter_that_joins_late_gets_the_latched_map(ros, beside, make_batch, make_look):
    peer = Peer()
    if beside != "nobody":
        peer.node.create_client(PullMap, "gaussians/pull")
    peer.edit(make_batch(2, operation=GaussianArray.REPLACE))
    peer.edit(make_batch(2, revision=2, first_slot=2))
    process = subprocess.Popen(
        [EXECUTABLE, "--ros-args", "-r", f"__ns:={ros}", "-p", "backend:=numpy"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        peer.meet()
        peer.look(make_look())
        order = peer.order(1, revision=2)
        assert peer.reader.read(order).tolist() == [3, 1, 2, 0]
        assert order.backend == "numpy"
        for number in range(5):  # as two publishers that clear each other's map
            peer.edit(make_batch(2, revision=3, map_id=f"other {number}"))
        peer.wait(lambda: peer.orders[-1].map_id == "other 4", "the last map")
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)
        peer.close()
    assert "sorting with numpy" in output
    assert output.count("begins") == 1
    assert "splats in view, sorted in" in output
    assert "Traceback" not in output


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_in_silence(ros, stop):
    process = subprocess.Popen(
        [EXECUTABLE, "--ros-args", "-r", f"__ns:={ros}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    for line in process.stdout:
        if "waits for a view" in line:
            break
    process.send_signal(stop)
    output, _ = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in output
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("parameter", "reason"),
    [
        ("backend:=nonsense", "backend: expected one of auto, cupy, torch, native, numpy, got 'no"),
        ("backend:=3", "backend: expected one of auto, cupy, torch, native, numpy, got '3'"),
        ("threads:=-1", "(-1)"),
        ("threads:=x", "threads: 'x' is no whole number"),
        ("qos_overrides./gaussians/view.subscription.reliability:=x", "`reliability`: `x`"),
    ],
)
def test_a_parameter_that_makes_no_sense_is_one_line_and_code_1(parameter, reason):
    command = [EXECUTABLE, "--ros-args", "-p", parameter]
    ended = subprocess.run(command, timeout=PATIENCE, check=False, capture_output=True, text=True)
    assert ended.returncode == 1
    (line,) = ended.stderr.splitlines()
    assert line.startswith("sorter: ")
    assert reason in line


def test_where_ros_can_t_begin_a_line_says_why():
    ended = subprocess.run(
        [EXECUTABLE], timeout=PATIENCE, check=False, capture_output=True, text=True,
        env=os.environ | {"ROS_DOMAIN_ID": "abc"},
    )  # fmt: skip
    assert ended.returncode == 1
    (line,) = ended.stderr.splitlines()
    assert line.startswith("sorter: ")
    assert "ROS_DOMAIN_ID is not an integral number" in line


@pytest.mark.parametrize("malformed", [("-p", "backend"), ("-r", "a"), ("--no-such-option",)])
def test_malformed_ros_arguments_are_a_matter_of_usage(malformed):
    command = [EXECUTABLE, "--ros-args", *malformed]
    ended = subprocess.run(command, timeout=PATIENCE, check=False, capture_output=True, text=True)
    assert ended.returncode == 2
    usage, reason = ended.stderr.splitlines()
    assert usage.startswith("usage: sorter")
    assert reason.startswith("sorter: error: --ros-args: ")
    assert malformed[-1] in reason


def test_of_a_burst_of_views_the_last_is_answered(peer, make_batch, make_look):
    peer.edit(make_batch())
    for sequence in range(1, 101):
        peer.look(make_look(sequence=sequence, x=0.001 * sequence))
    peer.order(100)


def test_views_shown_at_once_are_all_answered(peer, make_batch, make_look):
    peer.edit(make_batch())
    views = [f"view {number}" for number in range(8)]
    for sequence in range(1, 6):
        for view in views:
            peer.look(make_look(view, sequence, x=0.001 * sequence))
        for view in views:
            peer.answer(view, sequence)


def test_a_publisher_that_does_not_latch_is_received(sorter, make_batch, make_look):
    peer = Peer(qos.MAP_VOLATILE)
    try:
        peer.meet()  # the volatile subscription comes within a second
        peer.edit(make_batch(2))
        peer.look(make_look())
        assert peer.slots(1) == [1, 0]
    finally:
        peer.close()


def test_a_best_effort_publisher_is_received(sorter, make_batch, make_look):
    """Whether it was there before the sorter heard of the map, or comes in place of another."""
    best_effort = copy(qos.MAP_VOLATILE)
    best_effort.reliability = ReliabilityPolicy.BEST_EFFORT
    for revision, map_qos in enumerate((best_effort, qos.MAP, best_effort), start=1):
        peer = Peer(map_qos)
        try:
            peer.meet()
            peer.edit(make_batch(2, revision=revision, map_id=f"map {revision}", operation=0))
            peer.look(make_look(sequence=revision))
            assert peer.slots(revision, revision) == [1, 0]
        finally:
            peer.close()


def test_qos_overrides_are_parameters_and_outlive_what_adapts(make_batch, make_look):
    name = f"/test_{uuid.uuid4().hex}"
    wanted = {"gaussians": "subscription", "gaussians/view": "subscription"}
    wanted["gaussians/order"] = "publisher"
    words = ["--ros-args", "-r", f"__ns:={name}"]
    for topic, kind in wanted.items():
        words += ["-p", f"qos_overrides.{name}/{topic}.{kind}.reliability:=best_effort"]
        words += ["-p", f"qos_overrides.{name}/{topic}.{kind}.depth:=3"]
    rclpy.init(args=words)
    sorter, peer = SorterNode(), rclpy.create_node("peer")
    executor = SingleThreadedExecutor()
    executor.add_node(sorter)

    def found():
        """What the sorter has on the three topics."""
        return [
            info.qos_profile
            for topic, kind in wanted.items()
            for info in getattr(peer, f"get_{kind}s_info_by_topic")(f"{name}/{topic}")
            if info.node_name == "sorter"
        ]

    try:
        sorter._on_view(make_look())
        adapts = sorter._map.receiver
        peer.create_publisher(GaussianArray, f"{name}/gaussians", qos.MAP_VOLATILE)
        deadline = time.monotonic() + PATIENCE
        while adapts._qos[1] or len(found()) < 3:
            assert time.monotonic() < deadline
            executor.spin_once(0.1)
        assert {each.reliability for each in found()} == {ReliabilityPolicy.BEST_EFFORT}
        assert adapts._subscription.qos_profile.depth == 3
        assert adapts._subscription.qos_profile.durability == DurabilityPolicy.VOLATILE
        assert (qos.MAP.depth, qos.VIEW.depth, qos.ORDER.depth) == (1000, 32, 8)
    finally:
        executor.shutdown()
        sorter.destroy_node()
        rclpy.shutdown()


@pytest.mark.parametrize("policy", ["volatile", "best effort"])
def test_a_lesser_publisher_beside_another_is_told_of(sorter, peer, capfd, policy):
    """One subscription can't hear both."""
    lesser = copy(qos.MAP_VOLATILE)
    if policy == "best effort":
        lesser = copy(qos.MAP)
        lesser.reliability = ReliabilityPolicy.BEST_EFFORT
    silent = Peer(lesser)
    said = []

    def told():
        said.append(capfd.readouterr().err)
        return f"a publisher is {policy}" in "".join(said)

    try:
        peer.wait(told, "no warning")
    finally:
        silent.close()


def test_publishers_that_clear_each_other_s_map_are_told_of(sorter, peer, make_batch, capfd):
    other, said, revision = Peer(), [], 0

    def told():
        nonlocal revision
        revision += 1
        peer.edit(make_batch(2, revision=revision, map_id="mine"))
        other.edit(make_batch(2, revision=revision, map_id="yours"))
        said.append(capfd.readouterr().err)
        return "publishers clear each other's map: end all but one" in "".join(said)

    try:
        other.meet()
        peer.wait(told, "no warning")
    finally:
        other.close()


def test_garbage_does_not_stop_it(sorter, peer, make_batch, make_look, monkeypatch):
    nan, inf = float("nan"), float("inf")
    warnings = []
    monkeypatch.setattr(Throttled, "warn", lambda _, *line: warnings.append(line))
    peer.edit(make_batch(3))
    for revision, wrong in enumerate(
        (
            {"positions": [0.0]},
            {"sh_degree": 200, "sh": []},
            {"operation": 99},
            {"format": "zip"},
            {"slots": [2**32 - 1] * 3},
            {"first_slot": 2**32 - 1},
            {"revision": 0},
            {"map_id": "", "revision": 0},
        ),
        start=2,
    ):
        peer.edit(make_batch(3, **({"revision": revision} | wrong)))
    peer.edit(make_batch(3, revision=8, positions=[nan] * 9, scales=[-inf] * 9, first_slot=3))
    peer.wait(lambda: warnings and warnings[-1][0] == "splats", "no word of splats with NaN")
    subjects = [
        subject for subject, _ in warnings if subject != "view"
    ]  # of the view that wakes it
    assert subjects == ["batch"] * 8 + ["gap", "splats"]
    for wrong, reason in (
        ({"fx": nan}, "fx"),
        ({"width": 0}, "width"),
        ({"near_clip": inf}, "near_clip"),
        ({"frame_id": "elsewhere"}, "elsewhere"),
        ({"projection": 9}, "projection"),
        ({"view_id": "", "cx": 1e308}, "cx"),
    ):
        warnings.clear()
        peer.look(make_look(**wrong))  # the next would take its place before it has arrived
        peer.wait(lambda: warnings, f"{wrong} was not dropped")
        ((subject, text),) = warnings
        assert subject == "view"
        assert reason in text
    peer.edit(make_batch(3, revision=9, operation=GaussianArray.REPLACE))
    peer.look(make_look(sequence=5))
    assert peer.slots(5, 9) == [2, 1, 0]


@pytest.fixture(params=["Humble", "Iron and later"])
def release(request, monkeypatch):
    """Up to Humble, a node is asked of parameters that are to be set, and not told of any."""
    if request.param == "Humble":
        monkeypatch.delattr(Node, "add_post_set_parameters_callback")


def test_the_backend_is_a_parameter_that_can_change(release, sorter, peer, make_batch, make_look):
    [result] = sorter.set_parameters([Parameter("backend", value="no such")])
    assert not result.successful
    assert result.reason.startswith("unknown backend 'no such', known are auto, cupy")
    [result] = sorter.set_parameters([Parameter("backend", value="numpy")])
    assert result.successful
    peer.edit(make_batch())
    peer.look(make_look())
    assert peer.order(1).backend == "numpy"
    [result] = sorter.set_parameters([Parameter("threads", value=-1)])
    assert not result.successful


def test_a_parameter_that_another_refuses_has_no_effect(sorter, peer, make_batch, make_look):
    refusal = SetParametersResult(successful=False)
    sorter._on_set_parameters_callbacks.append(lambda _: refusal)  # asked last
    peer.edit(make_batch())
    peer.look(make_look())
    before = peer.order(1).backend
    other = next(name for name in ("numpy", "native") if name != before)
    [result] = sorter.set_parameters([Parameter("backend", value=other)])
    assert not result.successful
    peer.edit(make_batch(revision=2))
    assert peer.order(1, 2).backend == before


def test_remapping_the_map_takes_views_and_orders_along(make_look):
    rclpy.init(args=["--ros-args", "-r", "gaussians:=/slam/map"])
    node = SorterNode()
    try:
        assert "/slam/map/view" in {heard.topic_name for heard in node.subscriptions}
        node._on_view(make_look())
        assert "/slam/map" in {heard.topic_name for heard in node.subscriptions}
        assert "/slam/map/pull" in {client.srv_name for client in node.clients}
        assert "/slam/map/order" in {publisher.topic_name for publisher in node.publishers}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_viewers_here_and_elsewhere_each_get_their_orders(peer, make_batch, make_look):
    """One reads the sorter's shared memory, one can't: it never shows the key."""
    peer.edit(make_batch(3, operation=GaussianArray.REPLACE))
    here, elsewhere = OrderReader(), OrderReader()
    for sequence in range(1, 6):
        peer.look(make_look("here", sequence, x=0.01 * sequence, segment_key=here.key))
        assert here.read(peer.answer("here", sequence)).tolist() == [2, 1, 0]
        peer.look(make_look("elsewhere", sequence, x=0.02 * sequence))
        packed = peer.answer("elsewhere", sequence)
        assert elsewhere.read(packed).tolist() == [2, 1, 0]
        assert packed.encoding == SplatOrder.PACKED
    assert peer.answer("here", 5).encoding == SplatOrder.SHARED


def plainly(message):
    """The slots of an order, read by nothing but the words of SplatOrder.msg; and the key."""
    slots, key = [], 0
    if message.segment:
        assert re.fullmatch("rosplat_order_[a-z0-9_]{0,64}", message.segment)
        file = Path("/dev/shm", message.segment).read_bytes()
        magic, version, zero, key, generation = struct.unpack_from("=8sIIQQ", file)
        assert (magic, version, zero) == (b"ROSPLAT\0", 1, 0)
        assert key != 0
    if message.encoding == 0:
        slots = list(message.slots)
    elif message.encoding == 1:
        bits = int.from_bytes(message.packed, "little")
        assert len(message.packed) == (message.count * message.slot_bits + 7) // 8
        for _ in range(message.count):
            slots.append(bits % 2**message.slot_bits)
            bits >>= message.slot_bits
        assert bits == 0
    elif message.encoding == 2:
        assert generation == message.generation
        assert generation % 2 == 0
        slots = list(struct.unpack_from(f"={message.count}I", file, 4096))
    return slots, key


def test_orders_are_what_their_message_says_in_words(peer, make_batch, make_look):
    peer.edit(make_batch(1000, operation=GaussianArray.REPLACE))
    expected = list(range(1000))[::-1]
    peer.look(make_look(sequence=1, far_clip=2000.0))
    order = peer.order(1)
    slots, key = plainly(order)
    assert (order.encoding, slots) == (SplatOrder.PACKED, expected)
    generations = {}
    for sequence in range(2, 8):
        peer.look(make_look(sequence=sequence, far_clip=3000.0 - sequence, segment_key=key))
        order = peer.order(sequence)
        assert order.encoding == SplatOrder.SHARED
        assert plainly(order) == (expected, key)
        assert order.generation > generations.get(order.segment, 0)
        generations[order.segment] = order.generation
        with Path("/dev/shm", order.segment).open() as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    assert len(generations) == 2  # in turn: each order outlives the next


def test_a_sorter_in_another_container_is_not_believed_to_share_memory(
    ros, make_batch, make_look, monkeypatch
):
    """Its /dev/shm is another one, though it runs on the same machine."""
    separate = ["unshare", "--mount", "sh", "-c", 'mount -t tmpfs none /dev/shm && exec "$@"', "sh"]
    if subprocess.run([*separate, "true"], check=False, capture_output=True).returncode:
        pytest.skip("may not mount here")
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # which shares none either
    process = subprocess.Popen(
        [*separate, EXECUTABLE, "--ros-args", "-r", f"__ns:={ros}"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    peer = Peer()
    try:
        peer.meet()
        peer.edit(make_batch(3, operation=GaussianArray.REPLACE))
        for sequence in (1, 2):
            peer.look(make_look(sequence=sequence, segment_key=peer.reader.key))
            order = peer.order(sequence)
            assert order.segment
            assert order.encoding == SplatOrder.PACKED
            assert peer.reader.read(order).tolist() == [2, 1, 0]
            assert peer.reader.key == 0
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)
        peer.close()


def test_viewers_outlive_a_sorter_that_is_killed_and_meet_the_next(ros, make_batch, make_look):
    peer = Peer()
    peer.edit(make_batch(3, operation=GaussianArray.REPLACE))
    sequence, segments = 0, []
    try:
        for _ in range(2):
            process = subprocess.Popen(
                [EXECUTABLE, "--ros-args", "-r", f"__ns:={ros}"],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            peer.orders.clear()
            deadline = time.monotonic() + PATIENCE
            while not peer.orders or peer.orders[-1].encoding != SplatOrder.SHARED:
                assert time.monotonic() < deadline, "no order in shared memory"
                sequence += 1  # what the dead sorter can't answer is asked for again
                peer.look(make_look(sequence=sequence, segment_key=peer.reader.key))
                peer.listen(0.2)
                if peer.orders:
                    assert peer.reader.read(peer.orders[-1]).tolist() == [2, 1, 0]
            order = peer.orders[-1]
            process.kill()
            process.wait()
            assert peer.reader.read(order).tolist() == [2, 1, 0]
            segments.append(FOLDER / order.segment)
        assert not segments[0].exists()
        shared_orders.remove_stale()
        assert not segments[1].exists()
        with pytest.raises(OrderError):
            peer.reader.read(order)
    finally:
        process.kill()
        peer.close()
