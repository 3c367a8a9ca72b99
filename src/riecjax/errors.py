"""Errors that a user can act on: each message says what is wrong and what to do about it."""


class RiecjaxError(ValueError):
    """Base of every error that riecjax raises on purpose."""


class DataError(RiecjaxError):
    """The recorded data does not allow what was asked of it (missing signal, NaN, too short)."""


class ModelError(RiecjaxError):
    """A model, equation or criterion is put together wrongly, or a name in it is unknown."""


class IdentifiabilityError(RiecjaxError):
    """The data cannot tell the parameters apart: regressors are collinear or carry no signal."""


class SimulationError(RiecjaxError):
    """A simulation lost its solution where one was needed."""
