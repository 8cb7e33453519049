"""Unsafe rules of [Wu 2022], each in a situation that shows the hazard, beside the safe rules."""

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_rig import MS, Rig, line_of
from vobc.train_to_train.guards import TrainGuards
from vobc.train_to_train.paper_literal import (
    ANY_AUTHORITY_IS_SAFE,
    RULES,
    SAFE,
    SILENCE_MEANS_NO_MASTER,
)
from zenoh_config.t2t import AreaAuthority, ObjectState, T2tMessage


def trains_without_mutual_radio(guards: TrainGuards) -> None:
    """The second train enters the area while the radio link between the two is down."""
    rig = Rig(line_of(0.0, 4000.0), guards=guards)
    rig.start_train(1, 1500.0)
    rig.run(2000)
    rig.spoil = lambda message, to: [] if {message.source, to} == {1, 2} else [5]
    rig.start_train(2, 500.0)

    rig.run(5000)

    assert rig.trains[2].held is None


def test_taking_silence_for_a_missing_master_gives_one_metre_to_two_trains() -> None:
    trains_without_mutual_radio(SAFE)

    with pytest.raises(AssertionError, match="train 2 may come to"):
        trains_without_mutual_radio(SILENCE_MEANS_NO_MASTER)


def late_authority_of_the_former_master(guards: TrainGuards) -> None:
    """The former master lets a train over a crossing and fails; its message takes 900 ms.

    Meanwhile the new master has received the train's report: it holds no authority over the
    crossing and acknowledges the new term. The new master lets the crossing open.
    """
    rig = Rig(line_of(0.0, 4000.0, section_m=100.0, objects=[(1600.0, 1620.0)]), guards=guards)
    rig.wanted = {1}
    for address, front_m in ((1, 1560.0), (2, 700.0), (3, 400.0)):
        rig.start_train(address, front_m)
    rig.kill(1)
    rig.run(1000)
    rig.restart(1)
    first = rig.trains[1]
    rig.run(12_000)
    (old,) = rig.masters()

    def slow_for_the_first(message: T2tMessage, to: int) -> list[int]:
        return [900] if to == 1 and isinstance(message, AreaAuthority) else [5]

    rig.spoil = slow_for_the_first
    rig.wanted = set()
    rig.run_until(lambda: any(_lets_over(m, rig.now_ns - at) for at, m in rig.log[-200:]), 3000)
    rig.spoil = lambda message, to: [5]
    rig.kill(old)
    rig.wanted = {1}
    rig.run_until(lambda: rig.objects[1].memory.state is ObjectState.FREE, 800)

    rig.run(2000)

    assert first.front_m < 1600.0


def _lets_over(message: T2tMessage, age_ns: int) -> bool:
    return (
        isinstance(message, AreaAuthority)
        and message.destination == 1
        and message.end_m > 1620.0
        and age_ns < 100 * MS
    )


def test_obeying_either_of_two_masters_leads_onto_an_open_crossing() -> None:
    late_authority_of_the_former_master(SAFE)

    with pytest.raises(AssertionError, match="train 1 may enter object 1"):
        late_authority_of_the_former_master(ANY_AUTHORITY_IS_SAFE)


def test_the_rules_are_selected_by_name_and_default_to_the_safe_ones() -> None:
    assert RULES["safe"] == TrainGuards()
    assert len({id(each) for each in RULES.values()}) == len(RULES)
