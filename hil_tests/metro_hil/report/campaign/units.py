"""Units from the last part of a name, and numbers in their usual notation."""

from typing import Final

UNITS: Final = {
    "mps": "m/s",
    "mps2": "m/s²",
    "mps3": "m/s³",
    "kmh": "km/h",
    "m": "m",
    "cm": "cm",
    "mm": "mm",
    "s": "s",
    "ms": "ms",
    "us": "µs",
    "ns": "ns",
    "kg": "kg",
    "n": "N",
    "kn": "kN",
    "w": "W",
    "kw": "kW",
    "j": "J",
    "kj": "kJ",
    "mj": "MJ",
    "kwh": "kWh",
    "v": "V",
    "a": "A",
    "hz": "Hz",
    "ratio": "1",
    "share": "1",
    "percent": "%",
    "permille": "‰",
}
QUALIFIERS: Final = frozenset({"min", "max", "mean", "total", "p50", "p90", "p99", "p999"})


def unit_of(name: str) -> str:
    """Unit of a quantity by its name, such as `m` for `stop_I_error_m`; empty if the name has
    none."""
    words = name.replace(".", "_").split("_")
    while len(words) > 1 and words[-1] in QUALIFIERS:
        words.pop()
    return UNITS.get(words[-1], "") if len(words) > 1 else ""


def number_text(value: float | None) -> str:
    """A number with four significant digits; a dash for None or NaN."""
    if value is None or value != value:
        return "–"
    text = f"{value:.4g}"
    if "e" in text and abs(value) >= 1.0 and abs(value) < 1e9:
        text = f"{value:.0f}"
    return text.replace("-", "−")


def with_unit(value: float | None, unit: str) -> str:
    """Number and unit; the unit `1` is not written."""
    text = number_text(value)
    return text if not unit or unit == "1" or text == "–" else f"{text}\u202f{unit}"


def percent_text(share: float) -> str:
    """A share in per cent that is never rounded up to 100 or down to 0."""
    text = f"{share * 100.0:.1f}"
    if text == "100.0" and share < 1.0:
        return "> 99.9\u202f%"
    if text == "0.0" and share > 0.0:
        return "< 0.1\u202f%"
    return f"{text.removesuffix('.0')}\u202f%"
