"""What a report says of its campaign beyond the cases: names, versions, how many there must be."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from metro_hil.model.case import subset_text


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignInfo:
    """The head of a report. Nothing in it may differ between two runs of the same campaign."""

    name: str
    title: str = ""
    description: str = ""
    bench: str = "lockstep"
    """`BenchKind` by value; several joined by a comma."""
    controller: str = "shipped"
    """What is under test, in words."""
    fingerprint: str = ""
    """Hash over definition, files and program; two campaigns with the same one are the same."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Program to version."""
    expected_cases: int
    """How many the manifest names; fewer results than this make the campaign a failure."""
    planned_cases: int = 0
    """How many the whole campaign has; more than `expected_cases` where only some were chosen."""
    layout: str | None = None
    """Name of a table of its own, such as `florence`."""

    @property
    def subset(self) -> str:
        """Such as `3 of 8 cases`; empty where all cases of the campaign were chosen."""
        return subset_text(self.expected_cases, self.planned_cases)
