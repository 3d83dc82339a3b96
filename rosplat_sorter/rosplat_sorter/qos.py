"""QoS profiles. BEST_EFFORT loses a map's large messages on the default transport."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _map_qos(
    depth: int, durability: DurabilityPolicy = DurabilityPolicy.TRANSIENT_LOCAL
) -> QoSProfile:
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
    )


# For a subscription to `gaussians`: a publisher without pulls may keep many batches.
MAP = _map_qos(1000)

# The same for publishers that are volatile.
MAP_VOLATILE = _map_qos(1000, DurabilityPolicy.VOLATILE)

# For a publisher that answers pulls: a late joiner learns of the map by the last batch. The others
# are for readers that lag behind.
PULLED_MAP = _map_qos(8)

# For a subscription that can pull: if it is too slow, only the newest batches wait.
SERVED_MAP = _map_qos(8, DurabilityPolicy.VOLATILE)


def _view_qos(depth: int) -> QoSProfile:
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
    )


# Cameras and orders: the newest of each view counts, and all views share the topics. An order may
# take megabytes, and once a reader has been slow, Fast DDS keeps room for as many: a view that
# misses its own asks again.
VIEW = _view_qos(32)
ORDER = _view_qos(8)
