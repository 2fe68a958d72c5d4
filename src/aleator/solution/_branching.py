"""`Branching`: how far the choice of integers and of rows of tables can be trusted."""

import math
from dataclasses import dataclass
from typing import final

from aleator._core.leaves import Printed


@final
@dataclass(frozen=True)
class Branching(Printed):
    """How a solution's integers and choices were found, and what is known of all others.

    - `combinations`: how many there are in all;
    - `nodes`: relaxed solves, in which those that are not decided yet are numbers between bounds, or where there are
      few combinations (`listed`), solves of each; `candidates`: complete solves, with the certificate;
    - `passed_over`: candidates whose certificate failed, or whose solve did, and which may be better than the answer;
    - `bound`: no combination has an objective below it, as far as each node was solved to its *global* optimum: so it
      is where the relaxed problem is convex, which nobody checks. `gap`: the objective less the bound;
    - `is_finished`: whether all nodes below the answer were looked at; else Ctrl-C or the limit of nodes ended it;
    - `is_proven`: whether no local optimum is involved: every combination was tried, and nothing else is decided.
    """

    combinations: int
    nodes: int
    candidates: int
    passed_over: int
    listed: bool
    bound: float
    gap: float
    is_finished: bool
    is_proven: bool

    def __str__(self) -> str:
        passed = f"; {self.passed_over} were passed over, whose certificates failed" if self.passed_over else ""
        if self.listed and self.is_finished:
            local = "" if self.is_proven else ", each to a local optimum"
            return f"the best of {self.combinations} combinations, all of which were solved{local}{passed}"
        many = f"{self.combinations}" if self.combinations < 1e6 else f"10^{math.log10(self.combinations):.0f}"
        ended = "" if self.is_finished else "not finished: "
        return (
            f"{ended}of {many} combinations {self.nodes} nodes were solved; none is below {self.bound:.8g} (gap "
            f"{self.gap:.2g}) if the relaxed problem is convex, which is not checked{passed}"
        )
