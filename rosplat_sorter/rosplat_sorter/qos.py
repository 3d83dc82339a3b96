"""How messages travel. BEST_EFFORT loses a map's large messages on the default transport."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

HISTORY_DEPTH = 1000


def map_qos(
    history_depth: int = HISTORY_DEPTH,
    durability: DurabilityPolicy = DurabilityPolicy.TRANSIENT_LOCAL,
) -> QoSProfile:
    """`gaussians`: nothing is lost, and a late joiner gets the last history_depth batches.

    A reader needs the depth as well: a late joiner's history arrives at once.
    """
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
        history=HistoryPolicy.KEEP_LAST,
        depth=history_depth,
    )


MAP = map_qos()

# From publishers that keep nothing for late joiners.
MAP_VOLATILE = map_qos(durability=DurabilityPolicy.VOLATILE)

# Cameras and orders: the newest of each view counts, and all views share the topics.
VIEW = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
    history=HistoryPolicy.KEEP_LAST,
    depth=32,  # views
)
ORDER = VIEW
