"""Search for the worst case: what a sweep varies is chosen so that margins become least."""

from metro_hil.search.find import Search, Sought
from metro_hil.search.space import SearchError, Space

__all__ = ["Search", "SearchError", "Sought", "Space"]
