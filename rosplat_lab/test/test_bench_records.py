"""Statistics of samples, records on disk, and the budget of repetitions."""

import errno
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rosplat_core.program import machine
from rosplat_core.splats import InputError
from rosplat_lab.bench.records import (
    Budget,
    Measurement,
    Record,
    load,
    save,
)

HERE = {
    "machine": "a box", "gpu": "a card", "driver": "1.2", "commit": "abc",
    "command": "bench sort", "time": "2026-01-01T00:00:00Z", "load": 0.5,
}  # fmt: skip


def test_percentiles_are_interpolated_between_samples() -> None:
    measured = Measurement("order", "ms", np.arange(101.0), "scene", 7, method="native")
    record = Record.of("sort", measured, HERE)
    assert (record.value, record.p50, record.p95, record.p99) == (50, 50, 95, 99)
    assert (record.least, record.most, record.n) == (0, 100, 101)
    assert (record.scene, record.splats, record.parameters) == ("scene", 7, {"method": "native"})
    assert (record.machine, record.gpu, record.load) == ("a box", "a card", 0.5)
    between = Record.of("sort", Measurement("order", "ms", [1.0, 2.0]), HERE)
    assert between.p50 == 1.5
    assert between.p95 == pytest.approx(1.95)


def test_one_sample_is_all_of_its_percentiles() -> None:
    record = Record.of("frame", Measurement("memory", "MB", 42), HERE)
    assert (record.value, record.p50, record.p95, record.p99, record.n) == (42, 42, 42, 42, 1)


def test_what_drew_takes_the_place_of_the_machine_s_gpu() -> None:
    assert Record.of("frame", Measurement("a", "ms", 1, gpu="llvmpipe"), HERE).gpu == "llvmpipe"


@pytest.mark.parametrize("samples", [[], [1.0, math.nan], [math.inf]])
def test_samples_that_say_nothing_are_refused(samples: list[float]) -> None:
    with pytest.raises(ValueError, match="order: expected one or more finite samples"):
        Measurement("order", "ms", samples)


def test_records_come_back_from_disk_as_they_were(tmp_path: Path) -> None:
    records = [
        Record.of("sort", Measurement("order", "ms", [1, 2, 3], "s", n, culls=True), HERE)
        for n in (10, 20)
    ]
    save(tmp_path / "a.json", records)
    save(tmp_path / "b.json", [replace(records[0], commit="def")])
    assert load([tmp_path / "a.json"]) == records
    assert [r.commit for r in load([tmp_path / "a.json", tmp_path / "b.json"])] == [
        "abc", "abc", "def",
    ]  # fmt: skip
    assert json.loads((tmp_path / "a.json").read_text())[1]["splats"] == 20


def test_a_full_disk_leaves_the_records_that_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.json"
    records = [Record.of("sort", Measurement("order", "ms", 1), HERE)]
    save(path, records)

    def fill(partial: Path, text: str, **_: str) -> None:
        with partial.open("w") as file:
            file.write(text[: len(text) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fill)
    with pytest.raises(OSError, match="No space"):
        save(path, 2 * records)
    assert load([path]) == records


@pytest.mark.parametrize("text", [None, "{", "3", '[{"name": "order"}]', '["order"]', 9999 * "["])
def test_a_file_without_records_is_named(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "wrong.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=r"wrong\.json"):
        load([path])


def test_a_field_that_a_record_lacks_is_named(tmp_path: Path) -> None:
    path = tmp_path / "records.json"
    save(path, [Record.of("sort", Measurement("order", "ms", 1), HERE)])
    path.write_text(path.read_text().replace('"splats"', '"spalts"'))
    with pytest.raises(InputError, match=r"records\.json: .* record 0 lacks splats"):
        load([path])


def test_a_budget_repeats_at_least_at_most_and_for_its_time() -> None:
    def count(budget: Budget) -> list[float]:
        return budget.spend(float)

    assert count(Budget(least=3, most=10, seconds=0)) == [0, 1, 2]
    assert count(Budget(least=3, most=10, seconds=1e9)) == list(range(10))


def test_the_first_call_does_not_count() -> None:
    calls: list[int] = []

    def run(index: int) -> float:
        calls.append(index)
        return 1.0 if len(calls) > 1 else 1000.0

    assert Budget(least=2, most=2, seconds=0).spend(run) == [1.0, 1.0]
    assert calls == [0, 0, 1]


def test_a_process_s_memory_grows_by_what_it_touches() -> None:
    before = machine.resident_bytes()
    held = np.ones(64 << 20, np.uint8)
    assert machine.resident_bytes() - before == pytest.approx(held.nbytes, rel=0.1)
    assert machine.resident_bytes(2**22 + 1) == 0  # above the largest process id
