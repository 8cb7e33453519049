"""Messages about the train while the plant runs, and its summary at the end."""

from dataclasses import asdict

from plant_emulator.cli.feed_sender import FeedSender
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.process import PlantDevice


def say(words: str) -> None:
    print(f"plant: {words}", flush=True)


class TrainNotices:
    """Prints events of the train: missing commands, emergency, standstill, doors, faults."""

    def __init__(self, plant: PlantDevice, of: str = "") -> None:
        """`of`: the train's name, if there are several trains."""
        self._plant, self._of = plant, f"{of}, " if of else ""
        self._facts = self._look()
        self._commanded = False
        plant.schedule.listen(self._fault)

    def _fault(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        self._say(f"fault {plan.index}, {plan.kind.name}, {'begins' if active else 'ends'}")

    def _look(self) -> tuple[bool, bool, bool, bool]:
        world = self._plant.world
        silent = world.brake.silent or world.traction.silent or world.doors.silent
        standing = world.speed_mps == 0.0
        return silent, world.brake.emergency_wanted, standing, world.doors.locked

    def tell(self) -> None:
        if not self._commanded and self._plant.wire.commands:
            self._commanded = True
            self._say("a controller sends commands")
        facts = self._look()
        if facts == self._facts:
            return
        world = self._plant.world
        spoken = (
            ("commands are missing", "commands are back"),
            ("emergency brake demanded", "emergency brake released"),
            (f"stands at {world.front_m:.3f} m", f"leaves {world.front_m:.3f} m"),
            ("doors closed and locked", "doors unlocked"),
        )
        for before, now, (yes, no) in zip(self._facts, facts, spoken, strict=True):
            if now is not before:
                self._say(yes if now else no)
        self._facts = facts

    def say_end(self) -> None:
        plant = self._plant
        refused = ", ".join(f"{words}: {n}" for words, n in plant.wire.refusals.items()) or "none"
        self._say(
            f"ended; {plant.wire.commands} commands, frames refused: {refused}; steps made up for: "
            f"{plant.late_steps}, given up: {plant.lost_steps}"
        )

    def _say(self, words: str) -> None:
        say(f"{self._of}{self._plant.elapsed_s:.2f} s: {words}")


def summarise(plant: PlantDevice, feed: FeedSender | None) -> dict[str, object]:
    """Return a summary of delays, refused messages and lost data."""
    never = [f"{plan.index} {plan.kind.name}" for plan in plant.schedule.never_began]
    return {
        "late_steps": plant.late_steps,
        "lost_steps": plant.lost_steps,
        "touched": {str(index): count for index, count in sorted(plant.touched.items())},
        "commands": plant.wire.commands,
        "refused_frames": dict(plant.wire.refusals),
        "refused_reports": {reason.value: n for reason, n in plant.zone.refusals.items()},
        "refused_statuses": {
            reason.value: n for reason, n in plant.railway.centre.refusals.items()
        },
        "command_losses": plant.command_losses,
        "faults_never_began": never,
        "feed_sent": 0 if feed is None else feed.sent,
        "feed_lost": 0 if feed is None else feed.lost,
        "tasks": [asdict(report) for report in plant.executive.report()],
    }
