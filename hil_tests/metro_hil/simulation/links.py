"""What the way from one node to another does to messages."""

from dataclasses import dataclass
from typing import Final

NS_PER_MS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Weather:
    """How a link treats each message; shares are drawn for each message by itself."""

    delay_ns: int = 1 * NS_PER_MS
    spread_ns: int = 2 * NS_PER_MS
    """Added to the delay, uniformly. Messages sent closer together than this change their order."""
    loss_share: float = 0.0
    double_share: float = 0.0
    """Come a second time."""
    damage_share: float = 0.0
    """Come with flipped bits."""
    late_share: float = 0.0
    late_ns: int = 0
    """So many come later still, by up to so much."""


CLEAR: Final = Weather()


class SimulatedLink:
    """One direction between two nodes. A cut one loses messages, or keeps them until it heals."""

    __slots__ = ("_watched", "cut", "fair", "keeps", "kept", "source", "target", "weather")

    def __init__(self, source: int, target: int, weather: Weather = CLEAR) -> None:
        self.source, self.target = source, target
        self.weather = weather
        self.cut = 0
        """How many cuts lie on it at present."""
        self.keeps = False
        """What is sent while it is cut comes in one burst after it heals, as TCP has it."""
        self.kept: list[object] = []
        self._watched = False
        self.fair = _is_fair(weather)

    def change(self, weather: Weather) -> None:
        self.weather = weather
        self.fair = _is_fair(weather) and not self._watched

    def watch(self, watched: bool) -> None:
        """Nothing passes unseen while it is watched."""
        self._watched = watched
        self.change(self.weather)


def _is_fair(weather: Weather) -> bool:
    """Nothing is to be drawn but the delay."""
    shares = (
        weather.loss_share,
        weather.double_share,
        weather.damage_share,
        weather.late_share,
    )
    return not any(shares)
