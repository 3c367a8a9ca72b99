"""Integral refinement: the criterion of eq. (17) for equations that are not linear in theta."""

from typing import Any

import numpy as np

from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.criteria.windows import DEFAULT_BAND
from riecjax.records.record import Record
from riecjax.refinement.balance import ParametricBalance, as_balances
from riecjax.refinement.integral_misfit import IntegralMisfit
from riecjax.refinement.objective import AbstractObjective, Parameters, Setup


class IntegralError(AbstractObjective):
    """Impulses of the equation error over windows, as [`identify`][] makes them small.

    For equations that are linear in their parameters this is `identify` of all of them at once.

    **Arguments:** `criterion`; by default all windows of half the periods of the model's band, or
    of 1 to 10 Hz.
    """

    criterion: AbstractCriterion | None = None

    @property
    def _criterion(self) -> AbstractCriterion:
        return RIEC.of_band(DEFAULT_BAND) if self.criterion is None else self.criterion

    @property
    def needs_key(self) -> bool:
        """Whether windows are drawn at random."""
        return self._criterion.needs_key

    def suited(self, model: Any) -> "IntegralError":
        """With windows for the model's band, unless others were asked for."""
        band = getattr(model, "band", None) or DEFAULT_BAND
        return IntegralError(RIEC.of_band(band)) if self.criterion is None else self

    def parametric(self, model: Any, record: Record) -> tuple[ParametricBalance, ...]:
        """The equations of motion."""
        return as_balances(model)

    def parameters(self, parametric: tuple[ParametricBalance, ...]) -> Parameters:
        """Of all equations."""
        units: dict[str, str] = {}
        defaults = {}
        for balance in parametric:
            units |= {n: u for n, u in balance.units.items() if u or n not in units}
            defaults |= balance.defaults
        names = dict.fromkeys(name for balance in parametric for name in balance.parameters)
        return Parameters(tuple(names), defaults, units)

    def misfit(self, setup: Setup) -> IntegralMisfit:
        """Over all windows of the criterion."""
        for record in setup.records:
            self._criterion.check(record)
        criterion = self._criterion.fitted(setup.records)
        labels = tuple(balance.label(setup.values) for balance in setup.model)
        free = set(setup.sharing.free_somewhere(setup.local, setup.names))
        # An equation without free parameters would only add a constant.
        chosen = [i for i, b in enumerate(setup.model) if set(b.parameters) & free]
        rows = [[criterion.row_count(record) or 0.0 for record in setup.records] for _ in chosen]
        return IntegralMisfit(
            balances=tuple(setup.model[i] for i in chosen),
            records=setup.records,
            criterion=criterion,
            keys=setup.keys,
            known=setup.fixed,
            count=np.array(rows).sum(axis=1),
            names=setup.names,
            local=setup.local,
            sharing=setup.sharing,
            equation_labels=tuple((labels[i][0], criterion.row_unit(labels[i][1])) for i in chosen),
        )

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        return {"refine": "integral", **self._criterion.describe()}
