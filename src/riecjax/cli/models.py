"""`riecjax models`: the built-in models."""

import json

import click
from rich.console import Console
from rich.table import Table

from riecjax.cli.options import json_option
from riecjax.models.catalogue import MODELS
from riecjax.models.model import Model, Quantity
from riecjax.reporting.output import SCHEMA


@click.command("models")
@json_option
def command(as_json: bool) -> None:
    """List the built-in models, their parameters with units, and the signals they need."""
    if as_json:
        click.echo(json.dumps({"schema": SCHEMA, "models": models_document()}, indent=2))
        return
    console = Console()
    for model in MODELS.values():
        console.print(f"[bold]{model.name}[/bold]  {model.summary}", highlight=False)
        console.print(_table(model))


def models_document() -> dict[str, object]:
    return {
        model.name: {
            "summary": model.summary,
            "parameters": [_entry(q) for q in model.parameters],
            "signals": [_entry(q) for q in model.signals],
            "simulation_parameters": [
                _entry(q) | {"default": q.default} for q in model.simulation_parameters
            ],
            "inputs": [_entry(q) for q in model.inputs],
        }
        for model in MODELS.values()
    }


def _entry(quantity: Quantity) -> dict[str, object]:
    return {"name": quantity.name, "unit": quantity.unit, "meaning": quantity.meaning}


def _table(model: Model) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 2))
    table.add_column("role", style="dim")
    table.add_column("name")
    table.add_column("unit")
    table.add_column("meaning")
    roles = (
        ("parameter", model.parameters),
        ("signal", model.signals),
        ("to simulate", model.own_simulation_parameters),
        ("input", model.inputs),
    )
    for role, quantities in roles:
        for i, q in enumerate(quantities):
            default = f" (default {q.default:g})" if role == "to simulate" and q.default else ""
            table.add_row(role if i == 0 else "", q.name, q.unit, q.meaning + default)
    return table
