"""What to do next: proposed by findings, carried out, and kept where it helps.

A finding may know options of `riecjax identify` that put right what it is about. Before these are
told, they are carried out on the recordings at hand, as the command line would, and all is
estimated and judged once more. A step helps, if

- the program accepts it;
- blocks of time that parameters were not fitted to are left no more than before;
- no value that was good leaves its doubt, and all in all doubts are smaller.

A step that does not help is not told of. Of equivalent causes none has options: a finding names
both, and what would tell them apart.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from riecjax.assessment.doubt import Doubt, Evidence, doubts
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.model import Model
from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.stages import stages_over_records
from riecjax.findings import Finding, Step, joined
from riecjax.folds import Folds
from riecjax.leaves import size_of
from riecjax.models.catalogue import with_asked
from riecjax.records.preparation.steps import undone
from riecjax.records.recording import Recording
from riecjax.settings.answers import Assess
from riecjax.settings.files import Elements, Prepare, Read

if TYPE_CHECKING:
    from riecjax.settings.option import Option


class Asked(NamedTuple):
    """What is assessed: a model, recordings, those that it is only validated on, and settings."""

    model: Model
    recordings: Sequence[Recording]
    further: Sequence[Recording]
    settings: Assess

    def with_options(self, words: Sequence[str]) -> "Asked":
        """The same as options of the command line change it.

        **Raises:** as what carries them out.
        """
        said: dict[str, list[str]] = {}
        for word in words:
            if word.startswith("--"):
                said.setdefault(word, [])
            else:
                said[[*said][-1]].append(word)

        def of(kind: type) -> dict[str, Any]:
            options: dict[str, Option] = kind.options()
            return {
                name: option.parsed(*said[option.flag]) if said[option.flag] else True
                for name, option in options.items()
                if option.flag in said
            }

        model = with_asked(self.model, Elements(**of(Elements)))
        recordings, further, fitted = self.recordings, self.further, of(Assess)
        if of(Read) or of(Prepare):
            pairs = [(option, text) for option, texts in said.items() for text in texts]

            def prepared(one: Recording) -> Recording:
                return replace(
                    one,
                    record=undone(one.record, pairs),
                    findings=tuple(f for f in one.findings if f.about.kind != "sensors"),
                    kinematics=(),
                )

            recordings, further = ([*map(prepared, some)] for some in (recordings, further))
        given = self.settings.criterion
        changes = {"alpha", "beta", "test_function"} & fitted.keys()
        if changes or (model.has_hidden and not self.model.has_hidden):
            # Windows of the same reach, as suit what is asked for.
            windows = given.windows if isinstance(given, AbstractCriterion) else None
            own = () if windows is None else ("alpha", "beta")
            reach = {name: float(getattr(windows, name)) for name in own}
            fitted = (
                {"criterion": None, "band": None if own else self.settings.band} | reach | fitted
            )
        return Asked(model, recordings, further, replace(self.settings, **fitted))


def left_out(estimate: Estimate) -> float:
    """What equations leave beyond noise of blocks of time that they were not fitted to, as shares
    of their targets' energies, the sum over stages; infinite where nothing tells."""
    if estimate.summary is None:
        return np.inf
    total, known = 0.0, dict(estimate.known)
    stages, _ = stages_over_records(estimate.summary.equations(), estimate.table)
    for stage, equations in zip(estimate.stages, stages):
        blocks = equations.fix(known).flattened()
        folds = Folds.of(blocks.moments, blocks.clean, blocks.count, blocks.parameters)
        names = [name for name in stage.parameters if name in folds.parameters]
        total += float(folds.left(names).motion.sum()) / size_of(folds.energy)
        known |= {name: estimate[name] for name in stage.parameters}
    return total


def helps(before: Evidence, after: Evidence) -> bool:
    """Whether a step from one assessment to another makes it better."""
    # What is assumed of one model, and was weighed of the other, compares nothing.
    was, now = (doubts(each, assumed=False) for each in (before, after))
    common = was.keys() & now.keys()
    # Beside a hidden body a mass is another thing, and equations are not weighed.
    is_split = after.model.has_hidden and not before.model.has_hidden
    if not common or (not is_split and any(_spoils(was[name], now[name]) for name in common)):
        return False
    # What a step adds is carried by the recordings.
    ruling = (finding for finding in after.findings() if finding.about.rules_out)
    if {name for finding in ruling for name in after.parameters_of(finding)} - was.keys():
        return False
    # What is left over other windows is another thing.
    laws = [each.estimate.criterion.describe() for each in (before, after)]
    if laws[0] == laws[1] and left_out(after.estimate) > left_out(before.estimate):
        return False
    # What sits on a bound has no interval.
    told = [name for name in common if was[name].share > 0 and now[name].share > 0]
    sizes = [[np.log(min(of[name].share, 1.0)) for name in told] for of in (was, now)]
    return sum(sizes[1]) < sum(sizes[0])


def _spoils(was: Doubt, now: Doubt) -> bool:
    """Whether a value that was good is good no more, or leaves its doubt."""
    return was.is_good and not (now.is_good and was.ends[0] <= now.value <= was.ends[1])


def tried(evidence: Evidence, again: Callable[[Sequence[str]], Evidence]) -> Iterator[Step]:
    """Steps that are proposed and help, of each kind of cause the first; `again` assesses with
    further options."""
    seen, mended = set[tuple[str, ...]](), set[str]()
    for finding, step in proposals(evidence):
        if step.options in seen or finding.about.kind in mended:
            continue
        seen.add(step.options)
        try:
            after = again(step.options)
        except RiecjaxError:
            continue
        if helps(evidence, after):
            was, now = (each.answer for each in (evidence, after))
            names = [name for name in was.parameters if name in now.parameters]
            changed = {name: (float(was[name]), float(now[name])) for name in names}
            mended.add(finding.about.kind)
            yield replace(step, changed=changed)


def proposals(evidence: Evidence) -> Iterator[tuple[Finding, Step]]:
    """What findings propose to do, the most important first: those that make most of a doubt, and
    those that concern parameters that are not good and are no part of a doubt."""
    by_name = doubts(evidence)
    by_importance = sorted(evidence.findings(), key=lambda finding: finding.importance)
    ruling = (finding for finding in by_importance if finding.about.rules_out)
    poor = {name for finding in ruling for name in evidence.parameters_of(finding)}
    poor |= {name for name, doubt in by_name.items() if not doubt.is_good}
    systematic = {name for name, doubt in by_name.items() if doubt.wrong > doubt.scatter}
    for finding in by_importance:
        states = bool(finding.doubt or finding.doubts)
        concerned = evidence.parameters_of(finding) & by_name.keys()
        concerned &= poor | systematic if states else poor
        if any(finding in by_name[name].largest or not states for name in concerned):
            yield from ((finding, s) for s in steps_of(finding, by_importance) if s.options)


def steps_of(finding: Finding, among: Sequence[Finding]) -> Iterator[Step]:
    """What a finding proposes: its own step, else that of its class, for all findings alike."""
    about = finding.about
    if finding.step:
        yield Step(finding.step, finding.remedy)
    elif about.step:
        alike = [other for other in among if other.about.step == about.step]
        parameters = joined([*dict.fromkeys(name for f in alike for name in f.parameters)])
        signals = joined([*dict.fromkeys(name for f in alike for name in f.signals)])
        yield Step(about.step.format(parameters=parameters, signals=signals), about.options)
