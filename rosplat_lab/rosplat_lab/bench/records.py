"""What was measured, and where, as JSON: a list of records, each complete by itself."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rosplat_core.formats.bounds import naming_the_file, refusing
from rosplat_core.program.files import write_text

Parameter = str | int | float | bool


class Measurement:
    """Samples of one quantity, as a subject took them.

    samples: one or more, in `unit`. scene: what it was measured on, of `splats` splats. parameters:
    what tells it apart from others of its name; numbers are also results that belong to it. gpu:
    what drew, where it isn't the machine's NVIDIA GPU.
    """

    def __init__(
        self, name: str, unit: str, samples: ArrayLike, scene: str = "", splats: int = 0,
        gpu: str = "", **parameters: Parameter,
    ) -> None:  # fmt: skip
        """Raises ValueError for no sample, or one that is not finite."""
        self.name, self.unit, self.scene, self.splats, self.gpu = name, unit, scene, splats, gpu
        self.parameters = parameters
        self.samples = np.atleast_1d(np.asarray(samples, np.float64))
        if not self.samples.size or not np.isfinite(self.samples).all():
            raise ValueError(f"{name}: expected one or more finite samples, got {self.samples}")


@dataclass(frozen=True)
class Skipped:
    """Something that this machine lacks; the text says what was left out, and why."""

    text: str


@dataclass(frozen=True)
class Doing:
    """What a subject is about to do, and how much of it is done, 0 to 1."""

    text: str
    part: float


Event = Measurement | Skipped | Doing
"""What subjects yield."""


def in_a_row(jobs: Sequence[Callable[[], Iterator[Event]]]) -> Iterator[Event]:
    """The events of jobs, one after the other, as those of one."""
    for number, job in enumerate(jobs):
        for event in job():
            if isinstance(event, Doing):
                event = replace(event, part=(number + event.part) / len(jobs))
            yield event


@dataclass(frozen=True)
class Record:
    """A measurement with its statistics and circumstances, which are empty where a machine lacks
    them: what is written."""

    subject: str
    name: str
    value: float
    """The median, or the only sample."""
    unit: str
    n: int
    p50: float
    p95: float
    p99: float
    least: float
    most: float
    scene: str
    splats: int
    parameters: dict[str, Parameter]
    machine: str
    gpu: str
    driver: str
    commit: str
    command: str
    time: str
    load: float
    """Programs that wanted a processor, the measured ones among them; the last minute's mean."""

    @classmethod
    def of(cls, subject: str, measured: Measurement, circumstances: dict[str, Any]) -> Record:
        """circumstances: the last seven fields. Percentiles are interpolated linearly between
        samples."""
        samples = measured.samples
        p50, p95, p99 = (float(value) for value in np.percentile(samples, [50, 95, 99]))
        return cls(
            subject=subject,
            name=measured.name,
            value=p50,
            unit=measured.unit,
            n=len(samples),
            p50=p50,
            p95=p95,
            p99=p99,
            least=float(samples.min()),
            most=float(samples.max()),
            scene=measured.scene,
            splats=measured.splats,
            parameters=measured.parameters,
            **(circumstances | ({"gpu": measured.gpu} if measured.gpu else {})),
        )


def save(path: Path, records: Sequence[Record]) -> None:
    """Writes a list of records, each on a line of its own, in place of the file, if any."""
    lines = ",\n".join(json.dumps(asdict(record)) for record in records)
    write_text(path, f"[\n{lines}\n]\n")


def load(paths: Iterable[Path]) -> list[Record]:
    """The records of files, in order. Raises InputError for one that holds none."""
    known = {entry.name for entry in fields(Record)}
    records = []
    for path in paths:
        with naming_the_file(path), refusing(f"{path}: holds no records of a benchmark"):
            for number, entry in enumerate(json.loads(path.read_text(encoding="utf-8"))):
                if not isinstance(entry, dict):
                    raise ValueError(f"record {number} is no object")
                if lacking := known - entry.keys():
                    raise ValueError(f"record {number} lacks {', '.join(sorted(lacking))}")
                records.append(Record(**{name: entry[name] for name in known}))
    return records


@dataclass(frozen=True)
class Budget:
    """How often something is repeated: at least `least`, at most `most` times, for `seconds`."""

    least: int
    most: int
    seconds: float

    def spend(self, run: Callable[[int], float], warm_up: float = 0.0) -> list[float]:
        """What run(0), run(1), ... return, after uncounted runs for warm_up [s], one at least."""
        end, runs = perf_counter() + warm_up, 0
        while not runs or perf_counter() < end:
            run(runs)
            runs += 1
        samples: list[float] = []
        end = perf_counter() + self.seconds
        while len(samples) < self.most and (len(samples) < self.least or perf_counter() < end):
            samples.append(run(len(samples)))
        return samples


def milliseconds(run: Callable[[], object]) -> float:
    """How long a call takes."""
    start = perf_counter()
    run()
    return 1e3 * (perf_counter() - start)
