"""Work in a process of its own: its memory is its own, and its crash takes nobody along."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

from rosplat_lab.bench.records import Event


def isolated(work: Callable[..., Iterator[Event]], *arguments: Any) -> Iterator[Event]:
    """Yields what work(*arguments) yields. Raises RuntimeError if its process raises or dies."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(there, work, arguments), daemon=True)
    process.start()
    there.close()
    try:
        while True:
            try:
                event = here.recv()
            except EOFError:
                break
            if isinstance(event, str):
                raise RuntimeError(event)
            yield event
        process.join()
        if process.exitcode:
            raise RuntimeError(f"a process of {work.__name__} ended with code {process.exitcode}")
    finally:
        process.terminate()
        process.join()


def _run(
    there: Connection, work: Callable[..., Iterator[Event]], arguments: tuple[Any, ...]
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the parent decides
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for event in work(*arguments):
            there.send(event)
    except KeyboardInterrupt:
        pass
    except Exception as error:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the parent, when told, ends this at once
        there.send(f"{type(error).__name__}: {error}")
    finally:
        there.close()
