"""The next stop: the mission, and changes by the centre under way."""

from collections.abc import Sequence
from typing import Final

from firmware_py.trackdb import LineMap, Station
from vobc.vocabulary import AtoInput

STOPPING_DECEL_MPS2: Final = 0.55
"""Deceleration that must suffice for a late stop order, after the delay below. Otherwise the order
does not count."""
STOPPING_DELAY_S: Final = 3.0
STOPPING_ROOM_M: Final = 20.0


class StopPlan:
    """Stops in running order, with the one that is approached or served."""

    def __init__(
        self, line: LineMap, start_m: float, stops: Sequence[Station], *, window_m: float
    ) -> None:
        self._line = line
        self._window_m = window_m
        self._stops = tuple(stop for stop in stops if stop.stop_m >= start_m - window_m)
        self._index = 0
        self._run: tuple[float, int, float | None] | None = None
        """The last computed plan: start, stop index and running time."""
        self._skip_heard = False
        self._skipped: Station | None = None
        self._stay_heard = False
        self._stay_at: Station | None = None
        self.served = False
        """The work at the present stop is done, and the next one is the goal."""

    @property
    def next_stop(self) -> Station | None:
        """The stop that is approached or served. None: there is none left."""
        return self._stops[self._index] if self._index < len(self._stops) else None

    def goal(self, *, working: bool) -> Station | None:
        """Destination of the next movement.

        It is beyond the present stop if work there has begun or is done.
        """
        index = self._after() if working or self.served else self._index
        return self._stops[index] if index < len(self._stops) else None

    def at_station(self, front_m: float) -> bool:
        """Whether the front is at the stopping point of a station of the line."""
        before_m, after_m = front_m - self._window_m, front_m + self._window_m
        return len(self._line.stations_between(before_m, after_m)) > 0

    def run_s(self, front_m: float) -> float | None:
        """Planned running time from the station here to the next stop, skipped stations included.

        None: no plan.
        """
        if self._run is None or self._run[0] != front_m or self._run[1] != self._index:
            self._run = front_m, self._index, self._planned_s(front_m)
        return self._run[2]

    def _planned_s(self, front_m: float) -> float | None:
        stop = self.next_stop
        if stop is None:
            return None
        passed = self._line.stations_between(front_m + self._window_m, stop.stop_m)
        times_s = [station.run_s for station in passed]
        return sum(times_s) if times_s and min(times_s) > 0.0 else None

    def depart(self) -> None:
        """Note the departure. From a served stop the next one becomes the goal."""
        if self.served:
            self.served = False
            self._index = self._after()

    def give_up(self) -> bool:
        """Skip a stop that can no longer be made. False if there is no next one."""
        index = self._after()
        if index >= len(self._stops):
            return False
        self.served = False
        self._index = index
        return True

    def stays_at_present_stop(self) -> bool:
        """An order to stop and stay at the next station was given for this one and still holds."""
        return self._stay_heard and self._stay_at is self.next_stop

    def listen(self, inputs: AtoInput, *, working: bool) -> None:
        """Process the orders of the centre.

        An order counts once, for the station that is next when it arrives. For another station it
        has to end and be given again.

        Args:
            working: the train stands at the present stop and its doors are or were open.
        """
        self._listen_for_skip(inputs, working=working)
        self._listen_for_stay(inputs, working=working)

    def _listen_for_skip(self, inputs: AtoInput, *, working: bool) -> None:
        if inputs.skip_next and not self._skip_heard:
            goal = self.goal(working=working)
            # A train always stops at the end of its mission.
            if goal is not None and goal is not self._stops[-1]:
                self._skipped = goal
                if goal is self.next_stop:
                    self._index = self._after()
        elif not inputs.skip_next and self._skipped is not None:
            self._stop_there_after_all(self._skipped, inputs)
        self._skip_heard = inputs.skip_next

    def _stop_there_after_all(self, skipped: Station, inputs: AtoInput) -> None:
        if self._index > 0 and self._stops[self._index - 1] is skipped and not self.served:
            if not _can_stop(skipped, inputs):
                return
            self._index -= 1
        self._skipped = None

    def _listen_for_stay(self, inputs: AtoInput, *, working: bool) -> None:
        if inputs.stop_next and not self._stay_heard:
            self._stay_at = self._next_station(inputs, working=working)
            if self._stay_at is not None and self._stay_at not in self._stops:
                index = self._index + 1 if working or self.served else self._index
                self._stops = (*self._stops[:index], self._stay_at, *self._stops[index:])
        self._stay_heard = inputs.stop_next

    def _next_station(self, inputs: AtoInput, *, working: bool) -> Station | None:
        """The first station of plan or line at which the train can still stop."""
        goal = self.goal(working=working)
        here = self.next_stop if working or self.served else None
        for station in self._line.stations:
            if goal is not None and station.stop_m >= goal.stop_m:
                break
            if _can_stop(station, inputs) and (here is None or station.stop_m > here.stop_m):
                return station
        return goal

    def _after(self) -> int:
        index = self._index + 1
        if index < len(self._stops) and self._stops[index] is self._skipped:
            index += 1
        return index


def _can_stop(station: Station, inputs: AtoInput) -> bool:
    speed_mps = max(0.0, inputs.speed_mps)
    needed_m = speed_mps * (STOPPING_DELAY_S + speed_mps / (2.0 * STOPPING_DECEL_MPS2))
    return station.stop_m - inputs.front_m > needed_m + STOPPING_ROOM_M
