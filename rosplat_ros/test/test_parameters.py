"""Parameters as users give them."""

import pytest
import rclpy
from rclpy.parameter import Parameter

from rosplat_core.splats import InputError
from rosplat_ros.program.parameters import declare


@pytest.mark.parametrize(("given", "value"), [(10, 10.0), (2.5, 2.5)])
def test_a_whole_number_is_a_rate(given: float, value: float) -> None:
    context = rclpy.Context()
    rclpy.init(context=context)
    overrides = [Parameter("rate", value=given), Parameter("depth", value=given)]
    node = rclpy.create_node("camera", context=context, parameter_overrides=overrides)
    try:
        rate = declare(node, "rate", 1.0, "Pictures a second. [Hz]", 0.1, 100.0)
        assert (rate, type(rate)) == (value, float)
        with pytest.raises(InputError, match="range" if given == 10 else "type"):
            declare(node, "depth", 1, "Whole, and small.", 1, 5)
    finally:
        node.destroy_node()
        context.try_shutdown()
