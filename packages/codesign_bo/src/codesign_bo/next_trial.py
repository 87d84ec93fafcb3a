"""The proposal of a study's next trial, from what its file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from codesign_bo.acquisition.proposal import fingerprint, propose
from codesign_bo.data import tells_viability
from codesign_bo.records import Basis, Proposal, TrialRecord
from codesign_bo.space import Feasible
from codesign_bo.view import StudyView

_MIN_SCORES = 2


def next_proposal(study: StudyView, trials: Sequence[TrialRecord], feasible: Feasible | None) -> Proposal:
    """Return the design of the trial after `trials`, and what it was based on.

    Args:
        study: The study.
        trials: Its trial table; what is unfinished or was lost counts as pending.
        feasible: Predicate over designs in natural units.

    Raises:
        StudyError: No feasible design was found.
    """
    trial = len(trials)
    imported = sum(h.result.ok for h in study.history())
    n_init = max(1, study.n_init - imported)
    ready = trial >= n_init and sum(t.ok for t in trials) + imported >= _MIN_SCORES
    queued = next((dict(q.params) for q in study.queue() if q.trial is None), None)
    belief = study.belief() if ready and queued is None else None
    hopeless = {t.trial for t in trials if t.result is not None and t.failed and tells_viability(t.result)}
    failed = [t for t in trials if t.trial in hopeless]
    pending = [t for t in trials if not t.ok and t.trial not in hopeless]
    proposal = propose(
        study.space,
        trial,
        n_init,
        study.seed,
        belief,
        study.space.to_unit(study.space.designs(t.params for t in pending)),
        study.space.to_unit(study.space.designs(t.params for t in failed)),
        queued,
        feasible,
    )
    if proposal.origin != "surrogate" or belief is None:
        return proposal
    unfinished = tuple(t.trial for t in trials if t.result is None)
    fit = belief.objectives[0].surrogate.fit
    return replace(proposal, basis=Basis(fit, fingerprint(belief), study.fit_seconds(), unfinished))
