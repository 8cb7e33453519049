"""Missed, displaced, doubled and false tags, and a dead antenna."""

from collections.abc import Callable
from typing import Any

import pytest

from firmware_py.settings import SettingsError
from firmware_py.tag_reader.telegram import HealthTelegram, TagTelegram, TelegramParser
from firmware_py.trackdb import load_line
from plant_emulator.faults.plan import read_faults
from plant_emulator.sensors.tag_reader import TagPass
from plant_emulator.train_config import load_train

ATrain = Callable[..., Any]
TAGS = load_line("florence").tags
NOISY = load_train("florence4")
FIRST = 6
START_M = TAGS[FIRST].position_m - 10.0
"""Twelve metres before the antenna reaches the first of six tags within 300 m."""


def passes(train: Any, duration_s: float) -> list[TagPass]:
    reader, found = train.world.tag_reader, list[TagPass]()
    for _ in train.each_step(duration_s):
        if reader.last is not None and (not found or reader.last is not found[-1]):
            found.append(reader.last)
    return found


def ids(found: list[TagPass]) -> list[int]:
    return [each.site.tag_id for each in found]


def expected_ids(way_m: float) -> list[int]:
    antenna_m = START_M - 2.0
    return [tag.tag_id for tag in TAGS if antenna_m <= tag.position_m < antenna_m + way_m]


def fast(a_train: ATrain, *faults: dict[str, Any], **options: Any) -> Any:
    return a_train(*faults, speed_mps=20.0, front_m=START_M, **options)


def test_without_a_fault_all_tags_are_read(a_train: ATrain) -> None:
    assert ids(passes(fast(a_train), 20.0)) == expected_ids(400.0)
    assert len(expected_ids(400.0)) > 3


def test_one_tag_is_missed(a_train: ATrain) -> None:
    wanted = expected_ids(400.0)
    found = passes(fast(a_train, {"kind": "tag_missed", "tag_id": wanted[1]}), 20.0)
    assert ids(found) == [wanted[0], *wanted[2:]]


def test_all_tags_are_missed_while_the_fault_lasts(a_train: ATrain) -> None:
    wanted = expected_ids(400.0)
    train = fast(
        a_train, {"kind": "tag_missed", "until": f"front_m > {TAGS[FIRST + 2].position_m + 3.0}"}
    )
    assert ids(passes(train, 20.0)) == wanted[3:]


def test_random_misses_come_from_the_faults_own_seed(a_train: ATrain) -> None:
    share = {"kind": "tag_missed", "share_ratio": 0.5}
    other = {"kind": "tag_missed", "tag_id": 4_000_000, "share_ratio": 0.5}

    def read(*faults: dict[str, Any], seed: int = 1) -> list[int]:
        return ids(passes(fast(a_train, *faults, seed=seed), 60.0))

    alone = read(share)
    assert alone == read(share, other), "another fault does not disturb it"
    assert alone == read({**share, "seed": 1}, seed=9), "its own seed overrides the run's"
    assert len({tuple(read({**share, "seed": seed})) for seed in range(6)}) > 1
    everything = read()
    assert 0 < len(alone) < len(everything)


def test_missing_a_tag_does_not_change_the_noise_of_the_others(a_train: ATrain) -> None:
    healthy = passes(fast(a_train, train=NOISY), 20.0)
    missed = healthy[0].site.tag_id
    faulty = passes(fast(a_train, {"kind": "tag_missed", "tag_id": missed}, train=NOISY), 20.0)

    assert len(healthy) > 3
    assert faulty == healthy[1:]


@pytest.mark.parametrize("offset_m", [5.0, -5.0])
def test_a_displaced_tag_is_read_where_it_lies(a_train: ATrain, offset_m: float) -> None:
    tag = TAGS[FIRST + 2]
    fault = {"kind": "tag_displaced", "tag_id": tag.tag_id, "offset_m": offset_m}
    train, reader = fast(a_train, fault), None
    begin_ns = train.world.now_ns
    found = passes(train, 20.0)

    reader = next(each for each in found if each.site.tag_id == tag.tag_id)
    after_m = tag.position_m + offset_m - (START_M - 2.0)
    assert (reader.true_ns - begin_ns) / 1e9 == pytest.approx(after_m / 20.0, abs=1e-3)
    others = [each for each in found if each is not reader]
    for each in others:
        after_m = each.site.position_m - (START_M - 2.0)
        assert (each.true_ns - begin_ns) / 1e9 == pytest.approx(after_m / 20.0, abs=1e-3)


def test_displaced_tags_return_to_their_places_when_the_fault_ends(a_train: ATrain) -> None:
    train = fast(a_train, {"kind": "tag_displaced", "offset_m": 5.0, "end_s": 0.1})
    begin_ns = train.world.now_ns
    for each in passes(train, 10.0):
        after_m = each.site.position_m - (START_M - 2.0)
        assert (each.true_ns - begin_ns) / 1e9 == pytest.approx(after_m / 20.0, abs=1e-3)


def test_a_doubled_tag_is_read_again_at_the_trains_new_position(a_train: ATrain) -> None:
    tag = TAGS[FIRST]
    train = fast(a_train, {"kind": "tag_duplicate", "gap_s": 0.105, "end_s": 0.65})
    once, twice, *others = passes(train, 15.0)

    assert (once.site, twice.site) == (tag, tag)
    assert twice.true_ns - once.true_ns == 105_000_000
    pulses_per_m = 256 / (3.14159265 * 0.86)
    assert twice.pulses - once.pulses == pytest.approx(20.0 * 0.105 * pulses_per_m, abs=1.1)
    assert ids(others) == expected_ids(300.0)[1:], "once each after the fault"


@pytest.mark.parametrize("gap_m", [0.01, 0.25, 0.5, 3.0])
def test_a_doubled_tag_is_read_again_after_the_gap(a_train: ATrain, gap_m: float) -> None:
    """The train runs at 20 m/s, 0.2 m in a step of the plant."""
    fault = {"kind": "tag_duplicate", "gap_s": 0.0, "gap_m": gap_m, "end_s": 0.65}
    train = fast(a_train, fault)
    once, twice, *others = passes(train, 15.0)

    assert once.site == twice.site == TAGS[FIRST]
    assert (twice.true_ns - once.true_ns) / 1e9 == pytest.approx(gap_m / 20.0, abs=1e-4)
    pulses_per_m = 256 / (3.14159265 * 0.86)
    assert twice.pulses - once.pulses == pytest.approx(gap_m * pulses_per_m, abs=1.1)
    assert ids(others) == expected_ids(300.0)[1:]


def test_the_longer_of_distance_and_time_decides_the_second_reading(a_train: ATrain) -> None:
    fault = {"kind": "tag_duplicate", "gap_m": 0.5, "end_s": 0.65}
    once, soon, *_ = passes(fast(a_train, {**fault, "gap_s": 0.02}), 5.0)
    again, late, *_ = passes(fast(a_train, {**fault, "gap_s": 0.1}), 5.0)

    assert once.true_ns == again.true_ns
    assert (soon.true_ns - once.true_ns) / 1e9 == pytest.approx(0.025, abs=1e-4)
    assert late.true_ns - again.true_ns == 100_000_000


def test_a_train_that_stays_near_a_tag_does_not_read_it_again(a_train: ATrain) -> None:
    fault = {"kind": "tag_duplicate", "gap_s": 0.0, "gap_m": 100.0, "end_s": 0.65}
    assert ids(passes(fast(a_train, fault), 4.0)) == expected_ids(80.0)


def test_a_doubled_tag_is_also_read_again_by_a_train_that_backs(a_train: ATrain) -> None:
    tag = TAGS[FIRST]
    train = a_train(
        {"kind": "tag_duplicate", "gap_s": 0.0, "gap_m": 0.3}, speed_mps=-1.0,
        front_m=tag.position_m + 2.5,
    )  # fmt: skip
    once, twice = passes(train, 2.0)

    assert (twice.true_ns - once.true_ns) / 1e9 == pytest.approx(0.3, abs=0.01)
    assert twice.pulses < once.pulses


def test_a_false_tag_is_read_once_wherever_the_train_is(a_train: ATrain) -> None:
    train = fast(a_train, {"kind": "tag_false", "tag_id": 4_000_000, "start_s": 0.2, "end_s": 9.0})
    begin_ns = train.world.now_ns
    false, *true = passes(train, 10.0)

    assert false.site.tag_id == 4_000_000
    assert false.true_ns == begin_ns + 200_000_000
    assert false.pulses == int(4.0 * 256 / (3.14159265 * 0.86) + 0.5)
    assert ids(true) == expected_ids(200.0)


def test_a_false_tag_of_the_line_has_its_kind(a_train: ATrain) -> None:
    special = next(tag for tag in TAGS if tag.kind is not TAGS[FIRST].kind)
    train = fast(a_train, {"kind": "tag_false", "tag_id": special.tag_id})
    assert passes(train, 0.1)[0].site == special


@pytest.mark.parametrize("hidden", [False, True])
def test_a_dead_antenna_reads_nothing_and_its_next_self_test_detects_it(
    a_train: ATrain, hidden: bool
) -> None:
    fault = {"kind": "antenna_dead", "hidden": hidden, "start_s": 0.3, "end_s": 8.0}
    train = fast(a_train, fault)
    reader, parser, told = train.world.tag_reader, TelegramParser(), []
    for world in train.each_step(14.0):
        for telegram in reader.telegrams(world.now_ns):
            for heard in parser.feed(telegram):
                told.append((train.truth.t_s, heard))
    healths = [(t_s, heard.antenna_ok) for t_s, heard in told if isinstance(heard, HealthTelegram)]
    tags = [t_s for t_s, heard in told if isinstance(heard, TagTelegram)]

    assert not [t_s for t_s in tags if 0.4 < t_s < 8.0]
    assert [t_s for t_s in tags if t_s > 8.0]
    assert any(0.4 < t_s < 8.0 for t_s, _ in healths)
    assert all(ok is (hidden or not 0.3 <= t_s < 8.0) for t_s, ok in healths)
    assert reader.frame(train.world.now_ns).antenna_ok


def test_a_dead_antenna_is_reported_on_the_bus_as_well(a_train: ATrain) -> None:
    train = fast(a_train, {"kind": "antenna_dead"})
    assert train.world.tag_reader.frame(train.world.now_ns).antenna_ok
    for world in train.each_step(3.0):
        train.world.tag_reader.telegrams(world.now_ns)
    assert not train.world.tag_reader.frame(train.world.now_ns).antenna_ok


def test_a_tag_number_that_no_telegram_can_hold_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"scenario: fault\[0\]: tag_id 0 is not within 1"):
        read_faults([{"kind": "tag_false", "tag_id": 0}], "scenario")
