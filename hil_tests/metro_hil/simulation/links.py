"""How a link between two nodes delays, loses, duplicates and damages messages."""

from dataclasses import dataclass, replace
from typing import Final

NS_PER_MS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Weather:
    """How a link treats messages; each share is the probability for a single message."""

    delay_ns: int = 1 * NS_PER_MS
    spread_ns: int = 2 * NS_PER_MS
    """Upper bound of the random extra delay, uniform. Messages sent closer together than this may
    change their order."""
    loss_share: float = 0.0
    double_share: float = 0.0
    """Share of messages that arrive twice."""
    damage_share: float = 0.0
    """Share of messages that arrive with flipped bits."""
    late_share: float = 0.0
    late_ns: int = 0
    """Upper bound of the extra delay of late messages, whose share is `late_share`."""


CLEAR: Final = Weather()


class SimulatedLink:
    """One direction between two nodes.

    While cut it loses messages, or holds them until it heals.
    """

    __slots__ = (
        *("_watched", "cut", "fair", "keeps", "kept", "source", "standing_ns", "target"),
        "weather",
    )

    def __init__(self, source: int, target: int, weather: Weather = CLEAR) -> None:
        self.source, self.target = source, target
        self.standing_ns = 0
        """Delay of every message for the whole run, in addition to that of the weather."""
        self.weather = weather
        self.cut = 0
        """Number of cuts on the link at present."""
        self.keeps = False
        """Whether messages sent while the link is cut arrive in one burst after it heals, as with
        TCP."""
        self.kept: list[object] = []
        self._watched = False
        self.fair = _is_fair(weather)

    def change(self, weather: Weather) -> None:
        if self.standing_ns:
            weather = replace(weather, delay_ns=weather.delay_ns + self.standing_ns)
        self.weather = weather
        self.fair = _is_fair(weather) and not self._watched

    def watch(self, watched: bool) -> None:
        """While watched, the link passes each message through the network's `meddler`."""
        self._watched = watched
        self.fair = _is_fair(self.weather) and not watched

    def delay(self, standing_ns: int) -> None:
        """Let every message take longer from now on."""
        self.standing_ns = standing_ns
        self.change(self.weather)


def _is_fair(weather: Weather) -> bool:
    """Tell whether only the delay of a message is random."""
    shares = (
        weather.loss_share,
        weather.double_share,
        weather.damage_share,
        weather.late_share,
    )
    return not any(shares)
