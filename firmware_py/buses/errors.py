"""What is said when a bus cannot be used."""


class BusError(Exception):
    """A bus that cannot be opened or started; the text names it and says what to do."""
