"""Faults of the tag reader's serial line and of the radio."""

from dataclasses import dataclass

from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


@fault("telegram_torn", FaultPlace.SERIAL, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TelegramTorn:
    """Telegrams lose their end on the line."""

    share_ratio: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)


@fault("telegram_corrupt", FaultPlace.SERIAL, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TelegramCorrupt:
    """Bits of telegrams are flipped on the line."""

    share_ratio: float = 1.0
    bits: int = 1

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)
        check_range(self, "bits", 1, 64)


@fault("telegram_delay", FaultPlace.SERIAL, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TelegramDelay:
    """Telegrams leave late. The reader does not notice, so the ages in them are too small."""

    delay_s: float = 0.1

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 60.0)


@fault("telegram_duplicate", FaultPlace.SERIAL, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TelegramDuplicate:
    """Telegrams arrive again after a while, byte for byte."""

    gap_s: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "gap_s", 0.0, 60.0)


@fault("serial_noise", FaultPlace.SERIAL, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class SerialNoise:
    """Random bytes appear on the line."""

    bytes_per_s: float = 100.0

    def __post_init__(self) -> None:
        check_range(self, "bytes_per_s", 0.0, 11_520.0)


@fault("serial_cut", FaultPlace.SERIAL, Hazard.MISLOCATED, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class SerialCut:
    """The line transmits nothing."""


@fault("radio_loss", FaultPlace.RADIO, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class RadioLoss:
    """Messages do not arrive."""

    loss_ratio: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "loss_ratio", 0.0, 1.0)


@fault("radio_delay", FaultPlace.RADIO, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class RadioDelay:
    """Messages arrive late, by the delay plus up to the jitter; jitter changes their order."""

    delay_s: float = 0.5
    jitter_s: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 60.0)
        check_range(self, "jitter_s", 0.0, 60.0)


@fault("radio_duplicate", FaultPlace.RADIO, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class RadioDuplicate:
    """Messages arrive again after a while."""

    share_ratio: float = 1.0
    gap_s: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)
        check_range(self, "gap_s", 0.0, 60.0)


@fault("radio_reorder", FaultPlace.RADIO, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class RadioReorder:
    """A share of the messages is delayed so that later ones overtake them."""

    share_ratio: float = 0.5
    hold_s: float = 0.7

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)
        check_range(self, "hold_s", 0.0, 60.0)


@fault("radio_partition", FaultPlace.RADIO, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class RadioPartition:
    """Train and wayside receive nothing from each other."""
