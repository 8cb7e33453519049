"""Reports of runs and campaigns: tables, plots, pages."""
