"""Every transition of a train's role in an area, and every state of a train towards its masters."""

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vobc.train_to_train.roles import (
    ROLES,
    RoleGuardInputs,
    StandingGuardInputs,
    next_role,
    state_of,
)
from vobc.train_to_train.vocabulary import Role, TrainState

OUTSIDE, APPLICANT, MEMBER = Role.OUTSIDE, Role.APPLICANT, Role.MEMBER
STANDBY, CANDIDATE = Role.STANDBY, Role.CANDIDATE
FENCING, MASTER = Role.FENCING, Role.MASTER

AWAY = RoleGuardInputs(*[False] * len(RoleGuardInputs._fields))
"""Guard inputs with every flag false."""
THERE = AWAY._replace(concerned=True)
CALLED = THERE._replace(apply_now=True, may_command=True)
"""Its turn to apply has come, and it may command."""
HOLDS = THERE._replace(lease_granted=True, lease_runs=True)

SIGHTS = st.builds(RoleGuardInputs, *[st.booleans()] * len(RoleGuardInputs._fields))


@pytest.mark.parametrize(
    ("role", "sight", "becomes"),
    [
        (OUTSIDE, AWAY, OUTSIDE),
        (OUTSIDE, THERE, APPLICANT),
        (APPLICANT, AWAY, OUTSIDE),
        (APPLICANT, THERE, APPLICANT),
        (APPLICANT, CALLED, CANDIDATE),
        (APPLICANT, THERE._replace(named_standby=True), STANDBY),
        (APPLICANT, THERE._replace(member=True), MEMBER),
        (MEMBER, AWAY, OUTSIDE),
        (MEMBER, THERE._replace(member=True), MEMBER),
        (MEMBER, THERE, APPLICANT),
        (MEMBER, CALLED._replace(member=True), CANDIDATE),
        (MEMBER, THERE._replace(member=True, named_standby=True), STANDBY),
        (STANDBY, AWAY, OUTSIDE),
        (STANDBY, THERE._replace(named_standby=True), STANDBY),
        (STANDBY, CALLED._replace(named_standby=True), CANDIDATE),
        (STANDBY, THERE, MEMBER),
        (CANDIDATE, THERE, CANDIDATE),
        (CANDIDATE, AWAY, CANDIDATE),
        (CANDIDATE, THERE._replace(candidacy_lost=True), APPLICANT),
        (CANDIDATE, THERE._replace(fenced=True), APPLICANT),
        (CANDIDATE, THERE._replace(lease_granted=True), FENCING),
        (FENCING, HOLDS, FENCING),
        (FENCING, HOLDS._replace(roster_kept=True), MASTER),
        (MASTER, HOLDS, MASTER),
        (MASTER, HOLDS._replace(roster_kept=True), MASTER),
    ],
)
def test_a_role_changes_for_its_reasons_and_for_no_other(
    role: Role, sight: RoleGuardInputs, becomes: Role
) -> None:
    assert next_role(role, sight) is becomes


@pytest.mark.parametrize("role", [APPLICANT, MEMBER, STANDBY])
def test_a_train_that_left_is_outside_whatever_its_other_inputs(role: Role) -> None:
    everything = RoleGuardInputs(*[True] * len(RoleGuardInputs._fields))

    assert next_role(role, everything._replace(concerned=False)) is OUTSIDE


@pytest.mark.parametrize("role", [APPLICANT, MEMBER, STANDBY])
@pytest.mark.parametrize(("turn", "able"), [(True, False), (False, True), (False, False)])
def test_no_train_applies_before_its_turn_or_when_it_may_not_command(
    role: Role, *, turn: bool, able: bool
) -> None:
    sight = THERE._replace(
        apply_now=turn, may_command=able, member=role is MEMBER, named_standby=role is STANDBY
    )

    assert next_role(role, sight) is role


@pytest.mark.parametrize("role", [APPLICANT, MEMBER])
@pytest.mark.parametrize("member", [True, False])
def test_applying_goes_before_standing_by(role: Role, *, member: bool) -> None:
    named = THERE._replace(named_standby=True, member=member)

    assert next_role(role, named) is STANDBY
    assert next_role(role, named._replace(apply_now=True, may_command=True)) is CANDIDATE


@pytest.mark.parametrize("beaten", [{"fenced": True}, {"candidacy_lost": True}])
def test_a_beaten_candidate_takes_no_command_even_with_a_lease(
    beaten: Mapping[str, bool],
) -> None:
    assert next_role(CANDIDATE, HOLDS._replace(**beaten)) is APPLICANT


@pytest.mark.parametrize("role", [FENCING, MASTER])
@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize(
    "over", [{"fenced": True}, {"lease_runs": False}, {"relieved": True}, {"deaf": True}]
)
def test_each_reason_alone_ends_a_command(
    role: Role, over: Mapping[str, bool], *, kept: bool
) -> None:
    assert next_role(role, HOLDS._replace(roster_kept=kept, **over)) is APPLICANT


@given(st.sampled_from(Role), SIGHTS)
def test_no_train_commands_without_a_running_lease_and_a_committed_roster(
    role: Role, sight: RoleGuardInputs
) -> None:
    after = next_role(role, sight)

    if after is MASTER and role is not MASTER:
        assert role is FENCING
        assert sight.roster_kept
    if after is FENCING and role is not FENCING:
        assert role is CANDIDATE
        assert sight.lease_granted
        assert not sight.candidacy_lost
    if after in (FENCING, MASTER):
        assert not sight.fenced
    if after in (FENCING, MASTER) and role in (FENCING, MASTER):
        assert sight.lease_runs
        assert not sight.relieved
        assert not sight.deaf
    if after is CANDIDATE and role is not CANDIDATE:
        assert sight.concerned
        assert sight.may_command


def test_every_role_has_a_way_on() -> None:
    assert set(ROLES) == set(Role)
    assert {target for ways in ROLES.values() for _, target in ways} == set(Role)


@pytest.mark.parametrize(
    ("localised", "young", "areas", "state"),
    [
        (True, True, 1, TrainState.CONTROLLED),
        (True, True, 0, TrainState.CONTROLLED),
        (True, True, 2, TrainState.CO_MANAGED),
        (True, True, 3, TrainState.CO_MANAGED),
        (True, False, 1, TrainState.NON_COMMUNICATING),
        (True, False, 2, TrainState.NON_COMMUNICATING),
        (False, True, 1, TrainState.LOST),
        (False, True, 2, TrainState.LOST),
        (False, False, 0, TrainState.LOST),
    ],
)
def test_the_train_state_follows_from_position_authority_and_areas(
    areas: int, state: TrainState, *, localised: bool, young: bool
) -> None:
    assert state_of(StandingGuardInputs(localised, young, areas)) is state
