"""The reference of campaign files: its examples work, and it explains every key."""

import re
import tomllib
from pathlib import Path
from typing import Final

import pytest

from metro_hil.campaign import define, plan_cases
from metro_hil.campaign.factors import PhaseKeys, RangeKeys
from metro_hil.campaign.schema import (
    HEAD,
    SWEEP,
    TABLES,
    TRAIN,
    BranchKeys,
    ControllerKeys,
    DesignKind,
    TimetableKeys,
)

ROOT: Final = Path(__file__).resolve().parents[4]
TEXT: Final = (ROOT / "docs" / "guide" / "campaigns.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    return blocks(language)[0]


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def test_the_example_is_a_campaign() -> None:
    campaign = define(tomllib.loads(block("toml")), source="campaigns.md").campaign

    cases = plan_cases(campaign)
    delay, weak = campaign.scenarios
    assert len(cases) == delay.case_count + weak.case_count
    assert len(delay.points) >= 50, "each of five delays at each of ten phases"
    assert 30 <= len(weak.points) < 40, "some are excluded"
    assert {case.faults[0]["kind"] for case in cases} == {"brake_late", "brake_weak"}


def test_the_example_of_each_gives_the_documented_names() -> None:
    _, text, *_ = blocks("toml")

    campaign = define(tomllib.loads(text), source="campaigns.md").campaign

    names = {scenario.name for scenario in campaign.scenarios}
    assert names == {"far-predictive", "far-pid_literal", "near"}
    assert all(f"`{name}`" in TEXT for name in names)


def test_the_example_of_random_faults_generates_cases() -> None:
    *_, text = blocks("toml")

    cases = plan_cases(define(tomllib.loads(text), source="campaigns.md").campaign)

    assert len(cases) == 5000
    assert {len(case.faults) for case in cases} == {0, 1, 2}


def test_the_scenario_in_python_gives_cases() -> None:
    names: dict[str, object] = {}

    exec(block("python"), names)  # noqa: S102

    cases = names["cases"]
    assert isinstance(cases, tuple)
    assert len(cases) == 2


@pytest.mark.parametrize(
    "key",
    sorted(
        {
            *HEAD,
            *SWEEP,
            *TABLES,
            *TRAIN,
            *BranchKeys.__dataclass_fields__,
            *ControllerKeys.__dataclass_fields__,
            *TimetableKeys.__dataclass_fields__,
            *PhaseKeys.__dataclass_fields__,
            *RangeKeys.__dataclass_fields__,
            *(design.value for design in DesignKind),
        }
    ),
)
def test_every_key_is_explained(key: str) -> None:
    prose = re.sub(r"^```.*?^```$", "", TEXT, flags=re.MULTILINE | re.DOTALL)

    assert re.search(rf"`[^`\n]*\b{key}\b[^`\n]*`", prose), key
