"""QoS profiles, reliable and volatile where they don't say otherwise, as QoSProfile has it.

BEST_EFFORT loses a map's large messages on the default transport.
"""

from __future__ import annotations

from copy import copy
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

# For a subscription to `gaussians`: a publisher without pulls may keep many batches. MapReceiver
# asks for less where publishers offer less, or serve pulls.
MAP = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)

# The same for publishers that are volatile.
MAP_VOLATILE = QoSProfile(depth=1000)

# For a publisher that answers pulls: a late joiner learns of the map by the last batch. The other
# batches are for readers that lag behind.
PULLED_MAP = QoSProfile(depth=8, durability=DurabilityPolicy.TRANSIENT_LOCAL)

# Cameras and orders: the newest of each view counts, and all views share the topics. An order may
# take megabytes, and once a reader has been slow, Fast DDS keeps room for `depth` orders. A small
# depth does: a view that misses its order asks again.
VIEW = QoSProfile(depth=32)
ORDER = QoSProfile(depth=8)

# What a sensor measures, in no hurry: best-effort subscribers are served, too.
PICTURES = QoSProfile(depth=5)

# What is published once, a first view say: the newest, for whoever comes.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def overridable(profile: QoSProfile, adapted: QoSProfile | None = None) -> dict[str, Any]:
    """Arguments of create_publisher and create_subscription: QoS with parameters that override it.

    The parameters are qos_overrides.<topic>.<publisher or subscription>.{history,depth,
    reliability}, and profile has their defaults. adapted: replaces profile, policy by policy, where
    no parameter overrides it; it may differ in the next call for the same topic.
    """

    def adapt(chosen: QoSProfile) -> SetParametersResult:
        for policy in ("history", "depth", "reliability", "durability"):
            if adapted and getattr(chosen, policy) == getattr(profile, policy):
                setattr(chosen, policy, getattr(adapted, policy))
        return SetParametersResult(successful=True)

    return {
        "qos_profile": copy(profile),  # which rclpy writes to
        "qos_overriding_options": QoSOverridingOptions.with_default_policies(callback=adapt),
    }
