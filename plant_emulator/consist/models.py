"""Models of the train by name: the masses, and the share of each in drive and brake forces."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from plant_emulator.consist.track import GRAVITY_MPS2
from plant_emulator.train_config import ConsistModel, TrainConfig


@dataclass(frozen=True, slots=True)
class Car:
    """One moving mass of a model, with its shares of drive and brake forces."""

    mass_kg: float
    inertia_kg: float
    """Mass including the equivalent of rotating masses."""
    length_m: float
    drive_share: float
    """Share of the tractive effort."""
    motor_brake_share: float
    """Share of the brake force on motor cars."""
    trailer_brake_share: float
    """Share of the brake force on the other cars."""

    @property
    def weight_n(self) -> float:
        return self.mass_kg * GRAVITY_MPS2


def multi_mass(train: TrainConfig) -> tuple[Car, ...]:
    """Model every car as a mass; the cars that take part share each force in proportion to their
    mass.
    """
    masses_kg = [car.tare_kg + train.load_ratio * car.passengers_kg for car in train.cars]
    motor_kg = sum(m for m, car in zip(masses_kg, train.cars, strict=True) if car.motor)
    trailer_kg = sum(masses_kg) - motor_kg
    return tuple(
        Car(
            mass_kg=mass_kg,
            inertia_kg=mass_kg * (1.0 + train.rotating_mass_percent / 100.0),
            length_m=car.length_m,
            drive_share=mass_kg / motor_kg if car.motor else 0.0,
            motor_brake_share=mass_kg / motor_kg if car.motor else 0.0,
            trailer_brake_share=0.0 if car.motor else mass_kg / trailer_kg,
        )
        for mass_kg, car in zip(masses_kg, train.cars, strict=True)
    )


def point_mass(train: TrainConfig) -> tuple[Car, ...]:
    """Model the train as one rigid body of its full length."""
    inertia_kg = train.mass_kg * (1.0 + train.rotating_mass_percent / 100.0)
    return (Car(train.mass_kg, inertia_kg, train.length_m, 1.0, 1.0, 1.0),)


MODELS: Final[Mapping[ConsistModel, Callable[[TrainConfig], tuple[Car, ...]]]] = {
    ConsistModel.MULTI_MASS: multi_mass,
    ConsistModel.POINT_MASS: point_mass,
}
