"""Two state tables: the role of a train in an area, and its relation to its masters."""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from vobc.train_to_train.vocabulary import Role, TrainState


class RoleGuardInputs(NamedTuple):
    """Inputs of the guards that decide on a train's role in one area."""

    concerned: bool
    """The train is in the area, or will soon be."""
    member: bool
    """The train holds an authority of the area that has not expired."""
    named_standby: bool
    apply_now: bool
    """The master has been silent until this train's turn, or has called this train to take over."""
    may_command: bool
    candidacy_lost: bool
    lease_granted: bool
    lease_runs: bool
    fenced: bool
    """A term higher than that of the train's own lease exists."""
    roster_kept: bool
    relieved: bool
    """No other train is left to command, and this train leaves."""
    deaf: bool
    """The train is master and receives nothing from the trains that it commands."""


def not_concerned(sight: RoleGuardInputs) -> bool:
    return not sight.concerned


def concerned(sight: RoleGuardInputs) -> bool:
    return sight.concerned


def applies(sight: RoleGuardInputs) -> bool:
    return sight.apply_now and sight.may_command


def named_standby(sight: RoleGuardInputs) -> bool:
    return sight.named_standby


def not_named(sight: RoleGuardInputs) -> bool:
    return not sight.named_standby


def is_member(sight: RoleGuardInputs) -> bool:
    return sight.member


def no_member(sight: RoleGuardInputs) -> bool:
    return not sight.member


def beaten(sight: RoleGuardInputs) -> bool:
    return sight.fenced or sight.candidacy_lost


def granted(sight: RoleGuardInputs) -> bool:
    return sight.lease_granted


def command_over(sight: RoleGuardInputs) -> bool:
    return sight.fenced or not sight.lease_runs or sight.relieved or sight.deaf


def roster_kept(sight: RoleGuardInputs) -> bool:
    return sight.roster_kept


Guard = Callable[[RoleGuardInputs], bool]

ROLES: Final[Mapping[Role, tuple[tuple[Guard, Role], ...]]] = {
    Role.OUTSIDE: ((concerned, Role.APPLICANT),),
    Role.APPLICANT: (
        (not_concerned, Role.OUTSIDE),
        (applies, Role.CANDIDATE),
        (named_standby, Role.STANDBY),
        (is_member, Role.MEMBER),
    ),
    Role.MEMBER: (
        (not_concerned, Role.OUTSIDE),
        (applies, Role.CANDIDATE),
        (named_standby, Role.STANDBY),
        (no_member, Role.APPLICANT),
    ),
    Role.STANDBY: (
        (not_concerned, Role.OUTSIDE),
        (applies, Role.CANDIDATE),
        (not_named, Role.MEMBER),
    ),
    Role.CANDIDATE: ((beaten, Role.APPLICANT), (granted, Role.FENCING)),
    Role.FENCING: ((command_over, Role.APPLICANT), (roster_kept, Role.MASTER)),
    Role.MASTER: ((command_over, Role.APPLICANT),),
}


def next_role(role: Role, sight: RoleGuardInputs) -> Role:
    """Follow the first guard that holds. If none holds, the role stays."""
    for guard, target in ROLES[role]:
        if guard(sight):
            return target
    return role


class StandingGuardInputs(NamedTuple):
    """Inputs of the guards that decide on the train's relation to its masters."""

    localised: bool
    authority_young: bool
    areas: int
    """Number of areas that contain some part of the train."""


def lost(standing: StandingGuardInputs) -> bool:
    return not standing.localised


def without_authority(standing: StandingGuardInputs) -> bool:
    return not standing.authority_young


def between_areas(standing: StandingGuardInputs) -> bool:
    return standing.areas > 1


def always(standing: StandingGuardInputs) -> bool:
    return True


STATES: Final[tuple[tuple[Callable[[StandingGuardInputs], bool], TrainState], ...]] = (
    (lost, TrainState.LOST),
    (without_authority, TrainState.NON_COMMUNICATING),
    (between_areas, TrainState.CO_MANAGED),
    (always, TrainState.CONTROLLED),
)
"""The table is the same for every state: the first guard that holds decides."""


def state_of(standing: StandingGuardInputs) -> TrainState:
    return next(state for guard, state in STATES if guard(standing))
