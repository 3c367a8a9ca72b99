"""Options that several commands share, and their parsing."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from riecjax.models.model import Model


class Assignment(click.ParamType):
    """`NAME=VALUE` with a value of the given kind."""

    def __init__(self, kind: type[float] | type[str], metavar: str):
        self.kind = kind
        self.name = metavar

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, Any]:
        name, equals, text = str(value).partition("=")
        if not (name.strip() and equals and text.strip()):
            self.fail(f"'{value}' is not of the form {self.name}.", param, ctx)
        if self.kind is str:
            return name.strip(), text.strip()
        try:
            number = float(text)
        except ValueError:
            self.fail(f"'{text}' in '{value}' is not a number.", param, ctx)
        if not math.isfinite(number):
            self.fail(f"'{text}' in '{value}' is not a finite number.", param, ctx)
        return name.strip(), number


def pairs_to_dict(
    ctx: click.Context, param: click.Parameter, value: tuple[tuple[str, Any], ...]
) -> dict[str, Any]:
    """Collect assignments; naming one thing twice is an error."""
    names = [name for name, _ in value]
    for name in names:
        if names.count(name) > 1:
            raise click.BadParameter(f"'{name}' is given twice.", ctx, param)
    return dict(value)


def assignments(
    option: str, kind: type[float] | type[str], metavar: str, help_text: str, target: str
) -> Callable[..., Any]:
    """A repeatable option `--option NAME=VALUE` that arrives as a dict."""
    return click.option(
        option,
        target,
        type=Assignment(kind, metavar),
        metavar=metavar,
        multiple=True,
        callback=pairs_to_dict,
        help=help_text + " Repeatable.",
    )


class HiddenModeOf(click.ParamType):
    """`SIGNAL` or `SIGNAL=HZ`, as a signal and a frequency or `None`."""

    name = "SIGNAL[=HZ]"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float | None]:
        name, equals, text = str(value).partition("=")
        if not name.strip() or (equals and not text.strip()):
            self.fail(f"'{value}' is not of the form {self.name}.", param, ctx)
        return name.strip(), POSITIVE.convert(text, param, ctx) if equals else None


@dataclasses.dataclass(frozen=True)
class HiddenOptions:
    """What a model leaves out, as asked for."""

    modes: tuple[tuple[str, float | None], ...]
    springs: tuple[str, ...]
    offsets_of: tuple[str, ...]
    gains_of: tuple[str, ...]

    def added_to(self, name: str) -> "Model":
        """The model of this name, with these modes, springs, and errors of sensors."""
        from riecjax.equations.hidden_elements import HiddenMode, SeriesSpring
        from riecjax.models.catalogue import find_model

        offsets, gains = (tuple(dict.fromkeys(of)) for of in (self.offsets_of, self.gains_of))
        model = find_model(name).with_sensor_errors(offsets, gains)
        model = model.with_modes(*(HiddenMode(*each) for each in self.modes))
        return model.with_series_springs(*map(SeriesSpring, self.springs))


model_option = click.option(
    "--model",
    "model_name",
    required=True,
    help="A built-in model (see 'riecjax models') or path/to/file.py[:object].",
)
at_rest_option = click.option(
    "--at-rest",
    type=click.Choice(["mask", "keep"]),
    help="Leave out where a velocity with dry friction rests, or keep it.  [default: mask]",
)
set_option = assignments(
    "--set", float, "NAME=VALUE", "Hold a parameter at a known value (SI units).", "known"
)
mode_option = click.option(
    "--add-mode",
    "modes",
    type=HiddenModeOf(),
    metavar="SIGNAL[=HZ]",
    multiple=True,
    help="Find an oscillator that the model leaves out, on the body with this velocity, everywhere "
    "or near a frequency. Repeatable.",
)
spring_option = click.option(
    "--add-spring",
    "springs",
    metavar="TERM",
    multiple=True,
    help="Find a spring that the model leaves out, in series with the damper of this linear "
    "coefficient. Repeatable.",
)
offset_option = click.option(
    "--unknown-offset",
    "offsets_of",
    metavar="SIGNAL",
    multiple=True,
    help="Estimate the zero of this signal's sensor as well. Repeatable.",
)
gain_option = click.option(
    "--unknown-gain",
    "gains_of",
    metavar="SIGNAL",
    multiple=True,
    help="Estimate the factor by which this signal's readings are to be multiplied. Repeatable.",
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(min=0, max=2**63 - 1),
    default=0,
    show_default=True,
    help="Seed of all random draws.",
)


def _old_name(
    ctx: click.Context, param: click.Parameter, value: tuple[str, ...]
) -> tuple[str, ...]:
    if value:
        click.echo("riecjax: --own is called --per-record now.", err=True)
    ctx.meta["own"] = value
    return value


def per_record_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """`--per-record NAME`, and for one version its old name `--own`."""
    old = click.option(
        "--own",
        multiple=True,
        metavar="NAME",
        is_eager=True,
        expose_value=False,
        callback=_old_name,
        help="Old name of --per-record, which goes in the next version.",
    )
    return click.option(
        "--per-record",
        "per_record",
        multiple=True,
        metavar="NAME",
        callback=lambda ctx, param, value: (*value, *ctx.meta["own"]),
        help="Give a parameter a value of its own in each recording (such as an offset). "
        "Repeatable.",
    )(old(command))


json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document instead of tables."
)
out_option = click.option(
    "--out",
    "out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for results.json, figures and report.html.",
)


class Number(click.ParamType):
    """A number that satisfies a condition, which `words` name after the number in a refusal."""

    def __init__(self, name: str, condition: Callable[[float], bool], words: str):
        self.name = name
        self.condition = condition
        self.words = words

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        try:
            number = float(value)
        except ValueError:
            self.fail(f"'{value}' is not a number.", param, ctx)
        if not self.condition(number):
            self.fail(f"'{value}' must {self.words}.", param, ctx)
        return number


POSITIVE = Number(
    "number",
    lambda number: math.isfinite(number) and number > 0,
    "be a finite number greater than zero",
)
FINITE = Number("number", math.isfinite, "be a finite number")
SHARE = Number("share", lambda number: 0 < number < 1, "lie between 0 and 1")


def collecting(
    options: Sequence[Callable[..., Any]], kind: type[Any], name: str
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that adds options to a command and hands them over as one argument.

    **Arguments:** `kind`, a dataclass with a field for each option; `name` of the argument.
    """
    fields = [field.name for field in dataclasses.fields(kind)]

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        def collected(**arguments: Any) -> Any:
            own = {field: arguments.pop(field) for field in fields}
            return command(**{name: kind(**own)}, **arguments)

        collected.__doc__ = command.__doc__
        # Options that stand on the command itself are listed after these.
        collected.__click_params__ = getattr(command, "__click_params__", [])  # type: ignore[attr-defined]
        for option in reversed(options):
            collected = option(collected)
        return collected

    return decorate


hidden_options = collecting(
    (mode_option, spring_option, offset_option, gain_option), HiddenOptions, "hidden"
)
"""Options that add what a model leaves out; they arrive as one `hidden`."""
