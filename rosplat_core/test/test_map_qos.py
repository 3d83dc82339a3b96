"""What a subscription to a map asks for: one table for receivers in C++ and Python."""

from __future__ import annotations

import pytest

from rosplat_core.maps import MapQos, choose_map_qos

WISHED = (True, True, 1000)  # reliable, transient local, depth
LATCHED, VOLATILE, BEST_EFFORT = (True, True, 8), (True, False, 8), (False, False, 8)
LATCHED_BEST_EFFORT = (False, True, 8)
NONE, BEST_EFFORT_UNHEARD, VOLATILE_UNHEARD = (False, False), (True, False), (False, True)


@pytest.mark.parametrize(
    ("wished", "offers", "served", "asked", "unheard"),
    [
        (WISHED, [], False, WISHED, NONE),
        (WISHED, [LATCHED], False, WISHED, NONE),
        (WISHED, [LATCHED], True, (True, True, 8), NONE),
        (WISHED, [VOLATILE], False, (True, False, 1000), NONE),
        (WISHED, [VOLATILE], True, (True, False, 8), NONE),
        (WISHED, [BEST_EFFORT], False, (False, False, 1000), NONE),
        (WISHED, [LATCHED_BEST_EFFORT], False, (False, True, 1000), NONE),
        (WISHED, [VOLATILE, BEST_EFFORT], False, (True, False, 1000), BEST_EFFORT_UNHEARD),
        (WISHED, [LATCHED, VOLATILE], False, WISHED, VOLATILE_UNHEARD),
        (WISHED, [LATCHED, BEST_EFFORT], True, (True, True, 8), (True, True)),
        ((True, False, 5), [LATCHED], False, (True, False, 5), NONE),
        ((False, False, 5), [LATCHED, BEST_EFFORT], True, (False, False, 5), NONE),
        ((True, True, 0), [LATCHED], True, (True, True, 1), NONE),
    ],
)
def test_a_subscription_asks_for_less_only_where_all_publishers_offer_less(
    wished: MapQos, offers: list[MapQos], served: bool, asked: MapQos, unheard: tuple[bool, bool]
) -> None:
    assert choose_map_qos(wished, offers, served) == (asked, *unheard)
