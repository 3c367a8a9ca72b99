"""`riecjax models`: the built-in models."""

from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from riecjax.cli.command import Given, settings_command
from riecjax.equations.quantity import Quantity
from riecjax.models.catalogue import LISTED, Listing, find_model
from riecjax.settings import CODE, Document, Settings, setting
from riecjax.standard_output import answer


@dataclass(frozen=True, kw_only=True)
class Models(Settings):
    """What is listed."""

    name: str | None = setting("[NAME]", CODE)


@settings_command("models", Models, Document, short_help="List the built-in models, or show one.")
def command(given: Given) -> None:
    """List the built-in models, their parameters with units, and the signals they need.

    With a NAME, or path/to/file.py[:object], show that model and its equations.
    """
    shown = list(LISTED.values()) if given.name is None else [find_model(given.name)]
    if given.as_json:
        from riecjax.reporting.document import SCHEMA

        models = {
            model.name: {
                "summary": model.summary,
                "parameters": [_entry(q) for q in model.parameters],
                "signals": [_entry(q) for q in model.signals],
                "simulation_parameters": [
                    _entry(q) | {"default": q.default}
                    for q in model.system.parameters or model.parameters
                ],
                "inputs": [_entry(q) for q in model.inputs],
            }
            for model in shown
        }
        answer({"schema": SCHEMA, "models": models})
        return
    console = Console()
    for i, model in enumerate(shown):
        if i:
            console.print()
        console.print(model.name, style="bold", highlight=False)
        console.print(f"  {model.summary}", highlight=False)
        console.print(_table(model))
    if isinstance(shown[0], Listing) or not shown[0].stages:
        return
    from riecjax.reporting.equations import model_in_words

    console.print("  equations", style="dim")
    for line in model_in_words(shown[0]):
        console.print(f"  {line}", highlight=False, markup=False)


def _entry(quantity: Quantity) -> dict[str, object]:
    return {"name": quantity.name, "unit": quantity.unit, "meaning": quantity.meaning}


def _table(model: Any) -> Table:
    columns = Column("role", style="dim"), "name", "unit", "meaning"
    table = Table(*columns, box=None, show_header=False, padding=(0, 2, 0, 2))
    for role, quantities in (
        ("parameter", model.parameters),
        ("signal", model.signals),
        ("to simulate", model.system.parameters),
        ("input", model.inputs),
    ):
        for i, q in enumerate(quantities):
            default = f" (default {q.default:g})" if role == "to simulate" and q.default else ""
            table.add_row(role if i == 0 else "", q.name, q.unit, q.meaning + default)
    return table
