import runpy

import jax
import numpy as np
import pytest

import riecjax
from riecjax.errors import ModelError, users_code

FAILING = """
import json


def fails():
    return json.loads("no number")


fails()
"""


@pytest.mark.parametrize("folder", ["plain", "riecjax", "site-packages", "importlib"])
def test_the_line_is_the_users_wherever_the_file_lies(tmp_path, folder):
    file = tmp_path / folder / "mine.py"
    file.parent.mkdir()
    file.write_text(FAILING)
    # json.loads fails deeper, in Python's own library.
    words = r"mine failed at line 6 of mine\.py: JSONDecodeError"
    with pytest.raises(ModelError, match=words), users_code("mine"):
        runpy.run_path(str(file))


def test_an_error_of_no_file_of_the_users_names_no_line():
    code = compile("{}['a']", "<string>", "eval")
    with pytest.raises(ModelError, match=r"^mine failed") as caught, users_code("mine"):
        eval(code)
    assert "<string>" not in str(caught.value)


def test_what_to_write_comes_before_jaxs_own_words():
    words = r"^mine failed.*\. Use functions of jax\.numpy.* NumPy's\. TracerArray"
    with pytest.raises(ModelError, match=words), users_code("mine"):
        jax.eval_shape(lambda x: np.sin(x), jax.ShapeDtypeStruct((3,), float))


@pytest.mark.parametrize(
    ("name", "place"),
    [("window_sweep", "validation"), ("RoofFunctions", "equations"), ("Rows", "criteria")],
)
@pytest.mark.parametrize("package", [riecjax, riecjax.studies])
def test_a_name_that_stands_elsewhere_says_where_it_is(package, name, place):
    with pytest.raises(AttributeError, match=rf"has no '{name}': write rx\.{place}\.{name}\."):
        getattr(package, name)
    assert hasattr(getattr(riecjax, place), name)


def test_a_name_that_nothing_has_is_an_ordinary_attribute_error():
    with pytest.raises(AttributeError, match="attribute nonsense"):
        _ = riecjax.nonsense  # pyright: ignore[reportAttributeAccessIssue]
    assert not hasattr(riecjax, "nonsense")
