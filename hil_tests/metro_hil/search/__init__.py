"""Search for the worst case: what a sweep varies is chosen so that margins become least."""

from metro_hil.search.find import Sought, WorstCaseSearch
from metro_hil.search.space import SearchError, SearchSpace

__all__ = ["WorstCaseSearch", "SearchError", "Sought", "SearchSpace"]
