"""How maps number their slots."""

MAX_SLOTS = 1 << 25  # as GaussianArray.MAX_SLOTS
SLOTS_PER_PAGE = 1024  # all splats of a page are of one group
