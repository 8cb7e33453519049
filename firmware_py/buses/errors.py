"""Error of a bus that cannot be used."""


class BusError(Exception):
    """A bus cannot be opened or started; the text names it and says what to do."""
