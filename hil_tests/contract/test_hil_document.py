"""docs/guide/hil.md agrees with the code: its measures and its example scenario."""

import re
from pathlib import Path

from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.metrics.case import NAMES

DOCUMENT = (Path(__file__).resolve().parents[2] / "docs" / "guide" / "hil.md").read_text(
    encoding="utf-8"
)


def test_every_measure_is_in_the_table_with_its_text() -> None:
    """When this fails, add the line that it names to the document."""
    for name, words in NAMES.items():
        assert f"| `{name}` | {words} |" in DOCUMENT, name


def test_the_example_scenario_is_read_without_complaint(tmp_path: Path) -> None:
    example = re.findall(r"^```toml\n(title.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL)[0]
    path = tmp_path / "runaway.toml"
    path.write_text(example, encoding="utf-8")

    cases = plan_cases(read_campaign(str(path)))

    assert len(cases) == 2 * 3 * 5
