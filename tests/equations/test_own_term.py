"""A class of terms from outside the package goes through the house like one of its own."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import DRAG_TRUTH, drag_record

import riecjax as rx
from riecjax.criteria.test_functions import GradedBump
from riecjax.elements.dry_friction import InMotion
from riecjax.equations.bases import AbstractBasis
from riecjax.equations.equation import mixing_expressions
from riecjax.equations.term import from_elsewhere
from riecjax.reporting.equations import equation_in_words


class Drag(rx.equations.AbstractTerm):
    """c v |v|, by what it makes of samples."""

    coefficient: str = eqx.field(static=True)

    @property
    def parameters(self):
        return (self.coefficient,)

    def functions(self, x):
        return (x * jnp.abs(x))[None]


class RecordedDrag(Drag):
    """The same by its samples alone, of which no simulation knows what it makes."""

    functions = rx.equations.AbstractTerm.functions

    def samples(self, record, order):
        whole = Drag(self.coefficient, of=self.of, factor=self.factor)
        return whole.samples(record, order)


def equation(*drag: rx.equations.AbstractTerm) -> rx.Equation:
    inertia = rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg")
    damper = rx.Term("r", "x", derivative=1, measured=("dx",))
    return rx.Equation(inertia, damper, *drag, rx.Term("k", "x"), -rx.Term(1.0, "u"))


OURS = equation(rx.Term("r2", rx.odd("dx", 2)))
FOREIGN = [equation(kind("r2", of="dx")) for kind in (Drag, RecordedDrag)]
RECORD = drag_record(seed=1, noise=0.01)


@pytest.mark.parametrize("foreign", FOREIGN)
def test_it_is_checked_identified_and_shown(foreign):
    expected, estimate = (
        rx.identify(model, RECORD, intervals=rx.Sandwich()) for model in (OURS, foreign)
    )
    for name, value in expected.values.items():
        np.testing.assert_allclose(estimate[name], value, rtol=1e-9)
        np.testing.assert_allclose(estimate[name], DRAG_TRUTH[name], rtol=0.1)
    found, usual = (rx.check(model, RECORD) for model in (foreign, OURS))
    assert [f.code for f in found.findings] == [f.code for f in usual.findings]
    kind = type(foreign.terms[2]).__name__
    assert equation_in_words(foreign) == f"m x'' + r x' + r2 {kind}(dx) + k x = u"
    assert "r2" in repr(estimate)


@pytest.mark.parametrize("foreign", FOREIGN)
def test_its_columns_are_differentiated_for_a_hidden_mode(foreign):
    bump = rx.RIEC(rx.AllWindows(1.0, 2.0), GradedBump(p=9, lengths=1, derivatives=4), "")
    blocks = []
    for model in (OURS, foreign):
        hidden = rx.staged(model).with_elements(rx.HiddenMode("x"))
        blocks.append(rx.summarise(hidden, RECORD, bump, noise={}).recordings[0].stages[0][0])
    np.testing.assert_allclose(blocks[1].moments, blocks[0].moments, rtol=1e-9)
    assert "r2''" in blocks[1].parameters


def test_discovery_chooses_it():
    quick = {"intervals": rx.Naive(), "resamples": 0}
    found = rx.discover(equation(), RECORD, candidates=[Drag("drag", of="dx")], **quick)
    assert found.names == ("drag",)
    np.testing.assert_allclose(float(found.estimate["drag"]), DRAG_TRUTH["r2"], rtol=0.1)


def test_it_is_simulated_where_it_says_what_it_makes_of_a_sample():
    state, force = jnp.array([0.3, -0.7]), jnp.array([1.5])
    ours, theirs = (rx.equation_system(model, DRAG_TRUTH) for model in (OURS, FOREIGN[0]))
    np.testing.assert_allclose(
        theirs.derivative(state, force), ours.derivative(state, force), rtol=1e-12
    )
    with pytest.raises(rx.ModelError, match="cannot be simulated: RecordedDrag does not say"):
        rx.equation_system(FOREIGN[1], DRAG_TRUTH)


@pytest.mark.parametrize(
    ("functions", "says"),
    [
        (lambda self, x: x, r"a row for each of 1 .*shape \(1, .*; it made"),
        (lambda self, x: jnp.stack([x, x]), "a row for each of 1"),
        (lambda self, x: 1 / 0, "failed at line .*division by zero"),
    ],
)
def test_what_it_gets_wrong_is_named(functions, says):
    wrong = equation(type("Wrong", (Drag,), {"functions": functions})("r2", of="dx"))
    with pytest.raises(rx.ModelError, match=f"Wrong .*{says}"):
        rx.identify(wrong, RECORD)
    with pytest.raises(rx.ModelError, match=f"cannot be simulated: Wrong .*{says}"):
        rx.equation_system(wrong, DRAG_TRUTH)


def test_functions_of_numpy_are_identified_and_not_simulated():
    own = type("OfNumPy", (Drag,), {"functions": lambda self, x: (x * np.abs(x))[None]})
    np.testing.assert_allclose(
        rx.identify(equation(own("r2", of="dx")), RECORD).theta,
        rx.identify(OURS, RECORD).theta,
        rtol=1e-9,
    )
    with pytest.raises(rx.ModelError, match=r"OfNumPy .*Use functions of jax\.numpy"):
        rx.equation_system(equation(own("r2", of="dx")), DRAG_TRUTH)


def test_a_mean_is_one_of_the_samples_recorded_and_sums_are_of_its_code():
    def centred(self, x):
        law = x * jnp.abs(x)
        return (law - jnp.mean(law))[None]

    def expression(signals):
        return centred(None, signals["dx"])[0]

    kind = type("Drag", (Drag,), {"functions": centred})
    models = equation(kind("r2", of="dx")), equation(rx.Term("r2", expression))
    ours, theirs = (rx.identify(model, RECORD, intervals=rx.Naive()) for model in models)
    for name in DRAG_TRUTH:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-9)
    with pytest.raises(rx.ModelError, match="made for other equations"):
        rx.estimate(FOREIGN[0], rx.summarise(models[0], RECORD))


def test_a_basis_that_mixes_samples_is_found_out():
    class Centred(AbstractBasis):
        @property
        def labels(self):
            return ("mean",)

        def __call__(self, x):
            return (x - jnp.mean(x))[None]

    assert not any(map(from_elsewhere, (rx.Term, InMotion, rx.Polynomial)))
    bases = Centred(), rx.Polynomial((1, 3))
    mixing = [mixing_expressions([equation(rx.Terms("r", b, "dx"))], RECORD) for b in bases]
    assert mixing == [["equation: Term"], []]


@pytest.mark.parametrize("foreign", FOREIGN)
def test_springs_and_sensors_refuse_it(foreign):
    with pytest.raises(rx.ModelError, match="'r2' is a function of a kind that no spring's"):
        rx.staged(foreign).with_elements(rx.SeriesSpring("r2"))
    with pytest.raises(rx.ModelError, match="a function of 'dx'"):
        rx.staged(foreign).with_elements(rx.elements.SensorGain("dx"))
