"""The options of `vobc run` about desk and wires: what goes together, and where it goes."""

import pytest

from can_dbc.cab import CabMode
from metro_hil.lockstep import scenario_of
from metro_hil.options import parse


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--lockstep", "--desk", "external"], "nobody can drive by hand in virtual time"),
        (["--lockstep", "--bus", "nosuch"], "--bus: not with --lockstep"),
        (["--lockstep", "--plant", "none"], "--plant: not with --lockstep"),
        (["--lockstep", "--tags", "/dev/ttyUSB0"], "--tags: not with --lockstep"),
        (["--lockstep", "--radio", "tcp/127.0.0.1:7447"], "--radio: not with --lockstep"),
        (["--driver", "late", "--desk-recording", "x.desk"], "cannot be played beside --driver"),
        (["--desk", "none", "--driver", "late"], "--driver: there is no desk"),
        (["--desk", "external", "--desk-recording", "x"], "--desk-recording: there is no desk"),
        (["--driver", "asleep"], "invalid choice"),
        (["--desk", "crew"], "invalid choice"),
        (["--line-peer"], "--line-peer: which train is it?"),
        (["--train", "T1", "--line-peer", "--secure", "s"], "--line-peer: not with --secure"),
    ],
)
def test_what_cannot_be_asked_for_is_said(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        parse(["run", *words])

    assert ended.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "mode", "elsewhere"),
    [
        ([], CabMode.AUTO, False),
        (["--desk", "manual"], CabMode.MANUAL, False),
        (["--desk", "off"], CabMode.OFF, False),
        (["--desk", "none"], CabMode.AUTO, True),
    ],
)
def test_the_desk_of_a_run_is_the_plants(words: list[str], mode: CabMode, elsewhere: bool) -> None:
    scenario = scenario_of(parse(["run", "--lockstep", *words]))

    assert (scenario.desk_mode, scenario.desk_elsewhere) == (mode, elsewhere)


def test_a_driver_is_handed_to_the_plant() -> None:
    options = parse(["run", "--lockstep", "--desk", "manual", "--driver", "reckless"])

    assert scenario_of(options).driver == "reckless"
