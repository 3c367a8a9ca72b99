"""Models of one's own: what a file may hold, what it says where it fails."""

import sys
from pathlib import Path

import pytest
from command_line import call, rejected, write_csv
from tests.approved.inputs import TEXTS, cart

from riecjax.models.catalogue import find_model

IMPORTS = """
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.equations.model import Model, simultaneous, staged
from riecjax.equations.quantity import Quantity
"""
EQUATION = 'Equation(Term("m", "a"), Term("c", "v"), -Term(1.0, "f"), name="cart")'


@pytest.fixture(autouse=True)
def working_folder() -> None:
    write_csv(Path("cart.csv"), cart())


def model(text: str, name: str = "mine.py") -> None:
    Path(name).write_text(text)


def identified(capsys, reference: str, *options: object) -> dict:
    quick = ("--json", "--refine", "none", "--intervals", "sandwich")
    result = call(capsys, "identify", "cart.csv", "--model", reference, *quick, *options)
    assert result.status == 0, result.err
    return result.document


@pytest.mark.parametrize(
    ("definition", "reference"),
    [
        (f"thing = {EQUATION}", "mine.py:thing"),
        (f"thing = simultaneous({EQUATION})", "mine.py:thing"),
        (f"def thing():\n    return {EQUATION}", "mine.py:thing"),
        (f"def thing():\n    return Model('it', '', stages={EQUATION})", "mine.py:thing"),
        # Where a file has one, it needs no name.
        (f"cart = {EQUATION}\nprocedure = staged(cart)", "mine.py"),
        (f"_part = {EQUATION}\nboth = staged(_part)\nsame = both", "mine.py"),
        (f"cart = {EQUATION}\nthing = Model('it', '', stages=cart)", "mine.py"),
    ],
)
def test_what_a_model_may_be(capsys, definition, reference):
    model(IMPORTS + definition)
    document = identified(capsys, reference, "--criterion", "dols", "--no-sweep")
    assert list(document["parameters"]) == ["m", "c"]


@pytest.mark.parametrize(
    ("made", "name"),
    [
        ("Model('it', stages={})", "it"),
        ("Model('cart', 'a cart', stages={})", "cart"),
        ("Model(stages={})", "thing"),
        ("staged({})", "thing"),
    ],
)
def test_a_model_is_called_as_it_says_and_else_as_its_object(made, name):
    model(f"{IMPORTS}thing = {made.format(EQUATION)}")
    assert find_model("mine.py:thing").name == name


def test_two_models_of_one_file_name_do_not_mix_nor_do_their_neighbours(capsys):
    for folder, name in (("one", "m"), ("two", "mass")):
        Path(folder, "parts").mkdir(parents=True)
        model(IMPORTS + "from words import NAME\nfrom parts.term import first\n"
              + "thing = " + EQUATION.replace('Term("m", "a")', "first(NAME)"),
              f"{folder}/mine.py")  # fmt: skip
        Path(folder, "words.py").write_text(f"NAME = {name!r}")
        # The package has no __init__.py.
        text = IMPORTS + "from words import NAME\ndef first(name):\n    return Term(NAME, 'a')\n"
        Path(folder, "parts", "term.py").write_text(text)
    before = list(sys.path)
    for folder, name in (("one", "m"), ("two", "mass"), ("one", "m")):
        document = identified(capsys, f"{folder}/mine.py:thing", "--criterion", "dols")
        assert list(document["parameters"]) == [name, "c"]
    assert sys.path == before
    assert {"words", "parts", "parts.term"}.isdisjoint(sys.modules)


def test_names_with_square_brackets_are_printed_as_they_are(capsys):
    # A terminal library must not take them for its own mark-up.
    equation = EQUATION.replace('name="cart"', 'name="axis [/b] [x]"')
    model(IMPORTS + "thing = " + equation.replace('"c", "v"', '"c", "v", unit="[N s/m]"'))
    options = ("--criterion", "dols", "--refine", "none", "--intervals", "naive", "--verbose")
    result = call(capsys, "identify", "cart.csv", "--model", "mine.py:thing", *options)
    assert result.status == 0
    assert "axis [/b] [x]" in result.out
    assert "[N s/m]" in result.out


FAILING = {
    "syntax error": ("def f(:\n", ("mine.py", "SyntaxError", "line 1")),
    "missing object": ("other = 1\n", ("mine.py", "no object 'thing'")),
    "exception": ("raise RuntimeError('first\\nsecond')\n", ("RuntimeError: first second",)),
    "import of nothing": ("import no_such_module\n", ("no_such_module",)),
    "exit": ("import sys\nsys.exit(0)\n", ("mine.py",)),
    "wrong kind": ("thing = 3\n", ("'thing'", "not a Model or an Equation")),
    "function that fails": ("def thing():\n    return {}['a']\n", ("mine.py", "KeyError")),
    "function with arguments": ("def thing(a):\n    return a\n", ("mine.py", "argument")),
    "model of the wrong kind": (
        IMPORTS + "thing = Model('thing', '', stages=3)\n",
        ("Equation",),
    ),
    "model for simulation only": (IMPORTS + "thing = Model('it', '')\n", ("not identified",)),
    "no equation": (IMPORTS + "thing = Equation(Term(1.0, 'f'))\n", ("named coefficient",)),
    "no scale": (
        IMPORTS + "thing = Equation(Term('m', 'a'), Term('c', 'v'))\n",
        ("every coefficient is unknown", "--set"),
    ),
    "unknown signal": (IMPORTS + f"thing = {EQUATION.replace('f', 'g')}\n", ("'g'", "--map g=")),
    "expression that fails": (
        IMPORTS + "thing = Equation(Term('m', lambda s: s['a'].nope), -Term(1.0, 'f'))\n",
        ("nope",),
    ),
    "expression of another length": (
        IMPORTS + "thing = Equation(Term('m', lambda s: s['a'][:-1]), -Term(1.0, 'f'))\n",
        ("2999", "3000"),
    ),
    "expression that is not finite": (
        IMPORTS + "thing = Equation(Term('m', lambda s: s['a'] / 0), -Term(1.0, 'f'))\n",
        ("finite",),
    ),
}


@pytest.mark.parametrize("case", FAILING)
def test_models_that_fail(capsys, case):
    text, words = FAILING[case]
    model(text)
    arguments = ("identify", "cart.csv", "--model", "mine.py:thing", "--refine", "none")
    message = rejected(capsys, 1, *arguments, "--out", "results")
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"one = {EQUATION}\ntwo = {EQUATION}", "holds 2 models: one, two. Say which: mine.py:one"),
        (f"def make():\n    return {EQUATION}", "name the function that returns one: mine.py:NAME"),
    ],
)
def test_a_file_of_no_model_or_of_several_asks_for_a_name(capsys, text, words):
    model(IMPORTS + text)
    assert words in rejected(capsys, 1, "identify", "cart.csv", "--model", "mine.py")


def test_a_velocity_that_was_not_recorded_is_to_be_differentiated(capsys):
    lines = [line.split(",") for line in Path("cart.csv").read_text().splitlines()]
    Path("cart.csv").write_text("\n".join(f"{t},{p},{f}" for t, p, _, _, f in lines))
    model(IMPORTS + f"thing = {EQUATION}".replace('"m", "a"', '"m", "v", derivative=1'))
    message = rejected(capsys, 1, "identify", "cart.csv", "--model", "mine.py", "--map", "x=p")
    for remedy in ("--map v=COLUMN", "--differentiate v=SIGNAL", "--derive v=FORMULA"):
        assert remedy in message


def test_what_a_model_prints_is_no_part_of_the_answer(capsys):
    spoken = "lambda s: (print('in a term'), s['p'] ** 3)[1]"
    model("print('as it is read')\n" + TEXTS["cart.py"].replace('lambda s: s["p"] ** 3', spoken))
    result = call(
        capsys, "identify", "cart.csv", "--model", "mine.py:cart", "--json", "--refine", "none"
    )
    assert result.document["parameters"]["m"]["value"] == pytest.approx(2.5, rel=0.01)
    assert "as it is read" in result.err
    assert "in a term" in result.err
