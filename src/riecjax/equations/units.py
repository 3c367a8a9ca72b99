"""Units of coefficients: of a force over powers of signals, spelled as users spell them."""

import re
from collections import Counter

_FACTOR = re.compile(r"([^\W\d]+|1)(?:\^?(-?\d+))?")


def per(unit: str, of: str, power: int = 1) -> str:
    """A unit over a power of another: `per("N", "m/s", 2)` is `N s^2/m^2`.

    Empty where either is not known.
    """
    if not unit or (not of and power):
        return ""
    powers = _powers(unit)
    for name, exponent in _powers(of).items():
        powers[name] -= power * exponent
    above = [_spelled(name, p) for name, p in powers.items() if p > 0]
    below = [_spelled(name, -p) for name, p in powers.items() if p < 0]
    front = " ".join(above) or "1"
    if not below:
        return front if above else ""
    return f"{front}/{below[0] if len(below) == 1 else '(' + ' '.join(below) + ')'}"


def _powers(unit: str) -> Counter[str]:
    found: Counter[str] = Counter()
    above, *below = unit.split("/")
    for sign, part in ((1, above), *((-1, part) for part in below)):
        for name, exponent in _FACTOR.findall(part):
            if name != "1":
                found[name] += sign * int(exponent or 1)
    return found


def _spelled(name: str, power: int) -> str:
    return name if power == 1 else f"{name}^{power}"
