"""What a report says of its campaign beyond the cases: names, versions, how many there must be."""

from collections.abc import Mapping
from dataclasses import dataclass, field


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
    layout: str | None = None
    """Name of a table of its own, such as `florence`."""
