"""A setting, said once: a field of a frozen dataclass with its option, its kind and its help.

From these fields come the keywords of the verbs that take such a dataclass ([`taking`][]), the
options of the command line, job files and the form of one, provenance, and proposed commands.
"""

import ast
import contextlib
import dataclasses
import difflib
import functools
import inspect
import itertools
import json
import math
import re
import sys
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ClassVar, Concatenate, Literal, ParamSpec, Protocol, TypeVar, overload

from riecjax.errors import ModelError, RiecjaxError, require
from riecjax.settings.kinds import NAMES, TEXT, TRUTH, Kind, number_text

Shape = Literal["once", "many", "named", "flag"]
Plain = Any
"""What TOML and JSON have words for."""


@dataclasses.dataclass(frozen=True)
class Option:
    """How a setting is said on the command line and in a job file.

    **Fields:**

    - `said`: the option and what its value looks like, as `--map SIGNAL=COLUMN`, of a truth that
      can be turned off too `--sweep/--no-sweep`, of an argument `RECORD...`; `kind` of each value.
    - `shape`: said `once` (with `count` values), `many` times (a tuple), for what it is `named` (a
      dict), or a truth (a `flag`).
    - `default`, and the same in words where it depends on others.
    - `alone`: words that stand for all values of a setting that is said many times.
    - `combine`: makes one value of the one that was given to a name and of a further one.
    - `excludes`: names of settings that it replaces.
    - `required`, whether there must be one; `free`, whether Python takes objects of other kinds
      too; `of_result`, whether it is about where the result goes, and not about what it is.
    """

    said: str
    kind: Kind
    shape: Shape = "once"
    count: int = 1
    default: Any = None
    default_in_words: str = ""
    alone: tuple[str, ...] = ()
    combine: Callable[[Any, Any], Any] | None = None
    excludes: tuple[str, ...] = ()
    required: bool = False
    free: bool = False
    of_result: bool = False

    @functools.cached_property
    def flag(self) -> str:
        """The option as it is typed, `--map`; empty for an argument."""
        return self.said.partition(" ")[0] if self.said.startswith("--") else ""

    @functools.cached_property
    def metavar(self) -> str:
        """What help shows for its value, where that is not its kind's name."""
        return self.said.removeprefix(self.flag).strip()

    @property
    def key(self) -> str:
        """What a job file calls it: `map` for `--map`, `records` for RECORD..."""
        named = self.flag.partition("/")[0].removeprefix("--")
        return named or f"{self.metavar.strip('.').lower()}s"

    @property
    def is_single(self) -> bool:
        """Whether it is one value, said once."""
        return self.shape == "once" and self.count == 1

    @property
    def form(self) -> str:
        """What its value looks like."""
        return self.metavar or "|".join(self.kind.choices) or self.kind.name

    def parsed(self, *texts: str) -> Any:
        """The setting that texts say.

        **Raises:** `ValueError` that says what is wrong with one of them, for a word beside others,
        or a name that is given twice.
        """
        if words := [text for text in texts if text in self.alone]:
            if len(texts) > 1:
                raise ValueError(f"'{words[0]}' is for all signals; give it alone.")
            return words[0]
        if self.shape != "named":
            values = tuple(map(self.kind.parse, texts))
            return values[0] if self.is_single else values or self.default
        pairs: dict[str, Any] = {}
        for text in texts:
            name, equals, said = (part.strip() for part in text.partition("="))
            if not (name and equals and said):
                raise ValueError(f"'{text}' is not of the form {self.form}.")
            if name in pairs:
                raise ValueError(f"'{name}' is given twice.")
            pairs[name] = self._value_of(name, said)
        return pairs or self.default

    def _value_of(self, name: str, said: str) -> Any:
        try:
            return self.kind.parse(said)
        except ValueError as error:
            what = str(error).replace(f"'{said}'", f"'{said}' in '{name}={said}'", 1)
            raise ValueError(what) from None

    def texts(self, value: Any) -> list[list[str]]:
        """Texts that are understood as this value, a list for each time that it is said."""
        write = self.kind.write
        if isinstance(value, str) and value in self.alone:
            return [[value]]
        if self.shape == "named":
            return [[f"{name}={write(each)}"] for name, each in value.items()]  # type: ignore[union-attr]
        if self.shape == "many":
            return [[write(each)] for each in value]
        return [[write(each) for each in value] if self.count > 1 else [write(value)]]

    def words(self, value: Any) -> list[str]:
        """Arguments of the command line that say this value."""
        on, _, off = self.flag.partition("/")
        if self.shape == "flag":
            return list(filter(None, [on if value else off]))
        return [word for texts in self.texts(value) for word in filter(None, (on, *texts))]

    def plain(self, value: Any) -> Plain:
        """The value as a job file holds it."""
        if isinstance(value, bool):
            return value
        if isinstance(value, Mapping):
            return {name: _number(self.kind.write(each)) for name, each in value.items()}
        texts = [text for said in self.texts(value) for text in said]
        if isinstance(value, str) and value in self.alone:
            return texts
        if "=" in self.form:
            pairs = [text.partition("=") for text in texts]
            if len({name for name, equals, _ in pairs if equals}) == len(pairs):
                return {name: _number(text) for name, _, text in pairs}
        if self.is_single:
            return _number(texts[0])
        return [_number(text) if self.count > 1 else text for text in texts]

    def of_plain(self, value: Plain, move: Callable[[str], str] = str) -> Any:
        """The setting that a job file's value says, its paths moved.

        **Raises:** `ValueError` for what is not of its kind.
        """
        listed = value if isinstance(value, list) and not self.is_single else [value]
        has_names = "=" in self.form if isinstance(value, dict) else bool(self.flag)
        is_listed = isinstance(value, list) and len(value) == self.count
        for words, fits in (
            ("true or false", self.shape != "flag" or isinstance(value, bool)),
            (f"a list of {self.count}", self.count == 1 or is_listed),
            ("a list of names in quotes", has_names or all(isinstance(e, str) for e in listed)),
        ):
            if not fits:
                raise ValueError(f"'{self.key}' must be {words}; got {value!r}.")
        if self.shape == "flag":
            return value
        if isinstance(value, list) and self.kind is NAMES:
            # Names between commas may as well be a list.
            return tuple(map(self._text, value))
        if isinstance(value, dict):
            texts = {name: self._text(each, name) for name, each in value.items()}
            if self.shape == "named":
                return {name: self._value_of(name, text) for name, text in texts.items()}
            said = [f"{name}={text}" for name, text in texts.items()]
        else:
            said = [self._text(each) for each in listed]
        try:
            return self.parsed(*(str(self.moved(text, move)) for text in said))
        except ValueError as error:
            raise ValueError(f"'{self.key}': {error}") from None

    def _text(self, value: Plain, name: str = "") -> str:
        key = f"{self.key}.{name}" if name else self.key
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"'{key}' must be a number, or a name in quotes; got {value!r}.")
        text = value if isinstance(value, str) else number_text(value)
        if any(sign == "\0" or "\ud800" <= sign <= "\udfff" for sign in text):
            raise ValueError(f"'{key}' must be text as can be typed; got {value!r}.")
        return text

    def moved(self, value: Any, move: Callable[[str], str]) -> Any:
        """The value with its paths moved: of files, and of the file in `FILE.py[:OBJECT]`."""
        if not self.kind.path or value is None:
            return value
        if isinstance(value, tuple):
            return tuple(self.moved(each, move) for each in value)
        if self.kind.path == "file":
            return Path(move(str(value)))
        code = PYTHON_FILE.fullmatch(str(value))
        return value if code is None else move(code["file"]) + code["object"]

    def beside(self, given: Any, further: Any) -> Any:
        """A further value, to be said where there is a given one: a list goes on, and what is named
        is combined with what has its name."""
        if isinstance(given, tuple) and isinstance(further, tuple):
            return (*given, *(each for each in further if each not in given))
        if not (self.combine and isinstance(given, dict) and isinstance(further, dict)):
            return further
        both = {k: self.combine(given[k], further[k]) for k in given.keys() & further.keys()}
        return {**further, **both}


def _number(text: str) -> float | str:
    """The number that is written so and not otherwise, or the text."""
    try:
        value = json.loads(text)
    except ValueError:
        return text
    is_number = type(value) in (int, float) and math.isfinite(value)
    return value if is_number and number_text(value) == text else text


PYTHON_FILE = re.compile(r"(?P<file>.+?\.py)(?P<object>(?::[^:/\\]*)*)")
OPTION = "option"


def setting(said: str, kind: Kind, default: Any = None, **more: Any) -> Any:
    """A field of [`Settings`][] that is said once; `more`, fields of its [`Option`][].

    The text below the field says what it is for, in help, job files and documentation alike.
    """
    option = Option(said, kind, default=default, **more)
    if isinstance(default, dict):
        return dataclasses.field(default_factory=dict, metadata={OPTION: option})
    return dataclasses.field(default=default, metadata={OPTION: option})


def many(said: str, kind: Kind, default: Any = (), **more: Any) -> Any:
    """A field that is said many times: a tuple."""
    return setting(said, kind, default, shape="many", **more)


def named(said: str, kind: Kind, default: str | None = None, **more: Any) -> Any:
    """A field with a value for each name: a dict."""
    return setting(said, kind, {} if default is None else default, shape="named", **more)


def flag(said: str, default: bool = False, **more: Any) -> Any:
    """A field that is true or false."""
    return setting(said, TRUTH, default, shape="flag", **more)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings that belong together. Fields made by [`setting`][], [`many`][], [`named`][] and
    [`flag`][] are options too; others are of Python alone. A method `contradictions` yields what of
    its class does not go together, as templates of [`Contradiction`][]; what bases say comes first.

    **Raises:** `error` for a value of the wrong kind, [`Contradiction`][] for settings that do not
    go together.
    """

    error: ClassVar[type[RiecjaxError]] = ModelError

    def __post_init__(self) -> None:
        for name, option in self.options().items():
            value = getattr(self, name)
            object.__setattr__(self, name, _checked(name, option, value, self.owner(name).error))
        for kind in reversed(type(self).__mro__):
            for template in vars(kind).get("contradictions", lambda _: ())(self):
                raise Contradiction(template, self.options())

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Options by the names of their fields."""
        fields = dataclasses.fields(cls)
        return {each.name: each.metadata[OPTION] for each in fields if OPTION in each.metadata}

    @classmethod
    def help(cls, name: str) -> str:
        """What a setting is for: the text below its field, whether it may be repeated, and its
        default where words say that best; empty where there is no source to read."""
        texts = (_texts_of(base.__module__).get(f"{base.__name__}.{name}") for base in cls.__mro__)
        option = cls.options()[name]
        repeatable = "Repeatable." if option.shape in ("many", "named") and option.flag else ""
        default = f"[default: {option.default_in_words}]" if option.default_in_words else ""
        return " ".join(filter(None, (next(filter(None, texts), ""), repeatable, default)))

    @classmethod
    def owner(cls, name: str) -> type["Settings"]:
        """The class that has the field of a setting."""
        return next(each for each in cls.__mro__ if name in vars(each).get("__annotations__", ()))

    @classmethod
    def about(cls, name: str) -> str:
        """What a setting belongs to: the first words of the class that has its field."""
        return (cls.owner(name).__doc__ or "").partition("\n")[0].rstrip(".")

    def says(self, *names: str) -> bool:
        """Whether any of these is other than its default."""
        options = self.options()
        pairs = ((getattr(self, name), options[name].default) for name in names)
        # Arrays and objects, which may not compare, are none.
        return any(type(value) is not type(usual) or value != usual for value, usual in pairs)


@functools.cache
def _texts_of(module: str) -> dict[str, str]:
    """Texts below fields of the classes of a module, by class and field."""
    try:
        source = inspect.getsource(sys.modules[module])
    except (OSError, TypeError):  # as of a frozen program
        return {}
    classes = [node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    return {
        f"{each.name}.{ast.unparse(field.target)}": " ".join(ast.literal_eval(text.value).split())
        for each in classes
        for field, text in itertools.pairwise(each.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


class Contradiction(ModelError):
    """Settings that do not go together, named as whoever gave them does.

    **Arguments:** `template`, with `{field}` for a setting, and `{field:value}` for what it is;
    `options` of the settings by field.
    """

    def __init__(self, template: str, options: Mapping[str, Option]):
        self.template, self.options = template, options
        super().__init__(_SETTING.sub(lambda f: f[1] + (f"={f[2]!r}" if f[2] else ""), template))

    def typed(self) -> str:
        """The same on the command line."""
        flags = {name: option.flag.partition("/")[0] for name, option in self.options.items()}
        return _SETTING.sub(lambda f: f"{flags[f[1]]} {f[2]}".rstrip(), self.template)


_SETTING = re.compile(r"\{(\w+):?([^}]*)\}")


def _checked(name: str, option: Option, value: Any, error: type[RiecjaxError]) -> Any:
    """A value as its setting holds it, or the error that says what to write."""
    if option.free or (isinstance(value, str) and value in option.alone):
        return value
    is_listed = option.shape == "many" or option.count > 1 or option.kind is NAMES
    if value is None:
        # Of a choice it may stand for one: criterion=None for the one that suits.
        is_needed = is_listed or option.shape == "named" or option.kind.is_number
        return option.default if is_needed else None
    if hasattr(value, "dtype") and (option.shape == "flag" or option.count > 1):
        value = bool(value) if option.shape == "flag" else tuple(value)
    if option.shape == "flag":
        require(name, value, bool, f"{name}={not option.default}", error)
    elif option.shape == "named":
        named = option.form.rpartition("|")[2].partition("=")[0].lower()
        require(name, value, Mapping, f"{name}={{'x': ...}}, by {named}", error)
        held: Any = value
        for key, each in held.items():
            require(f"a name in {name}", key, str, "names as text, 'x'", error)
            _check_leaf(f"{name} of '{key}'", option.kind, each, "it as text, 'x'", error)
        return dict(held)
    elif is_listed:
        likely = (50.0,) if option.kind.is_number else ("x",)
        example = NAMES.parse(value) if type(value) is str else likely
        write = f"{name}=(1.0, 10.0)" if option.count > 1 else f"{name}={example}, a tuple"
        require(name, value, list | tuple, write, error)
        if option.count > 1 and len(value) != option.count:
            raise error(f"{name} has {len(value)} values. Write {write}.")
        what = "a value of" if option.kind.is_number else "a name in"
        for each in value:
            _check_leaf(f"{what} {name}", option.kind, each, "names as text, 'x'", error)
        return tuple(value)
    else:
        _check_leaf(name, option.kind, value, "it as text, 'x'", error)
    return value


def _check_leaf(what: str, kind: Kind, value: Any, as_text: str, error: type[RiecjaxError]) -> None:
    if kind.word and isinstance(value, str) and value == kind.word:
        return
    if kind.is_number:
        number: Any = value
        # Numbers of NumPy and JAX are numbers, traced ones too.
        shape, dtype = getattr(value, "shape", ()), getattr(value, "dtype", None)
        fits = shape == () if dtype is not None else isinstance(value, Real)
        if kind.is_whole and fits:
            fits = dtype.kind in "iu" if dtype is not None else isinstance(value, Integral)
        words = f"a {'whole ' * kind.is_whole}number{f' or {kind.word!r}' * bool(kind.word)}"
        require(what, value, object if fits and not isinstance(value, bool) else (), words, error)
        with contextlib.suppress(TypeError):  # a traced number has no size yet
            text = str(int(number)) if kind.is_whole else number_text(number)
            try:
                kind.parse(text)
            except ValueError as refused:
                raise error(f"{what}: {refused}".replace(f"'{text}'", text, 1)) from None
    elif isinstance(value, str) and kind.choices and value not in kind.choices:
        # Objects stand in for their names.
        require(what, value, (), " or ".join(f"'{word}'" for word in kind.choices), error)
    elif kind.example and (
        isinstance(value, str) or not hasattr(value, "__len__") or len(value) != len(kind.example)
    ):
        require(what, value, (), str(kind.example), error)
    elif kind in (TEXT, NAMES):
        require(what, value, str, as_text, error)


Keywords = ParamSpec("Keywords")
Given = TypeVar("Given", bound=Settings)
First = TypeVar("First")
Second = TypeVar("Second")
Answer = TypeVar("Answer")


class Taking(Protocol[Keywords]):
    """What [`taking`][] decorates: a verb of one or two things, and of settings."""

    @overload
    def __call__(
        self, verb: Callable[[First, Any], Answer], /
    ) -> Callable[Concatenate[First, Keywords], Answer]: ...
    @overload
    def __call__(
        self, verb: Callable[[First, Second, Any], Answer], /
    ) -> Callable[Concatenate[First, Second, Keywords], Answer]: ...


def taking(kind: Callable[Keywords, Given]) -> Taking[Keywords]:
    """Give a verb whose last parameter is `settings` the keywords of a kind of [`Settings`][].

    **Raises:** `TypeError`, from the verb, for a keyword that it has not, with the nearest.
    """
    names = {each.name: each for each in dataclasses.fields(kind)}  # type: ignore[arg-type]

    def decorate(verb: Callable[..., Any]) -> Callable[..., Any]:
        *own, _ = inspect.signature(verb).parameters.values()
        # Not the mark of a factory, which says nothing to a reader.
        taken = [
            each.replace(default={}) if names[name].default is dataclasses.MISSING else each
            for name, each in inspect.signature(kind).parameters.items()
        ]
        answer = inspect.signature(verb).return_annotation
        signature = inspect.Signature([*own, *taken], return_annotation=answer)

        @functools.wraps(verb)
        def called(*arguments: Any, **keywords: Any) -> Any:
            for name in keywords.keys() - signature.parameters.keys():
                # What it is called in job files is the nearest of all.
                keys = {option.key: field for field, option in kind.options().items()}  # type: ignore[attr-defined]
                alike = difflib.get_close_matches(name, signature.parameters, 1)
                near = keys.get(name, *alike[:1])
                remedy = f"; the nearest is '{near}'" if near else ""
                raise TypeError(
                    f"{verb.__name__}() has no keyword '{name}'{remedy}. There are: "
                    f"{', '.join(signature.parameters)}."
                )
            try:
                bound = signature.bind(*arguments, **keywords).arguments
            except TypeError as error:
                raise TypeError(f"{verb.__name__}() {error}") from None
            mine = {name: bound.pop(name) for name in names if name in bound}
            return verb(**bound, settings=kind(**mine))  # type: ignore[call-arg]

        called.__signature__ = signature  # type: ignore[attr-defined]
        return called

    return decorate  # type: ignore[return-value]
