"""The train as a mechanical system."""

from plant_emulator.consist.models import MODELS, Car
from plant_emulator.consist.motion import Consist

__all__ = ["MODELS", "Car", "Consist"]
