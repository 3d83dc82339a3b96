"""Programs of ROS in a namespace of their own, and a node that asks things of them."""

from __future__ import annotations

import subprocess
import time
import uuid
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rosplat_ros.program.processes import Processes

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.executors import Executor
    from rclpy.node import Node

    from rosplat_core.cameras import Camera
    from rosplat_msgs.srv import RenderView

PATIENCE = 120.0  # with an answer [s]
ASK_AGAIN = 10.0  # after which an answer may have got lost [s]


class Programs(Processes):
    """Programs that hear nobody else's publishers, sorters or viewers; all end with the block."""

    def __init__(self, log_folder: Path, kind: str = "bench") -> None:
        """kind: what the namespace's name begins with."""
        super().__init__(log_folder)
        self.namespace = f"/{kind}_{uuid.uuid4().hex[:8]}"
        self.remap = ["--ros-args", "-r", f"__ns:={self.namespace}"]
        self._renders: Client | None = None

    def __enter__(self) -> Programs:
        super().__enter__()
        return self

    def node(
        self, package: str, executable: str, *arguments: str, name: str | None = None
    ) -> subprocess.Popen[bytes]:
        """Starts a node in the namespace. Raises ProcessError where it isn't there."""
        return super().node(package, executable, *self.remap, *arguments, name=name)

    @cached_property
    def asker(self) -> Node:
        """A node of this process in the namespace."""
        import rclpy

        context = rclpy.Context()  # its own: it leaves signals, and other nodes, alone
        rclpy.init(context=context)
        return rclpy.create_node("asker", namespace=self.namespace, context=context)

    @cached_property
    def _executor(self) -> Executor:
        from rclpy.executors import SingleThreadedExecutor

        executor = SingleThreadedExecutor(context=self.asker.context)
        executor.add_node(self.asker)
        return executor

    def spin_once(self, timeout: float = 0.1) -> None:
        """Runs a callback of the asker, if one comes in time. [s]"""
        self._executor.spin_once(timeout)

    def wait(
        self,
        until: Callable[[], object],
        complaint: str,
        *,
        patience: float = PATIENCE,
        again: Callable[[], object] = lambda: None,
        every: float = 1.0,
    ) -> None:
        """Runs the asker's callbacks until until() holds, and again() every so many seconds.

        Raises TimeoutError with the complaint, ProcessError where a program ends.
        """
        began = called = time.monotonic()
        while not until():
            self.spin_once()
            self.check()
            now = time.monotonic()
            if now > began + patience:
                raise TimeoutError(complaint)
            if now > called + every:
                called = now
                again()

    def call(
        self, client: Client, request: Any, complaint: str, ask_again: float = ASK_AGAIN
    ) -> Any:
        """The answer of a service, asked once more where the first answer doesn't come.

        A server that began just now may answer before it knows its client. Raises as wait.
        """
        self.wait(client.service_is_ready, f"nobody answers at {client.srv_name}")
        futures = [client.call_async(request)]

        def once_more() -> None:
            if len(futures) == 1:
                futures.append(client.call_async(request))

        self.wait(
            lambda: any(future.done() for future in futures), complaint,
            again=once_more, every=ask_again,
        )  # fmt: skip
        return next(future.result() for future in futures if future.done())

    def picture(
        self, camera: Camera, complaint: str, order_timeout: float = 0.0, detail: str = ""
    ) -> RenderView.Response:
        """A renderer's answer for a camera; the rest as of RenderView and of call()."""
        from rosplat_msgs.srv import RenderView
        from rosplat_ros.view_cameras import view_camera

        if self._renders is None:
            self._renders = self.asker.create_client(RenderView, "gaussians/render")
        request = RenderView.Request(
            camera=view_camera(camera), order_timeout=order_timeout, detail=detail
        )
        return self.call(self._renders, request, complaint, order_timeout + ASK_AGAIN)

    def end(self) -> None:
        """Ends every program, then the asker."""
        super().end()
        if "asker" in vars(self):
            self._executor.shutdown()
            self.asker.destroy_node()
            self.asker.context.try_shutdown()
