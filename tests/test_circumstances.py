"""What every receiver of a map comes to, whatever its circumstances: the publisher's map, whole."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import pytest
import rclpy
from ament_index_python.packages import get_packages_with_prefixes
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import Header

from rosplat_core.maps import Arrival, GaussianMap, PublishedBatch, PublishedMap
from rosplat_core.splats import Splats
from rosplat_msgs.msg import GaussianArray
from rosplat_msgs.srv import PullMap
from rosplat_ros.map_publisher import as_message
from rosplat_ros.map_receiver import MapReceiver

PATIENCE = 120.0  # however busy the machine is [s]
BLOCK = GaussianArray.SLOTS_PER_BLOCK
IN_BLOCK = 60  # splats of a batch: more than an answer of CHUNK_BYTES holds of two blocks
CHUNK_BYTES = 2500


def _qos(*, latched: bool = True, reliable: bool = True, depth: int = 1000) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


@dataclass
class Serving:
    """How pulls are answered: after delay [s], and of the answers each `loses`-th is lost."""

    delay: float = 0.0
    loses: int = 0


class Source:
    """Publishes a map of one batch a block, and may answer pulls of it."""

    def __init__(
        self,
        namespace: str,
        offer: QoSProfile,
        serving: Serving | None,
        domain: int | None = None,
    ) -> None:
        self.lost: set[int] = set()  # revisions that never reach the topic
        self.sent: list[GaussianArray] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("source", namespace=namespace, context=self._context)
        self._publisher = self._node.create_publisher(GaussianArray, "gaussians", offer)
        self._random = np.random.default_rng(3)
        self.map = PublishedMap(CHUNK_BYTES, "none", self._send, print, lambda: None)
        self._answers = itertools.count(1)
        if serving:
            self._serve(serving)
        self._thread = _spin(self._node)

    def _serve(self, serving: Serving) -> None:
        def answer(request: PullMap.Request, response: PullMap.Response) -> PullMap.Response:
            time.sleep(serving.delay)
            batches, response.next_block = self.map.pull(
                request.map_id, request.after_revision, request.first_block, 3
            )
            response.batches = [as_message(batch, Header(frame_id="map")) for batch in batches]
            return response

        service = self._node.create_service(PullMap, "gaussians/pull", answer)
        send = service.send_response

        def send_some(response: Any, header: Any) -> None:
            if not serving.loses or next(self._answers) % serving.loses:
                send(response, header)

        service.send_response = send_some

    def _send(self, batch: PublishedBatch) -> None:
        message = as_message(batch, Header(frame_id="map"))
        if batch.revision not in self.lost:
            self.sent.append(message)
            self._publisher.publish(message)

    def repeat(self) -> None:
        """Sends all that was sent once more, as a bag that is played in a loop."""
        for message in self.sent:
            self._publisher.publish(message)

    def replace(self) -> None:
        """A REPLACE that empties the map."""
        self.map.replace(_splats(self._random, 0), None, None)

    def write(self, *blocks: int) -> None:
        """Writes splats to blocks, a batch each."""
        for block in blocks:
            self.map.upsert(block * BLOCK, _splats(self._random, IN_BLOCK), 0, None)

    def listeners(self) -> int:
        return int(self._publisher.get_subscription_count())

    def close(self) -> None:
        self._context.try_shutdown()
        self._thread.join()


def _splats(random: np.random.Generator, count: int) -> Splats:
    return Splats(
        positions=random.normal(size=(count, 3)),
        orientations=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        scales=np.full((count, 3), 0.1),
        opacities=np.full(count, 0.5),
        sh=np.zeros((count, 1, 3)),
    )


def _spin(node: Node) -> threading.Thread:
    def spin() -> None:
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        try:
            executor.spin()
        except Exception:  # ExternalShutdownException, or RCLError of what ended with its context
            if node.context.ok():
                raise
            node.destroy_node()

    thread = threading.Thread(target=spin)
    thread.start()
    return thread


class Receiver(Protocol):
    """Whoever hears a map."""

    busy: bool

    def state(self) -> tuple[str, int, int, bool]:
        """Its map's id, revision, number of missed batches, and whether a pull is under way."""

    def in_use(self, slots: NDArray[np.int64]) -> list[bool]: ...

    def close(self) -> None: ...


class InPython:
    """MapReceiver of rosplat_ros."""

    kind: type[MapReceiver] = MapReceiver

    def __init__(self, namespace: str) -> None:
        self.busy = False
        self._map = GaussianMap()
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        node = rclpy.create_node("receiver", namespace=namespace, context=self._context)
        self._receiver = self.kind(node, self._take, busy=lambda: self.busy)
        self._thread = _spin(node)

    def _take(self, batch: GaussianArray, arrival: Arrival) -> None:
        self._map.apply(batch, arrival)

    def state(self) -> tuple[str, int, int, bool]:
        known = self._map
        return known.map_id, known.revision, known.missed, known.pulled

    def in_use(self, slots: NDArray[np.int64]) -> list[bool]:
        return [bool(self._map.in_use(slot)) for slot in slots.tolist()]

    def close(self) -> None:
        self._context.try_shutdown()
        self._thread.join()


class Deaf(MapReceiver):
    """Misses revisions 4 and 5, once each."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self._to_miss = {4, 5}
        super().__init__(*arguments, **named)

    def _on_message(self, message: GaussianArray) -> None:
        if message.revision in self._to_miss:
            self._to_miss.remove(message.revision)
        else:
            super()._on_message(message)


class UnreachedAtFirst(MapReceiver):
    """Hears nothing by the participant of its node, as if Fast DDS had lost the way to it."""

    def __init__(self, node: Node, *arguments: Any, **named: Any) -> None:
        self._first = node
        super().__init__(node, *arguments, **named)

    def _on_message(self, *message: Any) -> None:
        if self._node is not self._first:
            super()._on_message(*message)

    def _on_answer(self, *answer: Any) -> None:
        if self._node is not self._first:
            super()._on_answer(*answer)


class UnreachedInPython(InPython):
    kind = UnreachedAtFirst
    _receiver: UnreachedAtFirst

    def close(self) -> None:
        assert self._receiver._node is not self._receiver._first
        super().close()


class DeafInPython(InPython):
    kind = Deaf
    _receiver: Deaf

    def close(self) -> None:
        super().close()
        assert not self._receiver._to_miss


CMAKE = """
cmake_minimum_required(VERSION 3.16)
project(receiver LANGUAGES CXX)
find_package(rosplat_ros REQUIRED)
add_executable(receiver {source})
target_link_libraries(receiver rosplat_ros::map_receiver)
"""


class InCpp:
    """MapReceiver for C++, in the program receiver.cpp."""

    program: ClassVar[Path]  # once it is built

    def __init__(self, namespace: str) -> None:
        self._busy = False
        self._process = subprocess.Popen(
            [self.program, "--ros-args", "-r", f"__ns:={namespace}"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
        )  # fmt: skip

    def _tell(self, *words: object) -> None:
        assert self._process.stdin
        print(*words, file=self._process.stdin)

    def _ask(self, *slots: int) -> tuple[str, ...]:
        assert self._process.stdout
        self._tell("state", *slots)
        return tuple(self._process.stdout.readline().split())

    @property
    def busy(self) -> bool:
        return self._busy

    @busy.setter
    def busy(self, busy: bool) -> None:
        self._busy = busy
        self._tell("busy", int(busy))

    def state(self) -> tuple[str, int, int, bool]:
        map_id, revision, missed, pulled = self._ask()
        return map_id, int(revision), int(missed), pulled == "1"

    def in_use(self, slots: NDArray[np.int64]) -> list[bool]:
        return [used == "1" for used in self._ask(*slots.tolist())[4:]]

    def close(self) -> None:
        self._process.communicate(timeout=PATIENCE)
        assert self._process.returncode == 0


@dataclass
class Stage:
    """Where a circumstance is played."""

    namespace: str
    receiver_kind: Callable[[str], Receiver]
    _receiver: Receiver | None = None
    _source: Source | None = None
    _ends: list[Callable[[], None]] = field(default_factory=list)

    def publish(self, offer: QoSProfile, serving: Serving | None = None) -> Source:
        """The source of the map from now on."""
        if self._source:
            self._source.close()
        self._source = Source(self.namespace, offer, serving)
        return self._source

    def listen(self) -> Receiver:
        """The receiver, which begins now."""
        self._receiver = self.receiver_kind(self.namespace)
        return self._receiver

    def meet(self) -> Receiver:
        """The receiver, once the source knows it."""
        receiver = self.listen()
        assert self._source
        self.wait(self._source.listeners)
        time.sleep(1.5)  # it subscribes anew within a second, if it does
        return receiver

    def neighbour(self) -> subprocess.Popen[bytes]:
        """Another receiver, a process, once the source knows it."""
        assert self._source
        before = self._source.listeners()
        program = (
            "import rclpy; from rosplat_ros.map_receiver import MapReceiver; rclpy.init(); "
            "node = rclpy.create_node('neighbour'); MapReceiver(node, lambda *_: None); "
            "rclpy.spin(node)"
        )
        process = subprocess.Popen(
            [sys.executable, "-c", program, "--ros-args", "-r", f"__ns:={self.namespace}"],
        )
        self._ends.append(process.kill)
        self.wait(lambda: self._source and self._source.listeners() > before)
        return process

    def wait(self, until: Callable[[], object], patience: float = PATIENCE) -> None:
        deadline = time.monotonic() + patience
        while not until():
            assert time.monotonic() < deadline, self._receiver and self._receiver.state()
            time.sleep(0.02)

    def is_whole(self) -> bool:
        """Whether the receiver has the map of the source."""
        assert self._source
        assert self._receiver
        published = self._source.map
        blocks = np.arange(40) * BLOCK
        used = np.concatenate([slots for _, _, slots, _ in published.groups()] or [blocks[:0]])
        return (
            self._receiver.state() == (published.map_id, published.revision(), 0, False)
            and self._receiver.in_use(blocks) == np.isin(blocks, used).tolist()
        )

    def close(self) -> None:
        for end in (*self._ends, *(each.close for each in (self._receiver, self._source) if each)):
            end()


# --- The table ------------------------------------------------------------------------------------


def busy_where_nobody_serves_pulls(stage: Stage) -> None:
    source = stage.publish(_qos())
    receiver = stage.meet()
    receiver.busy = True
    source.replace()
    source.write(*range(30))
    time.sleep(2.0)
    receiver.busy = False


def replaced_while_busy_where_nobody_serves_pulls(stage: Stage) -> None:
    source = stage.publish(_qos(latched=False))
    receiver = stage.meet()
    source.write(0, 1)
    stage.wait(stage.is_whole)
    receiver.busy = True
    source.write(2)
    source.replace()
    source.write(3)
    time.sleep(1.0)
    receiver.busy = False


def busy_where_pulls_are_served(stage: Stage) -> None:
    source = stage.publish(_qos(depth=8), Serving())
    receiver = stage.meet()
    source.write(0)
    stage.wait(stage.is_whole)
    receiver.busy = True
    source.write(*range(1, 30))
    time.sleep(2.0)
    receiver.busy = False


def replaced_while_busy_where_pulls_are_served(stage: Stage) -> None:
    source = stage.publish(_qos(depth=8), Serving())
    receiver = stage.meet()
    source.write(0, 1)
    stage.wait(stage.is_whole)
    receiver.busy = True
    source.write(2)
    source.replace()
    stage.wait(lambda: receiver.state()[1] == source.map.revision())
    receiver.busy = False
    source.write(3)


def joining_late_where_nobody_serves_pulls(stage: Stage) -> None:
    stage.publish(_qos()).write(*range(30))
    stage.listen()


def joining_late_where_pulls_are_served(stage: Stage) -> None:
    stage.publish(_qos(depth=8), Serving()).write(*range(30))
    stage.listen()


def beside_a_volatile_publisher(stage: Stage) -> None:
    source = stage.publish(_qos(latched=False))
    stage.meet()
    source.write(*range(5))


def beside_a_best_effort_publisher(stage: Stage) -> None:
    source = stage.publish(_qos(latched=False, reliable=False))
    stage.meet()
    source.write(*range(5))


def lost_batches_that_are_pulled(stage: Stage) -> None:
    source = stage.publish(_qos(depth=8), Serving())
    stage.meet()
    source.lost |= {3, 4, 7}  # the last one, too
    source.write(*range(7))


def late_answers(stage: Stage) -> None:
    stage.publish(_qos(depth=1), Serving(delay=2.5)).write(*range(4))
    stage.listen()


def lost_answers(stage: Stage) -> None:
    stage.publish(_qos(depth=1), Serving(loses=2)).write(*range(6))
    stage.listen()


def a_bag_in_a_loop(stage: Stage) -> None:
    source = stage.publish(_qos(latched=False))
    stage.meet()
    source.replace()
    source.write(*range(5))
    source.repeat()
    stage.wait(stage.is_whole)
    source.repeat()


def a_publisher_that_begins_anew(stage: Stage) -> None:
    stage.publish(_qos(depth=8), Serving()).write(*range(5))
    stage.listen()
    stage.wait(stage.is_whole)
    stage.publish(_qos(depth=8), Serving()).write(7, 8)


def a_neighbour_that_was_killed(stage: Stage) -> None:
    stage.publish(_qos(depth=8), Serving()).write(*range(30))
    stage.neighbour().kill()
    stage.listen()


def a_neighbour_that_hangs(stage: Stage) -> None:
    stage.publish(_qos(depth=8), Serving()).write(*range(30))
    os.kill(stage.neighbour().pid, signal.SIGSTOP)
    stage.listen()


def a_neighbour_that_hung_and_was_killed(stage: Stage) -> None:
    source = stage.publish(_qos(depth=8), Serving())
    source.write(*range(30))
    neighbour = stage.neighbour()
    os.kill(neighbour.pid, signal.SIGSTOP)
    for number in range(30, 36):
        source.write(number)
        time.sleep(0.5)
    neighbour.kill()
    neighbour.wait()
    stage.listen()


def missed_batches_that_the_history_holds(stage: Stage) -> None:
    source = stage.publish(_qos())
    stage.meet()
    source.write(*range(8))


CIRCUMSTANCES = (
    busy_where_nobody_serves_pulls,
    replaced_while_busy_where_nobody_serves_pulls,
    busy_where_pulls_are_served,
    replaced_while_busy_where_pulls_are_served,
    joining_late_where_nobody_serves_pulls,
    joining_late_where_pulls_are_served,
    beside_a_volatile_publisher,
    beside_a_best_effort_publisher,
    lost_batches_that_are_pulled,
    late_answers,
    lost_answers,
    a_bag_in_a_loop,
    a_publisher_that_begins_anew,
    a_neighbour_that_was_killed,
    a_neighbour_that_hangs,
    a_neighbour_that_hung_and_was_killed,
)
CASES: list[tuple[type[Receiver], Callable[[Stage], None]]] = [
    (kind, circumstance) for kind in (InPython, InCpp) for circumstance in CIRCUMSTANCES
]
CASES.append((DeafInPython, missed_batches_that_the_history_holds))
CASES.append((UnreachedInPython, joining_late_where_pulls_are_served))


@pytest.fixture
def namespace() -> Iterator[str]:
    yield f"/test_{uuid.uuid4().hex}"


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program receiver.cpp."""
    if "rclcpp" not in get_packages_with_prefixes():
        pytest.skip("no rclcpp here: MapReceiver for C++ is not tested")
    folder = tmp_path_factory.mktemp("receiver")
    source = Path(__file__).with_name("receiver.cpp")
    (folder / "CMakeLists.txt").write_text(CMAKE.format(source=source))
    for command in (["cmake", "-S", ".", "-B", "."], ["cmake", "--build", "."]):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "receiver"


@pytest.mark.parametrize(
    ("kind", "circumstance"),
    [pytest.param(*case, id=f"{case[0].__name__}-{case[1].__name__}") for case in CASES],
)
def test_receivers_come_to_the_publisher_s_map(
    kind: type[Receiver],
    circumstance: Callable[[Stage], None],
    namespace: str,
    request: pytest.FixtureRequest,
) -> None:
    if kind is InCpp:
        InCpp.program = request.getfixturevalue("program")
    stage = Stage(namespace, kind)
    try:
        circumstance(stage)
        stage.wait(stage.is_whole)
    finally:
        stage.close()


LOST = (
    "import rclpy; from rosplat_core.maps import GaussianMap; from rosplat_ros import MapReceiver; "
    "rclpy.init(); node = rclpy.create_node('receiver'); map = GaussianMap(); "
    "MapReceiver(node, map.apply)\n"
    "while not map.complete: rclpy.spin_once(node, timeout_sec=0.1)"
)


@pytest.mark.skipif(get_rmw_implementation_identifier() != "rmw_fastrtps_cpp", reason="Fast DDS's")
@pytest.mark.parametrize("language", ["python", "cpp"])
def test_a_receiver_whose_port_in_shared_memory_was_lost_joins_anew(
    language: str, namespace: str, request: pytest.FixtureRequest
) -> None:
    """As a publisher loses it that still writes to one who hung, was killed, and had that port."""
    domain = 90 + os.getpid() % 10
    user_ports = range(7400 + 250 * domain + 11, 7400 + 250 * (domain + 1), 2)

    def ports() -> set[tuple[int, int]]:  # and when they were opened
        locks = [Path(f"/dev/shm/fastrtps_port{port}_el") for port in user_ports]
        return {
            (port, lock.stat().st_ctime_ns)
            for port, lock in zip(user_ports, locks, strict=True)
            if lock.exists()
        }

    before = ports()
    program = [sys.executable, "-c", LOST]
    if language == "cpp":
        program = [str(request.getfixturevalue("program")), "whole"]
    with subprocess.Popen(
        [*program, "--ros-args", "-r", f"__ns:={namespace}"],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
    ) as process:
        try:
            deadline = time.monotonic() + PATIENCE
            while not (new := [port for port, _ in ports() - before]):
                assert time.monotonic() < deadline
                time.sleep(0.05)
            time.sleep(0.5)  # the port is open
            (Path("/dev/shm") / f"fastrtps_port{new[0]}").unlink()
            source = Source(namespace, _qos(depth=8), Serving(), domain)
            try:
                source.write(*range(30))
                assert process.wait(PATIENCE) == 0
            finally:
                source.close()
        finally:
            process.kill()
