"""Succession of a master: choice of the standby, and planned switch."""

from collections.abc import Callable, Sequence

from vobc.train_to_train.message_heads import MessageHead
from vobc.train_to_train.planned_switch import PlannedSwitch, SwitchState
from zenoh_config.t2t import BROADCAST, NO_TRAIN, SwitchKind, SwitchStep, T2tMessage


class Succession:
    def __init__(self, own: int, limit_ns: int) -> None:
        self.wanted = NO_TRAIN
        """Train that supervision orders to become master."""
        self.standby = NO_TRAIN
        self.switch = PlannedSwitch(limit_ns)
        self._own = own
        self._aborted = 0

    @property
    def named(self) -> int:
        """Train that may acquire the lease although the present lease still runs."""
        committed = self.switch.state is SwitchState.COMMITTED
        return self.switch.successor if committed else NO_TRAIN

    def choose_standby(self, fit: Sequence[int]) -> None:
        """Keep the standby while it is fit. Otherwise take the rearmost fit train, which stays
        longest.

        Args:
            fit: foremost first.
        """
        if self.standby not in fit:
            self.standby = fit[-1] if fit else NO_TRAIN

    def step(
        self,
        now_ns: int,
        *,
        away: bool,
        fit: Callable[[int], bool],
        ready: Sequence[tuple[int, int]],
    ) -> bool:
        """Advance the planned switch. The result says whether its state changed.

        Args:
            away: the master itself has to leave.
            ready: each train that reports, with the switch for which it is ready.
        """
        wanted = self.wanted or (self.standby if away else NO_TRAIN)
        if wanted == self._own:
            wanted = self.wanted = NO_TRAIN
        switch = self.switch
        if wanted != NO_TRAIN and fit(wanted):
            # The successor must know what a standby knows.
            self.standby = wanted
        before = switch.state
        switch.step(
            now_ns,
            wanted=wanted,
            fit=fit,
            all_ready=lambda: all(nonce == switch.nonce for _, nonce in ready),
        )
        if switch.state is SwitchState.IDLE and before is not SwitchState.IDLE:
            self.wanted = NO_TRAIN
        return switch.state is not before

    def steps(self, now_ns: int, head: Callable[[int, int], MessageHead]) -> list[T2tMessage]:
        """Messages of the switch. They are repeated while it lasts.

        Args:
            head: makes a message header from an instant and a destination.
        """
        switch = self.switch
        if switch.state is SwitchState.PREPARING:
            to, kind = BROADCAST, SwitchKind.PREPARE
        elif switch.state is SwitchState.COMMITTED:
            to, kind = switch.successor, SwitchKind.COMMIT
        elif switch.aborted != self._aborted:
            self._aborted = switch.aborted
            return [
                SwitchStep(*head(now_ns, BROADCAST), SwitchKind.ABORT, switch.aborted, NO_TRAIN)
            ]
        else:
            return []
        return [SwitchStep(*head(now_ns, to), kind, switch.nonce, switch.successor)]
