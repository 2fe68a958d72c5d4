"""What each test costs: seconds, CPU seconds, traces, programs compiled and the seconds of compiling, worst first.

    python -m pytest --costs costs.tsv [--budget-cpu 700] [--budget-compilations 900]

A program that comes out of the cache of compilations counts as loaded, not as compiled. What a fixture shared by
several tests costs stands at the first of them; what importing and collecting costs, at the worker.
"""

import resource
import time
from pathlib import Path
from typing import Any

import jax
import pytest

COLUMNS = ("cpu", "seconds", "traces", "compilations", "compile_seconds", "loaded")
COUNTS = dict.fromkeys(COLUMNS, 0.0)
TABLE: dict[str, dict[str, float]] = {}  # of this process
ROWS: dict[str, dict[str, float]] = {}  # of the workers


def _durations(event: str, seconds: float, **_: object) -> None:
    if event.endswith("jaxpr_trace_duration"):
        COUNTS["traces"] += 1
    elif event.endswith("backend_compile_duration"):
        COUNTS["compilations"] += 1
        COUNTS["compile_seconds"] += seconds


def _events(event: str, **_: object) -> None:
    if event.endswith("cache_hits"):  # told before the duration of the same program, which is counted above
        COUNTS["compilations"] -= 1
        COUNTS["loaded"] += 1


jax.monitoring.register_event_duration_secs_listener(_durations)
jax.monitoring.register_event_listener(_events)


def _now(*, children: bool = True) -> dict[str, float]:
    usages = [resource.getrusage(resource.RUSAGE_SELF)] + [resource.getrusage(resource.RUSAGE_CHILDREN)] * children
    cpu = sum(usage.ru_utime + usage.ru_stime for usage in usages)
    return COUNTS | {"cpu": cpu, "seconds": time.perf_counter()}


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("costs")
    group.addoption("--costs", metavar="FILE", help="write the table of what tests cost into this file")
    group.addoption("--budget-cpu", type=float, metavar="SECONDS", help="fail if all tests take more of a processor")
    group.addoption("--budget-compilations", type=int, metavar="N", help="fail if all tests compile more programs")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item):
    before = _now()
    result = yield
    after = _now()
    TABLE[item.nodeid] = {column: after[column] - before[column] for column in COLUMNS}
    return result


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    output = getattr(session.config, "workeroutput", None)
    own = _now(children=output is not None or not session.config.option.numprocesses)  # else these are the workers
    rest = {column: own[column] - sum(row[column] for row in TABLE.values()) for column in COLUMNS}
    name = "main process" if output is None else f"imports and collection, {session.config.workerinput['workerid']}"
    TABLE[name] = rest | {"seconds": 0.0}
    if output is not None:
        output["costs"] = TABLE
    elif _beyond(session.config) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _total() -> dict[str, float]:
    return {column: sum(row[column] for row in (ROWS | TABLE).values()) for column in COLUMNS}


def _beyond(config: pytest.Config) -> list[str]:
    """The budgets that are exceeded."""
    budgets = {"cpu": config.option.budget_cpu, "compilations": config.option.budget_compilations}
    total = _total()
    return [
        f"{total[column]:.0f} {column} of {budget:g} that the budget allows"
        for column, budget in budgets.items()
        if budget is not None and total[column] > budget
    ]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    ROWS.update(getattr(node, "workeroutput", {}).get("costs", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    rows = sorted((ROWS | TABLE).items(), key=lambda row: -row[1]["cpu"])
    terminalreporter.write_sep("-", "costs, worst first")
    for name, row in [("all", _total()), *rows[:10]]:
        figures = ", ".join(f"{row[column]:.0f} {column.replace('_', ' ')}" for column in COLUMNS)
        terminalreporter.write_line(f"{name}: {figures}")
    for text in _beyond(config):
        terminalreporter.write_line(f"Over budget: {text}", red=True)
    if path := config.option.costs:
        lines = ["\t".join([*(f"{row[column]:.2f}" for column in COLUMNS), name]) for name, row in rows]
        Path(path).write_text("\n".join(["\t".join((*COLUMNS, "test")), *lines]) + "\n")
