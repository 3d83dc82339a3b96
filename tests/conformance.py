"""What every receiver of a map must make of its batches: one table for all of them."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

from geometry_msgs.msg import Point, Pose, Quaternion

from rosplat_core.maps import Arrival
from rosplat_core.models import Model
from rosplat_core.payload import PACKED, QUANTISED
from rosplat_msgs.msg import GaussianArray
from rosplat_testing.messages import decode, encode

REPLACE, UPSERT, DELETE = GaussianArray.REPLACE, GaussianArray.UPSERT, GaussianArray.DELETE
MOVE = GaussianArray.MOVE
MOST = GaussianArray.MAX_SLOTS
NAN, INF = float("nan"), float("inf")
LARGEST, LEAST = 3.4e38, 1e-45  # of float32
INFINITE_HALF, NAN_HALF = struct.pack("<e", INF), struct.pack("<e", NAN)
NANS, INFS, UPSIDE = struct.pack("<f", NAN), struct.pack("<f", INF), struct.pack("<2f", 1, 0)

# Values of a splat by field; the i-th of a batch sits at x = i. [m]
_SPLAT = {
    "positions": (0.0, 0.0, 0.0),
    "orientations": (0.0, 0.0, 0.0, 1.0),
    "scales": (0.1, 0.1, 0.1),
    "opacities": (0.5,),
}


class Receiver(Protocol):
    """Whoever holds a map: what a receiver does not know of it is None."""

    origin: tuple[float, float, float] | None
    model: int | None
    revision: int | None
    missed: int | None
    channels: tuple[str, ...]

    def take(self, message: GaussianArray, arrival: Arrival) -> int:
        """Applies a batch: how many splats it leaves out.

        Raises ValueError, naming the field, for a batch that contradicts itself.
        """

    def in_use(self, slot: int) -> bool: ...

    def place(self, group: int) -> tuple[float, float, float]:
        """Where a group's frame is in the map's."""


@dataclass(frozen=True)
class Batch:
    """A batch and what is to become of it.

    payload: makes another one of the splats' payload, which is sent in place of the arrays then;
    format: of that.
    fields: of the message. values: what others are at (field, index), in place of a good splat's.
    lengths: of arrays that are cut, or filled up with zeros. refused: the field that the error
    names. dropped: splats left out, their slots empty.
    """

    operation: int
    count: int = 0
    fields: dict[str, Any] = field(default_factory=dict)
    values: dict[tuple[str, int], float] = field(default_factory=dict)
    lengths: dict[str, int] = field(default_factory=dict)
    refused: str = ""
    dropped: int = 0
    arrival: Arrival = Arrival.HEARD
    payload: Callable[[bytes], bytes] | None = None
    format: str = QUANTISED

    def message(self, revision: int) -> GaussianArray:
        message = GaussianArray(map_id="map", revision=revision, operation=self.operation)
        message.header.frame_id = "map"
        message.count = self.count
        for name, value in self.fields.items():
            if name == "origin":
                message.origin.x, message.origin.y, message.origin.z = value
            else:
                kind = {"slots": "I", "groups": "I", "channels": "f"}.get(name)
                setattr(message, name, array(kind, value) if kind else value)
        splats = self.count if self.operation in (REPLACE, UPSERT) else 0
        arrays = {name: array("f", list(one) * splats) for name, one in _SPLAT.items()}
        arrays["sh"] = array("f", [0.25] * (3 * (message.sh_degree + 1) ** 2 * splats))
        for i in range(splats):
            arrays["positions"][3 * i] = i
        for (name, i), value in self.values.items():
            arrays[name][i] = value
        for name, length in self.lengths.items():
            arrays[name] = (arrays[name] + array("f", [0.0] * length))[:length]
        for name, values in arrays.items():
            setattr(message, name, values)
        if self.payload:
            _, whole = decode(message)
            message = encode(
                whole, range(message.first_slot, message.first_slot + message.count),
                header=message.header, map_id=message.map_id, revision=message.revision,
                operation=message.operation, compression=self.format,
            )  # fmt: skip
            message.payload = self.payload(bytes(message.payload))
        return message


@dataclass(frozen=True)
class Case:
    """Batches of one map, numbered from 1 unless they say otherwise, and what they leave.

    A refused batch gets a number, too: the map lacks it then.
    """

    name: str
    batches: tuple[Batch, ...]
    in_use: tuple[int, ...] = ()  # slots; none of the others
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    model: int = Model.EWA
    missed: int = 0
    places: dict[int, tuple[float, float, float]] = field(default_factory=dict)  # by group
    channels: tuple[str, ...] = ()
    looked_at: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 9, 10, 1023, 1024, 70000, MOST - 1)


def _replace(count: int = 0, **fields: Any) -> Batch:
    return Batch(REPLACE, count, fields)


def _upsert(count: int = 0, **fields: Any) -> Batch:
    return Batch(UPSERT, count, fields)


def _delete(count: int = 0, **fields: Any) -> Batch:
    return Batch(DELETE, count, fields)


def _move(groups: tuple[int, ...], *poses: Pose, **fields: Any) -> Batch:
    return Batch(MOVE, 0, {"groups": groups, "poses": list(poses)} | fields)


def _pulled(batch: Batch, last: bool = False) -> Batch:
    return replace(batch, arrival=Arrival.LAST if last else Arrival.PULLED)


def _at(x: float, *orientation: float) -> Pose:
    qx, qy, qz, qw = orientation or (0.0, 0.0, 0.0, 1.0)
    return Pose(position=Point(x=x, y=2.0, z=-3.0), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _named(*names: str, **fields: Any) -> Batch:
    """An upsert of two splats with channels."""
    values = [float(i) for i in range(2 * len(names))]
    return _upsert(2, **({"channel_names": names, "channels": values} | fields))


def _refused(field: str, name: str, **batch: Any) -> Case:
    """A batch that contradicts itself leaves the map of the one before."""
    bad = Batch(**{"operation": UPSERT, "count": 2, "refused": field, **batch})
    return Case(f"refused: {name}", (Batch(REPLACE, 2), bad), in_use=(0, 1))


def _dropped(name: str, values: dict[tuple[str, int], float], **fields: Any) -> Case:
    """The second of three splats means nothing."""
    return Case(
        f"left out: {name}",
        (Batch(REPLACE, 3, fields, values, dropped=1),),
        in_use=(0, 2),
        origin=fields.get("origin", (0.0, 0.0, 0.0)),
    )


def _kept(name: str, values: dict[tuple[str, int], float]) -> Case:
    return Case(f"kept: {name}", (Batch(REPLACE, 3, values=values),), in_use=(0, 1, 2))


def _quaternion(*values: float) -> dict[tuple[str, int], float]:
    return {("orientations", 4 + k): value for k, value in enumerate(values)}


def _second_row(at: int, bytes_: bytes, payload: bytes) -> bytes:
    """Puts bytes there in the second of the payload's three packed rows."""
    begin = len(payload) // 3 + at
    return payload[:begin] + bytes_ + payload[begin + len(bytes_) :]


FAR = (4.5e6, -1.0, 2.0)

CASES = (
    # Edits.
    Case(
        "an upsert writes beside what is there",
        (_replace(2), _upsert(2, first_slot=4)),
        in_use=(0, 1, 4, 5),
    ),
    Case("a replace forgets all slots", (_replace(5), _replace(1, first_slot=3)), in_use=(3,)),
    Case("an empty replace empties the map", (_replace(5), _replace()), in_use=()),
    Case("a delete empties slots", (_replace(6), _delete(2, first_slot=2)), in_use=(0, 1, 4, 5)),
    Case(
        "slots are taken as listed, first_slot ignored",
        (_replace(3, slots=[70000, 2, 9], first_slot=4), _delete(1, slots=[2])),
        in_use=(9, 70000),
    ),
    Case(
        "a slot listed twice holds the last",
        (Batch(REPLACE, 3, {"slots": [1, 1, 2]}, {("opacities", 0): NAN}, dropped=1),),
        in_use=(1, 2),
    ),
    Case(
        "a splat that means nothing empties its slot",
        (_replace(3), Batch(UPSERT, 2, values={("opacities", 1): NAN}, dropped=1)),
        in_use=(0, 2),
    ),
    Case(
        "a delete of slots that never were",
        (_replace(2), _delete(MOST - 1, first_slot=1)),
        in_use=(0,),
    ),
    Case("the highest slot", (_replace(1, first_slot=MOST - 1),), in_use=(MOST - 1,)),
    Case("nothing at all", (_replace(2), _upsert(), _delete()), in_use=(0, 1)),
    Case("expected_slots is a hint", (_replace(2, expected_slots=2**32 - 1),), in_use=(0, 1)),
    # Origin and model are those of the first splats since the map was empty.
    Case(
        "the origin of the first splats",
        (_replace(2, origin=FAR), _upsert(2, first_slot=4)),
        in_use=(0, 1, 4, 5),
        origin=FAR,
    ),
    Case(
        "a replace has its own origin",
        (_replace(2), _replace(2, origin=FAR)),
        in_use=(0, 1),
        origin=FAR,
    ),
    Case(
        "a delete heard first has none",
        (_delete(5, model=Model.EWA), _upsert(2, origin=FAR, model=Model.RAY)),
        in_use=(0, 1),
        origin=FAR,
        model=Model.RAY,
    ),
    Case(
        "an empty replace has none",
        (_replace(), _upsert(2, origin=FAR, model=Model.RAY)),
        in_use=(0, 1),
        origin=FAR,
        model=Model.RAY,
    ),
    Case(
        "the model is the first splats'",
        (_replace(1, model=Model.RAY), _upsert(2)),
        in_use=(0, 1),
        model=Model.RAY,
    ),
    # Losses and repeats.
    Case("a gap is counted", (_replace(1), _upsert(2, revision=5)), in_use=(0, 1), missed=3),
    Case(
        "a replace needs nothing before it", (_replace(1), _replace(2, revision=5)), in_use=(0, 1)
    ),
    Case("heard from the middle", (_upsert(2, revision=7),), in_use=(0, 1), missed=6),
    Case(
        "another map_id starts an empty map",
        (_replace(5), _upsert(1, map_id="other", first_slot=2, revision=1)),
        in_use=(2,),
    ),
    # Pulled: what the batches up to a revision have left.
    Case(
        "what is missing is pulled",
        (
            _replace(3),
            _pulled(_delete(1, revision=4)),
            _pulled(_upsert(1, first_slot=9, revision=4), last=True),
            _upsert(1, first_slot=4, revision=5),
        ),
        in_use=(1, 2, 4, 9),
    ),
    Case(
        "all is pulled, whatever was heard before",
        (
            _upsert(2, revision=7, first_slot=4),
            _pulled(_replace(revision=9)),
            _pulled(_upsert(3, revision=9), last=True),
        ),
        in_use=(0, 1, 2),
    ),
    Case(
        "pulled, but not all of it",
        (_upsert(2, revision=7), _pulled(_upsert(1, first_slot=4, revision=7))),
        in_use=(0, 1, 4),
        missed=6,
    ),
    Case(
        "what is pulled makes up for what was missed",
        (_upsert(2, revision=7), _pulled(_upsert(revision=7), last=True)),
        in_use=(0, 1),
    ),
    Case("played once more", (_replace(3), _upsert(4), _replace(1, revision=1)), in_use=(0,)),
    Case(
        "played once more, not from the beginning",
        (_replace(3), _upsert(1, first_slot=4), _upsert(1, first_slot=5, revision=2)),
        in_use=(0, 1, 2, 4, 5),
        missed=1,
    ),
    # Splats that mean nothing are left out, one by one.
    _dropped("a position that is no number", {("positions", 4): NAN}),
    _dropped("an infinite position", {("positions", 3): INF}),
    _dropped("no orientation", _quaternion(0, 0, 0, 0)),
    _dropped("an orientation that is no number", _quaternion(0, NAN, 0, 1)),
    _dropped("an infinite orientation", _quaternion(0, 0, -INF, 1)),
    _dropped("a negative scale", {("scales", 3): -0.1}),
    _dropped("an infinite scale", {("scales", 4): INF}),
    _dropped("a scale that is no number", {("scales", 5): NAN}),
    _dropped("an opacity that is no number", {("opacities", 1): NAN}),
    _dropped("an infinite opacity", {("opacities", 1): INF}),
    _dropped("an opacity of minus infinity", {("opacities", 1): -INF}),
    _dropped("a colour that is no number", {("sh", 3): NAN}),
    _dropped("infinite harmonics", {("sh", 2 * 48 - 1): INF}, sh_degree=3),
    Case(
        "left out: beyond floats once it is relative to the map's origin",
        (_replace(1), Batch(UPSERT, 2, {"origin": (1e300, 0.0, 0.0)}, dropped=2)),
        in_use=(),
    ),
    Case(
        "left out once, for two reasons",
        (
            _replace(1, origin=(1e300, 0.0, 0.0)),
            Batch(UPSERT, 2, {"first_slot": 1}, {("sh", 0): INF}, dropped=2),
        ),
        in_use=(0,),
        origin=(1e300, 0.0, 0.0),
    ),
    Case(
        "a payload's splats are those of the arrays",
        (
            _replace(2, origin=FAR),
            Batch(UPSERT, 3, {"first_slot": 3}, {("scales", 3): NAN}, dropped=1, payload=bytes),
        ),
        in_use=(0, 1, 3, 5),
        origin=FAR,
    ),
    Case(
        "packed splats are those of the arrays",
        (
            _replace(2, origin=FAR),
            Batch(
                UPSERT,
                3,
                {"first_slot": 3},
                {("scales", 3): NAN},
                dropped=1,
                payload=bytes,
                format=PACKED,
            ),
        ),
        in_use=(0, 1, 3, 5),
        origin=FAR,
    ),
    *(
        Case(
            f"left out: a packed splat's {name}",
            (
                Batch(
                    REPLACE, 3, dropped=1, payload=partial(_second_row, at, bytes_), format=PACKED
                ),
            ),
            in_use=(0, 2),
        )
        for name, at, bytes_ in (
            ("position that is no number", 4, NANS),
            ("infinite position", 0, INFS),
            ("infinite unit of harmonics", 26, INFINITE_HALF),
            ("infinite red", 28, INFINITE_HALF),
            ("green that is no number", 30, NAN_HALF),
            ("infinite blue", 32, INFINITE_HALF),
        )
    ),
    Case(
        "left out: packed, beyond floats once it is relative to the map's origin",
        (
            _replace(1),
            Batch(
                UPSERT, 2, {"origin": (1e300, 0.0, 0.0)}, dropped=2, payload=bytes, format=PACKED
            ),
        ),
        in_use=(),
    ),
    Case(
        "kept: packed, whatever else its bits are",
        (
            Batch(
                REPLACE,
                3,
                payload=partial(_second_row, 12, b"\xff" * 15 + b"\x7b"),
                format=PACKED,
            ),
        ),
        in_use=(0, 1, 2),
    ),
    _kept("a tiny quaternion", _quaternion(0, 0, LEAST, LEAST)),
    _kept("a huge quaternion", _quaternion(LARGEST, 0, -LARGEST, LARGEST)),
    _kept("a scale of zero", {("scales", 3): 0.0}),
    _kept("an opacity beyond one", {("opacities", 1): 7.0}),
    _kept("huge harmonics", {("sh", 4): -LARGEST}),
    # Batches that contradict themselves are refused as a whole.
    _refused("revision", "no revision", fields={"revision": 0}),
    _refused("operation", "an unknown operation", operation=4),
    _refused("format", "an unknown format", fields={"format": "draco"}),
    _refused("format", "a delete with a format", operation=DELETE, fields={"format": "quantised"}),
    _refused("payload", "a payload cut short", payload=lambda bytes_: bytes_[:-1]),
    _refused("payload", "no payload", payload=lambda bytes_: bytes_[:0]),
    _refused("payload", "a packed row cut short", payload=lambda b: b[:-1], format=PACKED),
    _refused("payload", "no packed rows", payload=lambda b: b[:0], format=PACKED),
    _refused("format", "a delete of packed rows", operation=DELETE, fields={"format": PACKED}),
    _refused("payload", "a payload and arrays", fields={"payload": b"\0" * 88}),
    _refused("payload", "bounds that are no numbers", payload=lambda bytes_: NANS + bytes_[4:]),
    _refused("payload", "infinite bounds", payload=lambda bytes_: bytes_[:36] + INFS + bytes_[40:]),
    _refused("payload", "bounds the wrong way round", payload=lambda bytes_: UPSIDE + bytes_[8:]),
    _refused("sh_degree", "too many harmonics", fields={"sh_degree": 4}),
    _refused("model", "an unknown model", fields={"model": 4}),
    _refused("origin", "an origin that is no number", fields={"origin": (0.0, NAN, 0.0)}),
    _refused("origin", "an infinite origin", fields={"origin": (INF, 0.0, 0.0)}),
    _refused("positions", "positions cut short", lengths={"positions": 5}),
    _refused("orientations", "an orientation too many", lengths={"orientations": 12}),
    _refused("scales", "no scales", lengths={"scales": 0}),
    _refused("opacities", "an opacity too many", lengths={"opacities": 3}),
    _refused("sh", "harmonics of another degree", lengths={"sh": 24}),
    _refused("slots", "fewer slots than splats", fields={"slots": [1]}),
    _refused("slots", "slots, but no splats", count=0, fields={"slots": [1]}),
    _refused("slots", "a slot too high", fields={"slots": [1, MOST]}),
    _refused("first_slot", "a range too high", fields={"first_slot": MOST - 1}),
    _refused("first_slot", "a range beyond 32 bits", fields={"first_slot": 2**32 - 1}),
    _refused("first_slot", "a delete too high", operation=DELETE, fields={"first_slot": MOST}),
    _refused("positions", "a count beyond the arrays", fields={"count": MOST}, count=2),
    _refused("positions", "a delete with positions", operation=DELETE, lengths={"positions": 6}),
    _refused("sh", "a delete with harmonics", operation=DELETE, lengths={"sh": 6}),
    # Groups: blocks of slots that are of one, and where they are.
    Case(
        "groups have blocks of their own",
        (_replace(2), _upsert(2, first_slot=1023, slots=[1024, 2048], group=7)),
        in_use=(0, 1, 1024),
    ),
    Case(
        "a block of another group is refused",
        (_replace(2), Batch(UPSERT, 2, {"slots": [1024, 9], "group": 7}, refused="group")),
        in_use=(0, 1),
        missed=0,
    ),
    Case(
        "a block that was emptied is whose it is next",
        (_replace(2), _delete(2), _upsert(1, first_slot=9, group=7), _upsert(1, group=7)),
        in_use=(0, 9),
    ),
    Case(
        "splats that mean nothing keep no block",
        (
            Batch(REPLACE, 1, values={("opacities", 0): NAN}, dropped=1),
            _upsert(1, first_slot=9, group=7),
        ),
        in_use=(9,),
    ),
    Case(
        "a replace has other groups",
        (_replace(2, group=7), _replace(2), _upsert(1, first_slot=9)),
        in_use=(0, 1, 9),
    ),
    Case(
        "each group has the origin of its first splats",
        (_replace(2), _upsert(1, first_slot=1024, group=7, origin=FAR)),
        in_use=(0, 1, 1024),
    ),
    Case(
        "groups are where they were placed last",
        (_replace(2), _move((7, 0), _at(1), _at(4)), _move((7,), _at(5e6, 0, 0, 1e-200, 0))),
        in_use=(0, 1),
        places={0: (4, 2, -3), 7: (5e6, 2, -3), 8: (0, 0, 0)},
    ),
    Case(
        "a pose stays when the splats go",
        (_replace(2), _move((0,), _at(1)), _delete(2), _upsert(1, first_slot=9)),
        in_use=(9,),
        places={0: (1, 2, -3)},
    ),
    Case(
        "a pose goes with a replace",
        (_replace(2), _move((0,), _at(1)), _replace(1)),
        in_use=(0,),
        places={0: (0, 0, 0)},
    ),
    Case("a move of nothing", (_replace(2), _move(())), in_use=(0, 1)),
    # Channels: what else there is of each splat.
    Case(
        "channels are those that splats have come with",
        (_named("label", "seen"), _upsert(2, first_slot=2), _named("age", "label")),
        in_use=(0, 1, 2, 3),
        channels=("label", "seen", "age"),
    ),
    Case(
        "a value that is no number is none",
        (_named("label", channels=[NAN, -INF]),),
        in_use=(0, 1),
        channels=("label",),
    ),
    Case(
        "channels go with a replace",
        (_named("label"), _delete(2), _replace(1), _named("seen")),
        in_use=(0, 1),
        channels=("seen",),
    ),
    Case(
        "no splats, no channels",
        (_replace(2), _upsert(0, channel_names=["label"])),
        in_use=(0, 1),
    ),
    Case(
        "a payload's channels are beside it",
        (_replace(2), replace(_named("label", first_slot=2), payload=bytes)),
        in_use=(0, 1, 2, 3),
        channels=("label",),
    ),
    Case(
        "more channels than a map has, from batch to batch",
        (_named(*"abcdefgh"), replace(_named("i", first_slot=2), refused="channel_names")),
        in_use=(0, 1),
        channels=tuple("abcdefgh"),
    ),
    *(
        _refused("channel_names", name, fields={"channel_names": names, "channels": values})
        for name, names, values in (
            ("more channels than a map has", list("abcdefghi"), [0.0] * 18),
            ("a channel without a name", [""], [0.0] * 2),
            ("a channel's name with a space", ["a b"], [0.0] * 2),
            ("a channel's name beyond ASCII", ["\N{SNOWMAN}"], [0.0] * 2),
            ("a channel's name too long", ["x" * 65], [0.0] * 2),
            ("a channel that is there twice", ["a", "b", "a"], [0.0] * 6),
        )
    ),
    _refused(
        "channel_names", "a delete with channels", operation=DELETE, fields={"channel_names": ["a"]}
    ),
    _refused("channels", "channels cut short", fields={"channel_names": ["a"], "channels": [0.0]}),
    _refused("channels", "channels without names", fields={"channels": [0.0] * 2}),
    _refused("group", "a group too high", fields={"group": 32768}),
    _refused("groups", "groups that an upsert moves", fields={"groups": [1]}),
    *(
        Case(f"refused: {name}", (_replace(2), replace(bad, refused=field)), in_use=(0, 1))
        for field, name, bad in (
            ("groups", "a moved group too high", _move((32768,), _at(1))),
            ("groups", "a group that is moved twice", _move((1, 1), _at(1), _at(1))),
            ("poses", "fewer poses than groups", _move((1, 2), _at(1))),
            ("poses", "a pose that is no number", _move((1,), _at(NAN))),
            ("poses", "a pose without orientation", _move((1,), _at(1, 0, 0, 0, 0))),
            ("poses", "an infinite orientation", _move((1,), _at(1, 0, 0, 0, INF))),
            ("count", "a move with splats", replace(_move((1,), _at(1)), count=2)),
            ("slots", "a move with slots", _move((1,), _at(1), slots=[5])),
            ("sh", "a move with harmonics", replace(_move((1,), _at(1)), lengths={"sh": 3})),
        )
    ),
)
