"""Searches for the worst case: chooses values of swept keys that minimise the margins."""

from metro_hil.search.find import Sought, WorstCaseSearch
from metro_hil.search.space import SearchError, SearchSpace

__all__ = ["WorstCaseSearch", "SearchError", "Sought", "SearchSpace"]
