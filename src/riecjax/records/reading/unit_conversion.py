"""From the units that loggers write to those that models compute in."""

import re
from typing import NamedTuple

from riecjax.errors import DataError
from riecjax.records.reading.channels import BY_ATTRIBUTE, Channels
from riecjax.records.reading.time_columns import unit_of_time
from riecjax.records.reading.unit_expressions import USUAL, readings, same, usual_name
from riecjax.records.reading.units import DOUBTFUL, is_known, unit_behind


class Conversion(NamedTuple):
    """The SI unit that a unit is turned into, and the factor to it."""

    unit: str
    factor: float


def conversion(signal: str, unit: str, wanted: str | None) -> Conversion | None:
    """How a signal's unit is turned into SI; `None` where it is SI already, or of no known unit.

    **Arguments:** `wanted`: the unit in which the model reads the signal, where that is known: no
    other is converted to.

    **Raises:** `DataError` where a unit has two meanings and nothing says which, as `g`, of mass
    or of acceleration; and for `mm or m`, where a file says both.
    """
    if BY_ATTRIBUTE in unit:
        stated, _, attribute = unit.partition(BY_ATTRIBUTE)
        raise DataError(
            f"'{signal}' holds whole numbers, and its dataset has an attribute '{attribute}': say "
            f"whether they are counts, to be multiplied: scale={{'{signal}': ...}} (on the command "
            f"line: --scale {signal}=FACTOR), or {stated} already (--unit {signal}={stated})."
        )
    if " or " in unit:
        raise DataError(
            f"the name of '{signal}' and the row of units say {unit}; say which: units={{'{signal}'"
            f": '{unit.split()[0]}'}} (on the command line: --unit {signal}={unit.split()[0]})."
        )
    if wanted is not None and same(unit, wanted):
        return None
    names = USUAL if wanted is None else (wanted,)
    targets = {target.powers: target for name in names for target in readings(name).values()}
    found = {
        spelled: Conversion(wanted or usual_name(one), one.factor / targets[one.powers].factor)
        for spelled, one in readings(unit).items()
        if one.powers in targets
    }
    if len(found) > 1:
        kinds = " or ".join(
            f"{spelled} ({usual_name(readings(unit)[spelled])})" for spelled in found
        )
        typed = " or ".join(f"--unit {signal}={spelled}" for spelled in found)
        raise DataError(
            f"'{signal}' is in {unit}, which may be {kinds}; say which: units={{'{signal}': "
            f"'{next(iter(found))}'}} (on the command line: {typed})."
        )
    one = next(iter(found.values()), None)
    return one if one and (one.factor != 1 or wanted is not None) else None


def stated_unit(channels: Channels, column: str, mapped: str) -> str | None:
    """A column's unit as the file states it, or the column's name.

    **Arguments:** `mapped`: the signal that the user calls it, where he does: then a unit behind
    the name, as in `x_mm`, counts as well.
    """
    behind = unit_of_time(column) if mapped == "t" else unit_behind(column) if mapped else None
    return channels.named(column)[1] or behind


def require_known_unit(signal: str, unit: str) -> None:
    """Refuse a unit that nothing can be converted from with a `DataError`."""
    if not (is_known(unit) or readings(unit) or " since " in unit):
        raise DataError(
            f"the unit '{unit}' of '{signal}' is not known; multiply by a factor instead: scale="
            f"{{'{signal}': ...}} (on the command line: --scale {signal}=FACTOR)."
        )


def require_sure_unit(signal: str, column: str, wanted: str) -> None:
    """Refuse a column such as `x_cm` where that may be a unit of the kind that the model reads.

    **Raises:** `DataError` that asks for the unit.
    """
    tail = re.split(r"[ _.-]", column)[-1]
    if wanted and tail != column and tail in DOUBTFUL and conversion(signal, tail, wanted):
        raise DataError(
            f"column '{column}' may be in {tail}, or be called so for another reason; say its unit:"
            f" units={{'{signal}': '{tail}'}} or '{wanted}' (on the command line: --unit"
            f" {signal}={tail} or --unit '{signal}={wanted}')."
        )
