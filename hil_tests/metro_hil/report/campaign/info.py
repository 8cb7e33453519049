"""Head of a campaign's report: names, versions, number of cases."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from metro_hil.model.case import subset_text


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignInfo:
    """The head of a report. It must be equal for two runs of the same campaign."""

    name: str
    title: str = ""
    description: str = ""
    bench: str = "lockstep"
    """Benches as values of `BenchKind`, joined by commas."""
    controller: str = "shipped"
    """Text about the controller under test."""
    fingerprint: str = ""
    """Hash over definition, files and program; equal fingerprints mean equal campaigns."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Versions by program."""
    expected_cases: int
    """Number of cases that the manifest names; with fewer results the campaign fails."""
    planned_cases: int = 0
    """Number of cases of the whole campaign; more than `expected_cases` if only some were
    selected."""
    layout: str | None = None
    """Name of the campaign's own table, such as `florence`."""

    @property
    def subset(self) -> str:
        """Text such as `3 of 8 cases`; empty if all cases of the campaign were selected."""
        return subset_text(self.expected_cases, self.planned_cases)
