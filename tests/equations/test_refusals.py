"""What an equation or a model cannot be made of is said at once, in one line."""

from typing import Any

import numpy as np
import pytest

import riecjax as rx

Model: Any = rx.Model
Term: Any = rx.Term
Equation: Any = rx.Equation
MASS, FORCE = rx.Term("m", "x", derivative=2, unit="kg"), -rx.Term(1.0, "u")
PUSHED, SLID = rx.Equation(MASS, FORCE), rx.Equation(MASS, rx.Term("d", "v"), FORCE)


def model(**fields: Any) -> Any:
    return Model("mass", stages=PUSHED, **fields)


def said_twice(**fields: tuple[Any, Any]) -> Any:
    """Two stages whose terms of one coefficient have the one and the other value of a field."""
    terms = (Term("m", "x", **{k: values[i] for k, values in fields.items()}) for i in (0, 1))
    return rx.staged(*(rx.Equation(term, Term("d", "v"), FORCE) for term in terms))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Term("m", "x", derivative=True), "from 0 on; got True"),
        (lambda: Term("m", "x", derivative=-1), "from 0 on; got -1"),
        (lambda: Term(1.0, "x", known=2.0), "named coefficient"),
        (lambda: Term("m", "x", derivative=1.0), "from 0 on; got 1.0"),
        (lambda: Term("m", "x", unit=3), "unit is an int"),
        (lambda: Term("m", "x", unit=("kg", "N")), "m: 2 units for 1 coefficients"),
        (lambda: Term("m", "x", known=np.nan), "known value of m must be one finite number"),
        (lambda: Term("m", "x", sign=None), "sign must be one finite number; got None"),
        (lambda: Term(np.ones(2), "x"), "coefficient must be one finite number"),
        (lambda: Term("m", "x", basis="roof"), "basis is the text 'roof'"),
        (lambda: Term(1.0, "x", basis=rx.Polynomial((1, 3))), "need a name"),
        (lambda: rx.Polynomial((1, 1)), "different whole numbers from 0 on"),
        (lambda: rx.Polynomial("13"), "exponents is the text '13'"),  # pyright: ignore
        (lambda: said_twice(known=(2.0, 3.0)), "m is known as 2 and, in another term, as 3"),
        (lambda: said_twice(unit=("kg", "N")), "unit of m is kg and, in another term, N"),
        (lambda: rx.Equation(rx.Term(" ", "x"), FORCE), "equation: a name is empty"),
        (lambda: rx.Equation(Term("k\x1b[31m", "x")), "must be printable"),
        (lambda: rx.Equation(Term("k\n", "x")), "must be printable"),
        (lambda: Equation(MASS, name=5), "must be printable"),
        (lambda: Equation(MASS, unit=None), "must be printable"),
        (lambda: rx.Equation(FORCE, name="wheel"), "wheel: .*at least one named coefficient"),
        (lambda: Model(PUSHED), "the name stands first"),
        (lambda: Model("mass", stages=(PUSHED, "u")), "in stages is the text 'u'"),
        (lambda: model(derived=("dx", "x")), "derived of a model is a tuple"),
        (lambda: model(rates=[("x", "v")]), "rates of a model is a list"),
        (lambda: model(band=5.0), "band of a model is a float"),
        (lambda: model(band=(10.0, 1.0)), "from a low to a high frequency"),
        (lambda: model(band=("1", "10")), "from a low to a high frequency"),
        (lambda: model(band=()), "from a low to a high frequency"),
        (lambda: model(band=(1.0, 2.0, 3.0)), "from a low to a high frequency"),
        (
            lambda: model(parameters=[rx.equations.Quantity("m", "lb", "")]),
            "m is lb and, in another term, kg",
        ),
        (
            lambda: model(signals=2 * (rx.equations.Quantity("x", "m", ""),)),
            "a name stands twice in signals",
        ),
        (lambda: model(at_rest="no"), "'mask' or 'keep'; got 'no'"),
        (lambda: model(elements=rx.HiddenMode(on="x")), "elements of a model is a HiddenMode"),
        (lambda: model().with_values({"M": 1.0}), "unknown parameter 'M'; there are: m"),
        (lambda: model().with_terms({"equation": rx.Term("d", "v")}), "'equation': .rx.Term"),
        (lambda: model().with_elements("u"), "an element is the text 'u'"),
    ],
)
def test_a_slip_is_named_where_it_is_made(make, says):
    with pytest.raises(rx.ModelError, match=says) as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_equations_one_by_one_are_stages():
    for stages in ((PUSHED, SLID), [PUSHED, SLID], ((PUSHED,), [SLID])):
        assert Model("mass", stages=stages).stages == rx.staged(PUSHED, SLID).stages
