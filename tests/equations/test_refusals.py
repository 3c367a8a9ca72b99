"""What an equation or a model cannot be made of is said at once, in one line."""

from typing import Any

import pytest

import riecjax as rx

Model: Any = rx.Model
Term: Any = rx.Term
MASS, FORCE = rx.Term("m", "x", derivative=2, unit="kg"), -rx.Term(1.0, "u")
PUSHED, SLID = rx.Equation(MASS, FORCE), rx.Equation(MASS, rx.Term("d", "v"), FORCE)


def model(**fields: Any) -> Any:
    return Model("mass", stages=PUSHED, **fields)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Term("m", "x", derivative=True), "0, 1 or 2; got True"),
        (lambda: Term("m", "x", derivative=1.0), "0, 1 or 2; got 1.0"),
        (lambda: Term("m", "x", unit=3), "unit is an int"),
        (lambda: rx.Equation(rx.Term(" ", "x"), FORCE), "equation: a name is empty"),
        (lambda: Model(PUSHED), "the name stands first"),
        (lambda: Model("mass", stages=(PUSHED, "u")), "in stages is the text 'u'"),
        (lambda: model(derived=("dx", "x")), "derived of a model is a tuple"),
        (lambda: model(rates=[("x", "v")]), "rates of a model is a list"),
        (lambda: model(band=5.0), "band of a model is a float"),
        (lambda: model(band=(10.0, 1.0)), "from a low to a high frequency"),
        (lambda: model(at_rest="no"), "'mask' or 'keep'; got 'no'"),
        (lambda: model(modes=rx.HiddenMode(on="x")), "modes of a model is a HiddenMode"),
        (lambda: model().with_values({"M": 1.0}), "unknown parameter 'M'; there are: m"),
        (lambda: model().with_terms({"equation": rx.Term("d", "v")}), "'equation': .rx.Term"),
        (lambda: model().with_sensor_errors("u"), "offsets is the text 'u'"),
    ],
)
def test_a_slip_is_named_where_it_is_made(make, says):
    with pytest.raises(rx.ModelError, match=says) as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_equations_one_by_one_are_stages():
    for stages in ((PUSHED, SLID), [PUSHED, SLID], ((PUSHED,), [SLID])):
        assert Model("mass", stages=stages).stages == rx.staged(PUSHED, SLID).stages
