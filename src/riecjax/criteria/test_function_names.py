"""The test functions that a user can ask for by name.

The command line offers those that `cli/criteria.py` lists too, which reads no class before it must.
"""

from riecjax.criteria.bump import Bump
from riecjax.criteria.test_functions import AbstractTestFunction, Boxcar, Hat

TEST_FUNCTIONS: dict[str, type[AbstractTestFunction]] = {
    kind.name: kind for kind in (Boxcar, Hat, Bump)
}
