"""`aleator new`: a commented study to begin with."""

import re
from pathlib import Path

from aleator_command._commands import UsageError

_TEMPLATE = '''"""{title}: a robust design of an uncertain system.

    aleator check {file}     what will be done, before anything is spent
    aleator run {file}       solve, sample, sweep, and write the report
"""

import aleator as al


class Oscillator(al.System):
    """Write the physics of your own system here: its states, its numbers, its equations of motion, its outputs."""

    states = ("x", "v")
    units = {{"x": "m", "force": "N"}}

    mass: al.Number = al.parameter("kg", positive=True)
    stiffness: al.Number = al.parameter("N/m", positive=True)
    damping: al.Number = al.parameter("N s/m", positive=True)

    def initial(self):
        return {{"x": 0.1, "v": 0.0}}  # m, m/s

    def rhs(self, t, z):
        return z.v, -(self.stiffness * z.x + self.damping * z.v) / self.mass

    def outputs(self, t, z):
        return {{"x": z.x, "force": self.damping * z.v}}


# Put a distribution in the place of any number that is uncertain, a decision in the place of any number to choose.
system = Oscillator(
    mass=al.Uniform(1.0, half_width=0.1),
    stiffness=al.Uniform(40.0, half_width=4.0),
    damping=al.Uniform(al.Decision(2.0, 0.5, 20.0), half_width=0.3),
)

# What to minimise, subject to what: statistics over the uncertainty, here with a margin of two standard deviations.
robust = al.Problem(
    system,
    grid=al.Grid(t_final=3.0, steps=300),
    minimize=al.rms("x").mean,
    subject_to=[*al.path("force").within(-0.8, 0.8, sigmas=2.0)],
    expansion=al.Expansion(order=4),
)

# The last design is the one that is proposed; the nominal one stands beside it for comparison.
study = al.Study(
    {{"nominal": al.deterministic(robust), "robust": robust}},
    title="{title}",
    samples=20_000,
    sweeps={{"force": [0.6, 0.7, 0.8, 0.9]}},
)
'''


def begin_file(path: Path) -> Path:
    """Write a commented study. Raises `UsageError` for a file that exists or cannot be written, and for odd names."""
    if path.is_dir():
        raise UsageError(f"new: '{path}' is a folder: name a file in it, such as {path / 'bracket.py'}.")
    if not re.fullmatch(r"[A-Za-z_]\w*(\.py)?", path.name):
        raise UsageError(
            "new: expected a Python file named by letters, digits and underscores, such as bracket.py; received "
            f"'{path.name}'."
        )
    path = path.with_suffix(".py")
    if path.exists():
        raise UsageError(f"new: '{path}' exists already, and is left as it is: choose another name.")
    title = path.stem.replace("_", " ").capitalize()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_TEMPLATE.format(title=title, file=path), encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"new: '{path}' cannot be written ({error.strerror}): name a file in a folder of your own."
        ) from error
    return path
