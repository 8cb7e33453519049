"""Messages of a simulated line against the TLA+ model: true ones pass, planted ones do not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from firmware_py.storage.recorder import RadioLog, SerialDirection
from firmware_py.trackdb.areas import AreaMap
from metro_hil.formal import check_runs
from metro_hil.formal.check_runs import Overheard
from metro_hil.formal.conformance import JUDGED, check
from metro_hil.simulation.batch import cpu_ns
from metro_hil.simulation.generate import draw
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.network_faults import FaultScale
from metro_hil.simulation.railway_events import RailwayEvents
from metro_hil.simulation.run import Phases, run_seed
from zenoh_config import t2t_keys
from zenoh_config.codec import pack
from zenoh_config.t2t import (
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    ObjectState,
    ObjectStatus,
    RosterAck,
    RosterCommit,
    TrainReport,
)

SEED = 9
"""A seed whose short run lets every guard be judged: takeovers, claims and releases."""
Edit = Callable[[list[Any]], list[Any]]


class Run:
    """The messages of one simulated line in the order of sending, with its areas."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        drawn = draw(SEED, None)
        self.areas: AreaMap = drawn.cast.line
        world = LineWorld(SEED, drawn, codec=Overheard(self.messages.append))
        scale = FaultScale(*drawn.faults_s, foul_share=drawn.foul_share)
        result = run_seed(SEED, world, scale, Phases(15.0), cpu_ns, [RailwayEvents(world, SEED)])
        assert not result.what


@pytest.fixture(scope="module")
def run() -> Run:
    return Run()


def test_the_model_allows_every_message_of_a_simulated_line_and_every_guard_is_judged(
    run: Run,
) -> None:
    judged = check(run.messages, run.areas)

    assert judged.deviations == []
    assert {guard for guards in JUDGED.values() for guard in guards} <= set(judged.looked)


def without(kind: type, where: Callable[[Any], bool] = lambda _: True) -> Edit:
    return lambda said: [each for each in said if not (type(each) is kind and where(each))]


def changed(kind: type, change: Callable[[Any], Any]) -> Edit:
    return lambda said: [change(each) if type(each) is kind else each for each in said]


def last_again(kind: type, change: Callable[[Any], Any], where: Any = lambda _: True) -> Edit:
    """The last such message comes once more at the end, with a change."""

    def edit(said: list[Any]) -> list[Any]:
        found = [each for each in said if type(each) is kind and where(each)]
        return [*said, change(found[-1])]

    return edit


def stolen(said: list[Any]) -> list[Any]:
    """Another train gets the next term at the instant of the last grant."""
    answer = next(each for each in reversed(said) if type(each) is LeaseAnswer and each.granted)
    asked = next(
        each
        for each in reversed(said)
        if type(each) is LeaseRequest and each.stamp_ns == answer.echo_ns
    )
    thief, term = 77, answer.term + 1
    request = replace(asked, source=thief, term=term, kind=LeaseKind.ACQUIRE, boot=1)
    grant = replace(answer, destination=thief, term=term, holder=thief)
    return [*said, request, grant]


def reversed_roster(said: list[Any]) -> list[Any]:
    commit = next(e for e in reversed(said) if type(e) is RosterCommit and len(e.roster) > 1)
    later = replace(commit, version=commit.version + 1, roster=commit.roster[::-1])
    return [*said, later]


PLANTED: dict[str, Edit] = {
    "unused_term": last_again(
        LeaseRequest, lambda m: replace(m, boot=99), lambda m: m.kind is LeaseKind.ACQUIRE
    ),
    "term_is_new": last_again(LeaseAnswer, lambda m: replace(m, holder=77)),
    "lease_is_free": stolen,
    "answers_this_attempt": changed(LeaseAnswer, lambda m: replace(m, term=m.term + 1)),
    "granted_by_majority": without(LeaseAnswer, lambda m: m.granted),
    "OneOwner": last_again(Heartbeat, lambda m: replace(m, source=77)),
    "roster_kept": without(RosterAck),
    "by_holder": last_again(RosterAck, lambda m: replace(m, destination=77)),
    "OrderKept": reversed_roster,
    "for_this_incarnation": changed(AreaAuthority, lambda m: replace(m, to_boot=99)),
    "member.term_not_old": last_again(TrainReport, lambda m: replace(m, term=m.term - 1)),
    "newer_than_held": last_again(
        TrainReport,
        lambda m: replace(m, held_sequence=m.held_sequence - 1),
        lambda m: m.held_term > 0 and m.held_sequence > 0,
    ),
    "latent_authority_m": last_again(
        TrainReport, lambda m: replace(m, latent_m=m.front_max_m - 1.0), lambda m: m.localised
    ),
    "lease_runs": last_again(AreaAuthority, lambda m: replace(m, stamp_ns=m.stamp_ns + 10**10)),
    "ends_behind_rear": last_again(
        AreaAuthority, lambda m: replace(m, end_m=m.end_m + 1e5), lambda m: m.behind
    ),
    "ends_at_border": last_again(AreaAuthority, lambda m: replace(m, end_m=m.end_m + 1e5)),
    "has_promised": without(TrainReport),
    "cannot_reach": changed(TrainReport, lambda m: replace(m, latent_m=1e6, rear_min_m=-1e6)),
    "object.term_not_old": last_again(ObjectStatus, lambda m: replace(m, term=0)),
    "newer_claim": last_again(ObjectStatus, lambda m: replace(m, claim_term=0, nonce=0)),
    "object_confirmed": without(ObjectStatus, lambda m: m.state is ObjectState.LOCKED),
}


def test_a_planted_message_contradicts_each_guard(run: Run) -> None:
    assert set(PLANTED) == {guard for guards in JUDGED.values() for guard in guards}
    for guard, edit in PLANTED.items():
        found = {each.guard for each in check(edit(run.messages), run.areas).deviations}
        assert guard in found, guard


def log_of(folder: Path, messages: list[Any]) -> Path:
    log = RadioLog(folder / "line.log")
    for number, each in enumerate(messages):
        log.message(number, SerialDirection.RX, t2t_keys.key_of("loop", each), pack(each))
    log.close()
    return folder


def test_a_log_passes_and_a_wrong_one_is_refused_by_guard(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check_runs.main([str(log_of(tmp_path, run.messages[:2500]))]) == 0
    assert "the model allows each" in capsys.readouterr().out

    wrong = tmp_path / "wrong"
    wrong.mkdir()
    assert check_runs.main([str(log_of(wrong, PLANTED["roster_kept"](run.messages[:2500])))]) == 1
    assert "roster_kept: train" in capsys.readouterr().out


def test_a_log_without_a_master_proves_nothing(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reports = [each for each in run.messages if type(each) is TrainReport][:5]

    assert check_runs.main([str(log_of(tmp_path, reports))]) == 3
    assert "no evidence: granted_by_majority was never judged" in capsys.readouterr().out


def test_the_log_of_one_train_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = RadioLog(tmp_path / "line.log")
    log.message(0, SerialDirection.TX, "m/loop/w/1/hb/1/all", b"")
    log.close()

    assert check_runs.main([str(tmp_path)]) == 2
    assert "it holds the messages of one train" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--seeds", "9..3"], "9..3 is not a range such as 1..20"),
        (["--seeds", "1..1", "--minutes", "0"], "0 is not a number of minutes"),
    ],
)
def test_wrong_words_end_with_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        check_runs.main(words)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
