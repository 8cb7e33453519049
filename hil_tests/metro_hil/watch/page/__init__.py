"""The page of `hil serve`: HTML, style and script."""
