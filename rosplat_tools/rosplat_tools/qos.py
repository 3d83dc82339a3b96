"""The QoS profiles of ROSplat's topics, by name."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

HISTORY_DEPTH = 1000


def map_qos(history_depth: int = HISTORY_DEPTH) -> QoSProfile:
    """`gaussians`: nothing is lost, and a late joiner gets the last history_depth batches.

    A reader needs the depth as well: a late joiner's history arrives at once.
    """
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        history=HistoryPolicy.KEEP_LAST,
        depth=history_depth,
    )


MAP = map_qos()

# From publishers that keep no history, such as a played bag.
MAP_VOLATILE = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
    history=HistoryPolicy.KEEP_LAST,
    depth=HISTORY_DEPTH,
)

# Cameras and orders: the newest of each view must arrive, and all views share the topics.
VIEW = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
    history=HistoryPolicy.KEEP_LAST,
    depth=32,  # views
)
ORDER = VIEW
