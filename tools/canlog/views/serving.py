"""Constants of all servers of pages; cheap to import for command lines."""

from typing import Final

LOOPBACK: Final = "127.0.0.1"
PAGE: Final = "text/html; charset=utf-8"
POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:;"
    " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy: the page may request data from this server only."""
