"""The wire contract: DBC files, and the frame classes that are bound to them."""

from can_dbc.lean_cantools import put_off_tester

put_off_tester()
