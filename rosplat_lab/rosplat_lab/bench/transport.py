"""How long orders and maps are on their way between two processes."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from rosplat_lab.bench import live, scenes
from rosplat_lab.bench.peer import ORDERS, QUESTIONS, Orders, topic
from rosplat_lab.bench.plan import Plan
from rosplat_lab.bench.records import Budget, Doing, Event, Measurement, Skipped
from rosplat_lab.programs import Programs
from rosplat_msgs.msg import SplatOrder, ViewCamera
from rosplat_msgs.srv import LoadScene
from rosplat_ros.program.processes import ProcessError
from rosplat_ros.qos import ORDER

ORDER_SIZES = (100_000, 500_000, 1_000_000, 2_000_000, 5_000_000)
QUICK_ORDER_SIZES = (100_000, 500_000)
MAPS, QUICK_MAPS = (100_000, 500_000, 1_000_000, 2_000_000), (100_000,)
MAP_REPEATS, QUICK_MAP_REPEATS = 3, 1
PICTURE = (320, 180)  # small: what counts is that the map is in it
PATIENCE = 30.0  # with an answer [s]
ACQUAINTANCE = 4.0  # until publisher, sorter and viewer know each other: DDS asks each 3 s [s]


def measure(plan: Plan) -> Iterator[Event]:
    """Orders in each form, and whole maps."""
    orders = plan.sizes or (QUICK_ORDER_SIZES if plan.quick else ORDER_SIZES)
    with Programs(plan.out / "log") as programs:
        asker = Asker(programs)
        jobs = list(itertools.product(orders, ORDERS))
        for number, (count, way) in enumerate(jobs):
            yield Doing(f"an order of {count:,} slots, {way}", 0.6 * number / len(jobs))
            times = asker.ask(way, count, plan.budget)
            yield Measurement.of("order", "ms", times, splats=count, way=way)
    yield from _maps(plan)


def _maps(plan: Plan) -> Iterator[Event]:
    maps = plan.sizes or (QUICK_MAPS if plan.quick else MAPS)
    names = scenes.names(maps, plan.scenes)
    for index, name in enumerate(names):
        yield Doing(f"{name}: published until visible", 0.6 + 0.4 * index / len(names))
        try:
            repeats = QUICK_MAP_REPEATS if plan.quick else MAP_REPEATS
            yield from _visible(plan.out, name, repeats)
        except (ProcessError, TimeoutError) as error:
            yield Skipped(f"{name}: {error}")


class Asker:
    """Asks a peer in a process of its own for orders, and times them."""

    def __init__(self, programs: Programs) -> None:
        self._programs = programs
        peer = [sys.executable, "-m", "rosplat_lab.bench.peer", *programs.remap]
        programs.start("peer", peer)
        self._questions = programs.asker.create_publisher(ViewCamera, QUESTIONS, ORDER)
        self._sequence = 0
        self._times: dict[int, float] = {}
        for kind, orders in ORDERS.items():
            programs.asker.create_subscription(
                SplatOrder, topic(kind), partial(self._receive, orders), ORDER
            )

    def ask(self, kind: str, count: int, budget: Budget) -> list[float]:
        """Times from before an order is made until its slots are at hand here. [ms]

        Raises ProcessError where the peer ends, TimeoutError where it doesn't answer.
        """
        return budget.spend(lambda _: self._ask(kind, count))

    def _ask(self, kind: str, count: int) -> float:
        def question() -> None:
            self._sequence += 1
            self._questions.publish(ViewCamera(view_id=kind, width=count, sequence=self._sequence))

        first = self._sequence + 1
        question()
        self._programs.wait(
            lambda: any(number >= first for number in self._times),
            f"no answer to {kind} of {count}",
            patience=PATIENCE, again=question, every=ACQUAINTANCE,
        )  # fmt: skip
        return self._times.pop(min(number for number in self._times if number >= first))

    def _receive(self, orders: Orders, answer: SplatOrder) -> None:
        orders.read(answer)
        now = time.time_ns()
        stamp = answer.header.stamp
        self._times[int(answer.header.frame_id)] = (now - stamp.sec * 10**9 - stamp.nanosec) / 1e6


def _visible(out: Path, name: str, repeats: int) -> Iterator[Measurement]:
    """From the first batch's making to the frame that shows all, in three processes."""

    def load(programs: Programs) -> None:
        """Has the scene loaded, once the three have found each other."""
        client = programs.asker.create_client(LoadScene, "ply_publisher/load")
        programs.wait(client.service_is_ready, "the publisher did not start", patience=PATIENCE)
        time.sleep(ACQUAINTANCE)
        client.call_async(LoadScene.Request(path=name))

    shown, rates, splats, gpu = [], [], 0, ""
    for _ in range(repeats):
        seen = live.watch(
            out, ("ply_publisher",), backend="native", rate=0.1, picture=PICTURE,
            until=live.until_settled(),
            begin=load,
        )  # fmt: skip
        frame = next(frame for frame in seen.frames if live.is_settled(frame))
        splats, gpu = frame["splats"], frame["renderer"]
        shown.append(1e3 * (frame["time"] - frame["published"]))
        rates.append(splats / 1e6 / (frame["received"] - frame["published"]))
    yield Measurement.of("publish to visible", "ms", shown, name, splats, gpu, backend="native")
    yield Measurement.of("received by the viewer", "M splats/s", rates, name, splats)
