"""Parameters as users give them."""

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from rosplat_core.splats import InputError
from rosplat_ros.program.parameters import declare


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context)
    yield context
    context.try_shutdown()


def given(context: Context, value: Any) -> Node:
    overrides = [Parameter("it", value=value)]
    return rclpy.create_node("camera", context=context, parameter_overrides=overrides)


@pytest.mark.parametrize(
    ("default", "value", "meant"),
    [
        (1.0, 10, 10.0), (1.0, 2.5, 2.5), (10, 2e6, 2_000_000), (10, "20k", 20_000),
        ("full", 2, "2"), ("", [0, 0, 1], "0 0 1"), ([0.1, 1.8], [0, 2], [0.0, 2.0]),
        (["left", "right"], "left", ["left"]),
    ],
)  # fmt: skip
def test_a_value_is_taken_as_it_is_meant(
    context: Context, default: Any, value: Any, meant: Any
) -> None:
    found = declare(given(context, value), "it", default, "Anything.")
    assert (list(found) if isinstance(meant, list) else found) == meant


@pytest.mark.parametrize(
    ("default", "value", "error"),
    [(1, 10, "range"), (1, 2.5, "type"), (1, "20x", "it: '20x' is no whole number"),
     (True, 1, "type"), (1.0, "fast", "type"), (1, True, "type")],
)  # fmt: skip
def test_what_cannot_be_meant_is_named(
    context: Context, default: Any, value: Any, error: str
) -> None:
    with pytest.raises(InputError, match=error):
        declare(given(context, value), "it", default, "Whole, and small.", 1, 5)
