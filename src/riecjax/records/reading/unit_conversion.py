"""From the units that loggers write to those that models compute in.

A table, not pint: importing pint and building its registry takes 0.23 s, an eighth of a second run
of `identify`, and it takes `g` for grams and knows no `U/min`.
"""

from typing import NamedTuple

from riecjax.errors import DataError

GRAVITY = 9.80665
_TURN = 6.283185307179586

FACTORS = {
    "m": {"km": 1e3, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "micron": 1e-6, "nm": 1e-9,
          "in": 0.0254, "inch": 0.0254, "ft": 0.3048},
    "m/s": {"km/s": 1e3, "cm/s": 0.01, "mm/s": 1e-3, "um/s": 1e-6, "km/h": 1 / 3.6, "kph": 1 / 3.6,
            "kmh": 1 / 3.6, "mph": 0.44704, "in/s": 0.0254, "ft/s": 0.3048, "kn": 1852 / 3600},
    "m/s^2": {"mm/s2": 1e-3, "cm/s2": 0.01, "g": GRAVITY, "gn": GRAVITY, "g0": GRAVITY,
              "g's": GRAVITY, "mg": 1e-3 * GRAVITY, "ft/s2": 0.3048, "in/s2": 0.0254},
    "N": {"kN": 1e3, "MN": 1e6, "mN": 1e-3, "daN": 10.0, "kgf": GRAVITY, "kp": GRAVITY,
          "lbf": 4.4482216152605},
    "N m": {"kNm": 1e3, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 0.01, "daNm": 10.0},
    "rad": {"deg": _TURN / 360, "°": _TURN / 360, "mrad": 1e-3, "rev": _TURN},
    "rad/s": {"deg/s": _TURN / 360, "°/s": _TURN / 360, "dps": _TURN / 360, "mrad/s": 1e-3,
              "rpm": _TURN / 60, "1/min": _TURN / 60, "U/min": _TURN / 60, "rev/min": _TURN / 60,
              "min-1": _TURN / 60, "rps": _TURN},
    "rad/s^2": {"deg/s2": _TURN / 360, "°/s2": _TURN / 360},
    "Pa": {"hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "mbar": 1e2, "bar": 1e5, "N/mm2": 1e6,
           "psi": 6894.757293168},
    "kg": {"g": 1e-3, "gram": 1e-3, "t": 1e3, "lb": 0.45359237},
    "V": {"mV": 1e-3, "kV": 1e3, "uV": 1e-6},
    "A": {"mA": 1e-3, "kA": 1e3},
    "Wb": {"mWb": 1e-3},
}  # fmt: skip
"""SI unit to the units turned into it, each with the factor to it."""
_SPELLED = str.maketrans({"²": "2", "³": "3", "·": None, "*": None, "^": None, ".": None, " ": None,
                          "µ": "u", "μ": "u", "⁻": "-", "¹": "1"})  # fmt: skip
_LONG = {"sec": "s", "degrees": "deg", "degree": "deg", "grad": "deg", "Grad": "deg", "G": "g"}


class Conversion(NamedTuple):
    """The SI unit that a unit is turned into, and the factor to it."""

    unit: str
    factor: float


def plain(unit: str) -> str:
    """A unit without what is only spelling: m/s2, m/s^2, m/s² and m/s/s are one."""
    parts = [_LONG.get(part, part) for part in unit.translate(_SPELLED).split("/")]
    joined = "/".join(parts)
    return joined.removesuffix("/s/s") + "/s2" if joined.endswith("/s/s") else joined


def conversion(signal: str, unit: str, wanted: str | None) -> Conversion | None:
    """How a signal's unit is turned into SI; `None` where it is SI already, or of no known unit.

    **Arguments:** `wanted`: the unit in which the model reads the signal, where that is known: no
    other is converted to.

    **Raises:** `DataError` for `g` where nothing says whether it is of mass or of acceleration.
    """
    known = plain(unit)
    found = [Conversion(si, table[known]) for si, table in FACTORS.items() if known in table]
    if wanted is not None:
        return next((one for one in found if plain(one.unit) == plain(wanted)), None)
    if len(found) > 1:
        raise DataError(
            f"'{signal}' is in {unit}, which may be of mass or of acceleration; say which: "
            f"units={{'{signal}': 'gn'}} or 'gram' (on the command line: --unit {signal}=gn or "
            f"--unit {signal}=gram)."
        )
    return found[0] if found else None
