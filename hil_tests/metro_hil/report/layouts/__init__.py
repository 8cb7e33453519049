"""Tables of their own that a campaign with `layout = "..."` shows beside the common report.

A layout is one module with one function, named in `LAYOUTS`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from metro_hil.cases import Case, CaseResult
from metro_hil.report.layouts.florence import florence_tables
from metro_hil.report.layouts.tables import LayoutTable

Pairs = Sequence[tuple[Case, CaseResult | None]]
LAYOUTS: Final[Mapping[str, Callable[[Pairs], list[LayoutTable]]]] = {"florence": florence_tables}
"""By the name in the campaign's file: from cases, None where no result came back, to tables."""
