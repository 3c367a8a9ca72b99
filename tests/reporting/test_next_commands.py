"""The command that a verdict proposes, as its reader pastes it."""

import click
import pytest

from riecjax.assessment.verdict import Cause
from riecjax.cli.command import Given
from riecjax.cli.identify import command
from riecjax.findings import Step
from riecjax.reporting.answer import next_steps

COMMAND = ("a.csv", "--model", "axis")


def given_to(*words: str) -> Given:
    ctx = click.Context(command)
    command.parse_args(ctx, list(words))
    return ctx.params["given"]


@pytest.mark.parametrize(
    ("given", "proposed", "run"),
    [
        (("--clock", "v=100"), ("--clock", "v=4.5"), ("--clock", "v=104.5")),
        (("--clock=v=100",), ("--clock", "v=4.5"), ("--clock", "v=104.5")),
        (("--shift", "v=0.01"), ("--shift", "v=-0.002"), ("--shift", "v=0.008")),
        (("--unit", "v=m/s"), ("--unit", "v=km/h"), ("--unit", "v=km/h")),
        (("--clock", "x=9"), ("--clock", "v=4.5"), ("--clock", "x=9", "--clock", "v=4.5")),
        (("--band", "1", "9"), ("--alpha", "1", "--beta", "2"), ("--alpha", "1", "--beta", "2")),
        (
            ("--alpha", ".005", "--beta", "1"),
            ("--alpha", "0.012"),
            ("--alpha", "0.012", "--beta", "1"),
        ),
        (("--alpha=1", "--beta=9"), ("--band", "1", "4"), ("--band", "1", "4")),
        (("--verbose", "--from=1"), ("--from", "2"), ("--verbose", "--from", "2")),
        (("--notch", "50"), ("--notch", "60"), ("--notch", "50", "--notch", "60")),
        (("--unit", "a=g"), ("--unit", "v=km/h"), ("--unit", "a=g", "--unit", "v=km/h")),
        (("--out", "found", "--json"), ("--to", "9"), ("--to", "9")),
    ],
)
def test_what_is_proposed_takes_the_place_of_what_it_replaces(given, proposed, run):
    assert given_to(*COMMAND, *given).with_options(proposed) == ["identify", *COMMAND, *run]


def test_what_a_job_says_is_replaced_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "job.toml").write_text(
        'model = "axis"\nrecords = ["a.csv"]\nalpha = 1\n[shift]\nv = 0.01\nx = 1\n'
    )
    given = given_to("--job", "job.toml")
    proposed = given.with_options(("--shift", "v=-0.002"))
    assert proposed == ["identify", "--job", "job.toml", "--shift", "v=0.008"]
    again = given_to(*proposed[1:], "--band", "1", "4")
    assert again.shifts == {"v": 0.008, "x": 1.0}
    # What is typed beside a job is not to make any of it forgotten.
    assert (again.alpha, again.band) == (1.0, (1.0, 4.0))


def test_what_two_causes_ask_for_is_proposed_once_where_it_stands_first():
    def cause(words: str, *options: str) -> Cause:
        return Cause("sensors", words, (), (), 0.5, Step(words, options))

    zero, late = ("--unknown-offset", "u"), ("--shift", "v=1")
    causes = [cause("first", *zero), cause("second", *late), cause("third", *zero)]
    found = [(step.words, tuple(step.options)) for step in next_steps(causes)]
    assert found == [("first", zero), ("second", late)]
