"""`hil check` refuses each fault on a part that the line, network, service or train lacks."""

import shutil
from pathlib import Path
from typing import Final

import pytest

from metro_hil.campaign import CampaignError, read_campaign

EXAMPLES: Final = Path(__file__).resolve().parents[4] / "docs" / "examples" / "line"
ON_LINE: Final = 'title = "t"\n[train]\nline = "florence"\nend = "I"\n'
IN_SERVICE: Final = 'title = "t"\n[train]\nservice = "every_90_s.toml"\ntrains = 3\n'
ALONE: Final = 'title = "t"\n[train]\nservice = "shuttle.toml"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("every_90_s.toml", "shuttle.toml", "terminus.toml", "ferry.toml", "harbour.toml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    return tmp_path


def problems(folder: Path, text: str) -> tuple[str, ...]:
    """The problems of a campaign without path and line; none if it is valid."""
    path = folder / "mine.toml"
    path.write_text(text)
    try:
        read_campaign(str(path))
    except CampaignError as error:
        return tuple(each.split(": ", 1)[1] for each in error.problems)
    return ()


@pytest.mark.parametrize(
    ("head", "fault", "what"),
    [
        (ON_LINE, 'kind = "power_section_off"\nsection = "S7"', "section: 'S7': the line has no"),
        (ON_LINE, 'kind = "switch_lost"\nswitch = "W9"', "switch: 'W9': the line has no switch"),
        (
            ON_LINE,
            'kind = "tag_missed"\ntag_id = 9999',
            "tag_id: 9999: no such tag; nearest",
        ),
        (ON_LINE, 'kind = "brake_weak"\ntrain = 2', "train: 2: the case has 1"),
        (ON_LINE, 'kind = "brake_weak"\ntrip = 2', "trip: 2: the case has 1"),
        (ON_LINE, 'kind = "loop_break"', "kind: loop_break: the train florence4 has no current"),
        (IN_SERVICE, 'kind = "power_section_off"', "section: 'S1': the line has no power sections"),
        (
            IN_SERVICE,
            'kind = "switch_lost"\nswitch = "W9"\ntrain = 1',
            "switch: 'W9': no such switch; ",
        ),
        (IN_SERVICE, 'kind = "switch_lost"\nswitch = "W1"', "train: missing key"),
        (IN_SERVICE, 'kind = "route_set"\nroute = "nowhere"', "route: 'nowhere': no such route; "),
        (IN_SERVICE, 'kind = "track_closed"\ntrack = "loft"', "track: 'loft': no such track; "),
        (IN_SERVICE, 'kind = "tag_displaced"\ntag_id = 77', "tag_id: 77: no such tag; "),
        (IN_SERVICE, 'kind = "brake_weak"\ntrain = 4', "train: 4: the case has 3; choose 1 to 3"),
        (
            f"{IN_SERVICE}masters = true\n",
            'kind = "signal_stop"',
            "kind: signal_stop acts on authorities of the zone controller",
        ),
        (ALONE, 'kind = "brake_weak"\ntrip = 9', "trip: 9: the case has "),
    ],
)
def test_a_fault_on_a_part_that_is_not_there_is_refused(
    folder: Path, head: str, fault: str, what: str
) -> None:
    found = problems(folder, f"{head}[[fault]]\n{fault}\n")

    assert len(found) == 1
    assert found[0].startswith(f"fault[0].{what}"), found


@pytest.mark.parametrize(
    ("head", "fault"),
    [
        (ON_LINE, 'kind = "tag_missed"'),
        (ON_LINE, 'kind = "tag_false"\ntag_id = 9999'),
        (ON_LINE, 'kind = "tag_missed"\ntag_id = 101'),
        (ON_LINE, 'kind = "brake_weak"\ntrain = 1\ntrip = 1'),
        (f"{ON_LINE}consist = 'florence4_loop'\n", 'kind = "loop_break"'),
        (IN_SERVICE, 'kind = "switch_lost"\nswitch = "W1"\ntrain = 3\ntrip = 2'),
    ],
)
def test_a_fault_on_a_part_that_is_there_is_accepted(folder: Path, head: str, fault: str) -> None:
    assert problems(folder, f"{head}[[fault]]\n{fault}\n") == ()


def test_every_fault_that_does_not_fit_is_reported(folder: Path) -> None:
    faults = '[[fault]]\nkind = "switch_lost"\n[[fault]]\nkind = "power_section_off"\n'

    found = problems(folder, ON_LINE + faults)

    assert [each.partition(": ")[0] for each in found] == ["fault[0].switch", "fault[1].section"]


def test_a_sweep_is_refused_for_the_values_that_do_not_fit(folder: Path) -> None:
    fault = '[[fault]]\nkind = "tag_missed"\ntag_id = 101\n'
    sweep = '[sweep]\ndesign = "factorial"\n[sweep.factors]\n"fault.0.tag_id" = [101, 9999, 8888]\n'

    found = problems(folder, ON_LINE + fault + sweep)

    assert len(found) == 2
    assert all(each.startswith("sweep.factors") for each in found), found
    assert "9999: no such tag" in found[0]
    assert "8888: no such tag" in found[1]


def test_a_scenario_inherits_the_place_of_a_fault_that_does_not_fit(folder: Path) -> None:
    own = '[[scenario]]\nname = "a"\n[[scenario.fault]]\nkind = "track_closed"\n'

    found = problems(folder, ON_LINE + own)

    assert found[0].startswith("scenario[0].fault[0].track: 'stem': the line has no switch")
